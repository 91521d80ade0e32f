// Compositing of one 16x16 tile, forward and backward, in GCC vector extensions; compiled once per instruction set
// with -DRESPIRE_ISA=<namespace>. The plain twin is src/splat/kernel.rs, which also explains the symbols.
//
// A tile is 16 blocks of 4x4 pixels. For each entry (splat in tile) a mask says which blocks the ellipse alpha >= 1/255
// can touch. Forward: entries are dealt to the lists of their blocks, and a block is composited with its state in
// registers. Backward: entry by entry, front to back, replaying the forward decisions, so that the nine sums of an
// entry are reduced once per tile. A pixel that has stopped is one whose running transmittance is 0.
#include "cpp/splat_kernel.h"
#include "cpp/splat_lanes.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

constexpr float ALPHA_MIN = 1.0f / 255.0f;
constexpr float ALPHA_MAX = 0.99f;

// Vectors of pixels whose alphas are computed side by side: each is one long chain of dependent operations, and the
// processor looks ahead over little more than one of them.
#if defined(__AVX512F__)
constexpr int ABREAST = 4;
#else
constexpr int ABREAST = 2;
#endif

// U times 2^x for x <= 127, relative error 1.5e-7 (minimax polynomial of degree 5 of 2^f, |f| <= 1/2).
template <int U>
inline void exp2(V* x) {
  constexpr float TERMS[] = {9.675541334e-3f, 5.550713274e-2f, 2.402211972e-1f, 6.931469671e-1f, 1.0f};
  V n[U], p[U];
  for (int u = 0; u < U; ++u) {
#if !defined(__AVX512F__)
    x[u] = pick_gt(x[u], all(-1000.0f), x[u], all(-1000.0f));
#endif
    n[u] = nearest(x[u]);
  }
  for (int u = 0; u < U; ++u) x[u] = x[u] - n[u], p[u] = all(1.327647198e-3f);
  for (float term : TERMS)
    for (int u = 0; u < U; ++u) p[u] = fma(p[u], x[u], all(term));
  for (int u = 0; u < U; ++u) x[u] = power2(x[u], p[u], n[u]);
}

// 2^exponent (not yet clamped) of the splats q[u] at the pixels (px[u], py[u]), and the offsets of these.
template <int U>
struct Alphas {
  V dx[U], dy[U], raw[U];
  Alphas(const float* const* q, const V* px, const V* py) {
    V part[U];
    for (int u = 0; u < U; ++u) dx[u] = (px[u] - all(q[u][X])) - all(q[u][X_REST]);
    for (int u = 0; u < U; ++u) dy[u] = (py[u] - all(q[u][Y])) - all(q[u][Y_REST]);
    for (int u = 0; u < U; ++u) part[u] = all(q[u][B]) * dy[u], raw[u] = all(q[u][C]) * dy[u];
    for (int u = 0; u < U; ++u) {
      part[u] = fma(all(q[u][A]), dx[u], part[u]);
      raw[u] = fnma(raw[u], dy[u], all(q[u][LOG2_OPACITY]));
    }
    for (int u = 0; u < U; ++u) raw[u] = fnma(part[u], dx[u], raw[u]);
    exp2<U>(raw);
  }
};

// Pixel centres of a block relative to the tile's corner.
alignas(64) const float COLUMN[16] = {.5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5};
alignas(64) const float LINE[16] = {.5, .5, .5, .5, 1.5, 1.5, 1.5, 1.5, 2.5, 2.5, 2.5, 2.5, 3.5, 3.5, 3.5, 3.5};

// Which blocks have pixel centres that the ellipse can reach: the x-extent of the ellipse over each band of 4 pixel rows,
// the four bands of an entry side by side in one vector, against the four columns of blocks.

#if defined(__AVX512F__)

// The masks of the sixteen entries `e` (those beyond `count` repeat another; their masks are 0), four entries side by side.
inline __m512i block_masks(const float* rows, const std::uint32_t* e, int count, float tile_x, float tile_y) {
  const __m512i band = _mm512_set4_epi32(3, 2, 1, 0);
  const __m512 line = _mm512_add_ps(_mm512_set1_ps(tile_y), _mm512_set4_ps(12.5f, 8.5f, 4.5f, 0.5f));
  const __m512 zero = _mm512_setzero_ps();
  // Bit c of the index to bit 4 c of the value.
  const __m512i spread = _mm512_setr_epi32(0, 0x1, 0x10, 0x11, 0x100, 0x101, 0x110, 0x111, 0x1000, 0x1001, 0x1010, 0x1011,
                                           0x1100, 0x1101, 0x1110, 0x1111);
  __m512i masks = _mm512_setzero_si512();
  for (int g = 0; 4 * g < count; ++g) {
    const float* q[4];
    for (int l = 0; l < 4; ++l) q[l] = rows + 16 * static_cast<std::size_t>(e[4 * g + l]);
    auto four = [&](int at) {
      __m512 v = _mm512_castps128_ps512(_mm_loadu_ps(q[0] + at));
      v = _mm512_insertf32x4(v, _mm_loadu_ps(q[1] + at), 1);
      v = _mm512_insertf32x4(v, _mm_loadu_ps(q[2] + at), 2);
      return _mm512_insertf32x4(v, _mm_loadu_ps(q[3] + at), 3);
    };
    static_assert(X == 0 && Y == 1 && A == 2 && B == 3 && HALF_WIDTH == 10 && HALF_HEIGHT == 11 && DISCRIMINANT == 12 &&
                      WIDEST == 13,
                  "the columns as they are picked below");
    const __m512 q0 = four(0), q2 = four(8), q3 = four(12);
    const __m512 b = _mm512_permute_ps(q0, 0xff), half_height = _mm512_permute_ps(q2, 0xff);
    const __m512 slack = _mm512_fmadd_ps(_mm512_set1_ps(1e-5f), _mm512_add_ps(_mm512_permute_ps(q2, 0xaa), half_height),
                                         _mm512_set1_ps(1e-3f));
    const __m512 limit = _mm512_add_ps(half_height, slack), below = _mm512_sub_ps(zero, limit);
    const __m512 y0 = _mm512_sub_ps(line, _mm512_permute_ps(q0, 0x55)), y1 = _mm512_add_ps(y0, _mm512_set1_ps(3.0f));
    const __m512 lo = _mm512_max_ps(y0, below), hi = _mm512_min_ps(y1, limit);
    const __m512 widest = _mm512_permute_ps(q3, 0x55);
    // The ellipse is widest to the right at y = -B half_width / (2 C), to the left at the opposite point.
    const __m512 y_right = _mm512_min_ps(_mm512_max_ps(widest, lo), hi);
    const __m512 y_left = _mm512_min_ps(_mm512_max_ps(_mm512_sub_ps(zero, widest), lo), hi);
    const __m512 d = _mm512_permute_ps(q3, 0x00), scale = (__m512)(0.5f * reciprocal((V)_mm512_permute_ps(q0, 0xaa)));
    const __m512 reach = _mm512_fnmadd_ps(_mm512_mul_ps(d, half_height), half_height, zero);
    auto root = [&](__m512 y) {
      return _mm512_sqrt_ps(_mm512_max_ps(_mm512_fmadd_ps(_mm512_mul_ps(d, y), y, reach), zero));
    };
    const __m512 offset = _mm512_sub_ps(_mm512_permute_ps(q0, 0x00), _mm512_set1_ps(tile_x + 0.5f));
    const __m512 right = _mm512_fmadd_ps(scale, _mm512_fnmadd_ps(b, y_right, root(y_right)), _mm512_add_ps(offset, slack));
    const __m512 left = _mm512_fnmadd_ps(scale, _mm512_fmadd_ps(b, y_left, root(y_left)), _mm512_sub_ps(offset, slack));
    // Columns of blocks c with left <= 4 c + 3 and right >= 4 c: from first to before last.
    const __m512 quarter = _mm512_set1_ps(0.25f);
    const __m512 first = _mm512_mul_ps(_mm512_sub_ps(left, _mm512_set1_ps(3.0f)), quarter);
    const __m512 last = _mm512_fmadd_ps(right, quarter, _mm512_set1_ps(1.0f));
    const __m512 most = _mm512_set1_ps(4.0f);
    const __m512i c0 = _mm512_cvt_roundps_epi32(_mm512_min_ps(_mm512_max_ps(first, zero), most),
                                                _MM_FROUND_TO_POS_INF | _MM_FROUND_NO_EXC);
    const __m512i c1 = _mm512_cvt_roundps_epi32(_mm512_min_ps(_mm512_max_ps(last, zero), most),
                                                _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
    const __mmask16 inside = _mm512_mask_cmplt_epi32_mask(_mm512_cmp_ps_mask(lo, hi, _CMP_LE_OQ), c0, c1);
    const __m512i one = _mm512_set1_epi32(1);
    const __m512i columns = _mm512_maskz_sub_epi32(inside, _mm512_sllv_epi32(one, c1), _mm512_sllv_epi32(one, c0));
    __m512i m = _mm512_sllv_epi32(_mm512_permutexvar_epi32(columns, spread), band);
    m = _mm512_or_si512(m, _mm512_shuffle_epi32(m, _MM_PERM_BADC));
    m = _mm512_or_si512(m, _mm512_shuffle_epi32(m, _MM_PERM_CDAB));
    // All four lanes of an entry are alike: one of each goes to lanes 4 g to 4 g + 3.
    const __m512i pick = _mm512_set4_epi32(12, 8, 4, 0);
    masks = _mm512_mask_permutexvar_epi32(masks, static_cast<__mmask16>(0xf << (4 * g)), pick, m);
  }
  return _mm512_maskz_mov_epi32(static_cast<__mmask16>((1u << count) - 1), masks);
}

// Masks of the entries i..end, and their splats dealt to the lists of the blocks in `alive`, without a branch on what is
// dealt: for each block the entries of sixteen that touch it are pushed together.
template <bool KNOWN, std::size_t ROOM>
void deal(const ForwardTile& t, std::size_t i, std::size_t end, std::uint32_t alive, std::uint32_t (*lists)[ROOM], int* sizes) {
  for (; i < end; i += 16) {
    const int count = end - i < 16 ? static_cast<int>(end - i) : 16;
    const __mmask16 there = static_cast<__mmask16>((1u << count) - 1);
    alignas(64) std::uint32_t e[16];
    const __m512i splats = _mm512_mask_loadu_epi32(_mm512_set1_epi32(static_cast<int>(t.entries[i])), there, t.entries + i);
    _mm512_store_si512(e, splats);
    const std::size_t ahead = i + 16 < t.count ? (t.count - i - 16 < 16 ? t.count - i - 16 : 16) : 0;
    for (std::size_t k = 0; k < ahead; ++k) __builtin_prefetch(t.rows + 16 * static_cast<std::size_t>(t.entries[i + 16 + k]));
    __m512i masks;
    if (KNOWN) {
      masks = _mm512_cvtepu16_epi32(_mm256_maskz_loadu_epi16(there, t.masks + i));
    } else {
      masks = _mm512_and_si512(block_masks(t.rows, e, count, t.x, t.y), _mm512_set1_epi32(static_cast<int>(alive)));
      _mm256_mask_storeu_epi16(t.masks + i, there, _mm512_cvtepi32_epi16(masks));
    }
    for (std::uint32_t todo = alive; todo; todo &= todo - 1) {
      const int s = __builtin_ctz(todo);
      const __mmask16 hit = _mm512_test_epi32_mask(masks, _mm512_set1_epi32(1 << s));
      _mm512_storeu_si512(lists[s] + sizes[s], _mm512_maskz_compress_epi32(hit, splats));
      sizes[s] += __builtin_popcount(hit);
    }
  }
}

#else

constexpr int ENTRIES = LANES / 4;

// The masks of the splats q.
inline void block_masks(const float* const* q, float tile_x, float tile_y, std::uint32_t* masks) {
  auto four = [&](int at) {
    __m128 parts[ENTRIES];
    for (int e = 0; e < ENTRIES; ++e) parts[e] = _mm_loadu_ps(q[e] + at);
    return join(parts);
  };
  static_assert(X == 0 && Y == 1 && A == 2 && B == 3 && HALF_WIDTH == 10 && HALF_HEIGHT == 11 && DISCRIMINANT == 12 && WIDEST == 13,
                "the columns as they are picked below");
  const V q0 = four(0), q2 = four(8), q3 = four(12), zero{};
  const V half_height = spread<3>(q2), slack = 1e-5f * (spread<2>(q2) + half_height) + 1e-3f, limit = half_height + slack;
  V line;
  for (int l = 0; l < LANES; ++l) line[l] = 4.0f * (l % 4) + 0.5f;
  const V y0 = line + (tile_y - spread<1>(q0)), lo = most(y0, -limit), hi = least(y0 + 3.0f, limit);
  // The ellipse is widest to the right at y = -B half_width / (2 C), to the left at the opposite point.
  const V widest = spread<1>(q3), y_right = least(most(widest, lo), hi), y_left = least(most(-widest, lo), hi);
  const V d = spread<0>(q3), b = spread<3>(q0), scale = 0.5f / spread<2>(q0), reach = -(d * half_height * half_height);
  auto root = [&](V y) { return square_root(most(d * y * y + reach, zero)); };
  const V offset = spread<0>(q0) - (tile_x + 0.5f);
  const V right = scale * (root(y_right) - b * y_right) + (offset + slack);
  const V left = (offset - slack) - scale * (root(y_left) + b * y_left);
  for (int e = 0; e < ENTRIES; ++e) masks[e] = 0;
  for (int column = 0; column < 4; ++column) {
    const int hit = lanes_of((lo <= hi) & (left <= 4.0f * column + 3.0f) & (right >= 4.0f * column));
    for (int e = 0; e < ENTRIES; ++e) masks[e] |= static_cast<std::uint32_t>(hit >> (4 * e) & 0xf) << (4 * column);
  }
}

template <bool KNOWN, std::size_t ROOM>
void deal(const ForwardTile& t, std::size_t i, std::size_t end, std::uint32_t alive, std::uint32_t (*lists)[ROOM], int* sizes) {
  for (; i < end; i += ENTRIES) {
    const float* q[ENTRIES];
    std::uint32_t masks[ENTRIES];
    for (std::size_t e = 0; e < ENTRIES; ++e) {
      if (i + e + 6 < end) __builtin_prefetch(t.rows + 16 * static_cast<std::size_t>(t.entries[i + e + 6]));
      q[e] = t.rows + 16 * static_cast<std::size_t>(t.entries[i + e < end ? i + e : i]);
    }
    if (!KNOWN) block_masks(q, t.x, t.y, masks);
    for (std::size_t e = 0; e < ENTRIES && i + e < end; ++e) {
      if (!KNOWN) t.masks[i + e] = static_cast<std::uint16_t>(masks[e] & alive);
      for (std::uint32_t mask = t.masks[i + e]; mask; mask &= mask - 1) {
        const int s = __builtin_ctz(mask);
        lists[s][sizes[s]++] = t.entries[i + e];
      }
    }
  }
}

#endif

// Some pixels of a block: the sums, what is left of them (no more than `stop` where they have stopped) and what was left
// before they stopped, and the velocities of the sums and of what is left along K directions.
template <bool WITH_Z, int K>
struct Pixels {
  V px, py, stop, sums[4], kept, left, moving[K + 1][MOVING];

  void blend(const ForwardTile& t, std::size_t splat, V dx, V dy, V raw) {
    const float* q = t.rows + 16 * splat;
    V a = least(raw, all(ALPHA_MAX));
    a = keep_ge(a, all(ALPHA_MIN), a);
    const V next = fnma(a, left, left);
    const V weight = keep_gt(next, stop, a * left);
    for (int d = 0; d < K; ++d) {
      const float* v = t.velocities[d] + 8 * splat;
      V* m = moving[d];
      const V p = fma(all(v[VXX]), dx, fma(all(v[VXY]), dy, all(v[VX])));
      const V by_log = fma(p, dx, fma(all(v[VYY]), dy, all(v[VY])) * dy);
      // d weight = d alpha T + alpha dT; no alpha moves where it is clamped, nothing where the pixel has stopped.
      const V by_alpha = keep_ge(all(ALPHA_MAX), raw, by_log * weight);
      const V by_weight = keep_gt(next, stop, fma(a, m[3], by_alpha));
      m[0] = fma(by_weight, all(q[RED]), fma(weight, all(v[VRED]), m[0]));
      m[1] = fma(by_weight, all(q[GREEN]), fma(weight, all(v[VGREEN]), m[1]));
      m[2] = fma(by_weight, all(q[BLUE]), fma(weight, all(v[VBLUE]), m[2]));
      m[3] -= by_weight;
    }
    kept = pick_gt(next, stop, next, kept);
    // Never grows: where a pixel has stopped, nothing later is blended.
    left = next;
    for (int c = 0; c < (WITH_Z ? 4 : 3); ++c) sums[c] = fma(weight, all(q[RED + c]), sums[c]);
  }

  template <int U>
  void add(const ForwardTile& t, const std::uint32_t* splats) {
    const float* q[U];
    V x[U], y[U];
    for (int u = 0; u < U; ++u) q[u] = t.rows + 16 * static_cast<std::size_t>(splats[u]), x[u] = px, y[u] = py;
    const Alphas<U> alphas(q, x, y);
    for (int u = 0; u < U; ++u) blend(t, splats[u], alphas.dx[u], alphas.dy[u], alphas.raw[u]);
  }

  // True while one of them goes on; those that have stopped have nothing left.
  bool look() {
    left = keep_gt(left, stop, left);
    return any(left);
  }
};

// One block over one list. `state`: PLANES planes and, behind them, what is left of each pixel (0 where it has
// stopped); `moving`: MOVING planes for each of the K directions of `t`.
template <bool WITH_Z, int K>
bool composite(const ForwardTile& t, const std::uint32_t* list, int count, float x, float y, float* state, float* moving) {
  static_assert(DEPTH == RED + 3, "the depth is summed like a fourth colour");
  bool alive = false;
  for (int k = 0; k < PARTS; ++k) {
    float* s = state + LANES * k;
    Pixels<WITH_Z, K> p;
    p.px = load(COLUMN + LANES * k) + all(x), p.py = load(LINE + LANES * k) + all(y), p.stop = all(t.stop);
    for (int c = 0; c < (WITH_Z ? 4 : 3); ++c) p.sums[c] = load(s + c * PIXELS);
    p.kept = load(s + 4 * PIXELS), p.left = load(s + 5 * PIXELS);
    for (int d = 0; d < K; ++d)
      for (int c = 0; c < MOVING; ++c) p.moving[d][c] = load(moving + (d * MOVING + c) * PIXELS + LANES * k);
    bool goes_on = true;
    int j = 0;
    for (; goes_on && j + ABREAST <= count; j += ABREAST) {
      p.template add<ABREAST>(t, list + j);
      if (j & 4) goes_on = p.look();
    }
    for (; goes_on && j < count; ++j) p.template add<1>(t, list + j);
    alive |= p.look();
    for (int c = 0; c < (WITH_Z ? 4 : 3); ++c) store(s + c * PIXELS, p.sums[c]);
    store(s + 4 * PIXELS, p.kept);
    store(s + 5 * PIXELS, p.left);
    for (int d = 0; d < K; ++d)
      for (int c = 0; c < MOVING; ++c) store(moving + (d * MOVING + c) * PIXELS + LANES * k, p.moving[d][c]);
  }
  return alive;
}

template <bool WITH_Z, int K, bool KNOWN>
void forward_tile(const ForwardTile& t) {
  constexpr std::size_t CHUNK = 192, ROOM = CHUNK + 16;
  std::uint32_t lists[16][ROOM];
  int sizes[16];
  alignas(64) float state[6 * PIXELS];
  for (int i = 0; i < 4 * PIXELS; ++i) state[i] = 0;
  for (int i = 4 * PIXELS; i < 6 * PIXELS; ++i) state[i] = 1;
  for (int i = 0; i < K * MOVING * PIXELS; ++i) t.moving[i] = 0;
  std::uint32_t alive = 0xffff;
  std::size_t i = 0;
  while (i < t.count && alive) {
    const std::size_t end = i + CHUNK < t.count ? i + CHUNK : t.count;
    for (int& size : sizes) size = 0;
    for (int d = 0; d < K; ++d)
      for (std::size_t k = i; k < end; ++k) __builtin_prefetch(t.velocities[d] + 8 * static_cast<std::size_t>(t.entries[k]));
    deal<KNOWN>(t, i, end, alive, lists, sizes);
    i = end;
    for (std::uint32_t todo = alive; todo; todo &= todo - 1) {
      const int s = __builtin_ctz(todo);
      if (!sizes[s]) continue;
      const float x = t.x + 4.0f * (s >> 2), y = t.y + 4.0f * (s & 3);
      if (!composite<WITH_Z, K>(t, lists[s], sizes[s], x, y, state + 16 * s, t.moving + 16 * s)) alive &= ~(1u << s);
    }
  }
  for (; i < t.count; ++i) t.masks[i] = 0;
  __builtin_memcpy(t.state, state, PLANES * PIXELS * sizeof(float));
}

#if defined(__AVX512F__)

// slot[k] = the sum over the lanes of v[k], 0 for the last four of sixteen: transposed and added by halves.
inline void store_sums(const V* v, float* slot) {
  __m512 pairs[6], quads[3];
  for (int k = 0; k < 6; ++k) {
    const __m512 a = (__m512)v[2 * k], b = (__m512)v[2 * k + 1];
    pairs[k] = _mm512_add_ps(_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b));
  }
  for (int k = 0; k < 3; ++k) {
    const __m512 a = pairs[2 * k], b = pairs[2 * k + 1];
    quads[k] = _mm512_add_ps(_mm512_shuffle_ps(a, b, 0x44), _mm512_shuffle_ps(a, b, 0xee));
  }
  const __m512 zero = _mm512_setzero_ps();
  const __m512 low = _mm512_add_ps(_mm512_shuffle_f32x4(quads[0], quads[1], 0x44), _mm512_shuffle_f32x4(quads[0], quads[1], 0xee));
  const __m512 high = _mm512_add_ps(_mm512_shuffle_f32x4(quads[2], zero, 0x44), _mm512_shuffle_f32x4(quads[2], zero, 0xee));
  _mm512_storeu_ps(slot, _mm512_add_ps(_mm512_shuffle_f32x4(low, high, 0x88), _mm512_shuffle_f32x4(low, high, 0xdd)));
}

#else

// Four sums at once: lane k of the result is the sum over the lanes of argument k.
inline __m128 sums(V a, V b, V c, V d) {
  const __m128 fa = (__m128)fold(a), fb = (__m128)fold(b), fc = (__m128)fold(c), fd = (__m128)fold(d);
  const __m128 ab = _mm_add_ps(_mm_unpacklo_ps(fa, fb), _mm_unpackhi_ps(fa, fb));
  const __m128 cd = _mm_add_ps(_mm_unpacklo_ps(fc, fd), _mm_unpackhi_ps(fc, fd));
  return _mm_add_ps(_mm_movelh_ps(ab, cd), _mm_movehl_ps(cd, ab));
}

inline void store_sums(const V* v, float* slot) {
  for (int k = 0; k < 12; k += 4) _mm_storeu_ps(slot + k, sums(v[k], v[k + 1], v[k + 2], v[k + 3]));
  _mm_storeu_ps(slot + 12, _mm_setzero_ps());
}

#endif

// Entries whose alphas are computed before their sums.
constexpr int BATCH = 16;

// The pairs of an entry of a batch and a block that it may touch, entry after entry, and 2^exponent of their pixels (0
// below ALPHA_MIN).
struct Pairs {
  alignas(64) float raw[16 * BATCH][16];
  std::uint8_t owners[16 * BATCH + 16], blocks[16 * BATCH + 16];
  int starts[BATCH + 1];

  void find(const BackwardTile& t, std::size_t first, int count, std::uint32_t alive) {
    int end = 0;
    for (int k = 0; k < count; ++k) {
      starts[k] = end;
      const std::uint32_t mask = t.masks[first + k] & alive;
#if defined(__AVX512F__)
      const __m512i numbers = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
      const __m512i found = _mm512_maskz_compress_epi32(static_cast<__mmask16>(mask), numbers);
      _mm_storeu_si128(reinterpret_cast<__m128i*>(blocks + end), _mm512_cvtepi32_epi8(found));
      _mm_storeu_si128(reinterpret_cast<__m128i*>(owners + end), _mm_set1_epi8(static_cast<char>(k)));
      end += __builtin_popcount(mask);
#else
      for (std::uint32_t todo = mask; todo; todo &= todo - 1) {
        blocks[end] = static_cast<std::uint8_t>(__builtin_ctz(todo));
        owners[end++] = static_cast<std::uint8_t>(k);
      }
#endif
    }
    starts[count] = end;
    // Whole groups: what is too much belongs to the first entry and is not looked at.
    for (int k = 0; k < ABREAST; ++k) owners[end + k] = blocks[end + k] = 0;
  }

  // `columns` and `lines`: pixel centres of the four columns and lines of blocks.
  void fill(const BackwardTile& t, std::size_t first, int count, const float (*columns)[16], const float (*lines)[16]) {
    constexpr int U = ABREAST > PARTS ? ABREAST : PARTS, AT_ONCE = U / PARTS;
    for (int p = 0; p < starts[count]; p += AT_ONCE) {
      const float* q[U];
      V x[U], y[U];
      for (int u = 0; u < U; ++u) {
        const int pair = p + u / PARTS, part = LANES * (u % PARTS);
        q[u] = t.rows + 16 * static_cast<std::size_t>(t.entries[first + owners[pair]]);
        x[u] = load(columns[blocks[pair] >> 2] + part), y[u] = load(lines[blocks[pair] & 3] + part);
      }
      const Alphas<U> alphas(q, x, y);
      for (int u = 0; u < U; ++u)
        store(raw[p + u / PARTS] + LANES * (u % PARTS), keep_ge(alphas.raw[u], all(ALPHA_MIN), alphas.raw[u]));
    }
  }
};

template <bool WITH_GEOMETRY, bool WITH_COLOR, bool WITH_Z>
void backward_tile(const BackwardTile& t) {
  alignas(64) float left[PIXELS], behind[PIXELS], columns[4][16], lines[4][16];
  for (int i = 0; i < PIXELS; ++i) left[i] = 1;
  __builtin_memcpy(behind, t.adjoint + 4 * PIXELS, sizeof behind);
  for (int b = 0; b < 4; ++b)
    for (int i = 0; i < 16; ++i) columns[b][i] = COLUMN[i] + (t.x + 4.0f * b), lines[b][i] = LINE[i] + (t.y + 4.0f * b);
  const float *vr = t.adjoint, *vg = vr + PIXELS, *vb = vg + PIXELS, *vz = vb + PIXELS;
  Pairs pairs;
  const V stop = all(t.stop);
  std::uint32_t alive = 0xffff;
  for (std::size_t first = 0; first < t.count; first += BATCH) {
    const int count = t.count - first < BATCH ? static_cast<int>(t.count - first) : BATCH;
    for (std::size_t i = first + BATCH; i < first + 2 * BATCH && i < t.count; ++i) {
      __builtin_prefetch(t.rows + 16 * static_cast<std::size_t>(t.entries[i]));
      __builtin_prefetch(t.slots + 16 * static_cast<std::size_t>(t.targets[i]), 1);
    }
    pairs.find(t, first, count, alive);
    pairs.fill(t, first, count, columns, lines);
    for (int e = 0; e < count; ++e) {
      float* slot = t.slots + 16 * static_cast<std::size_t>(t.targets[first + e]);
      const float* q = t.rows + 16 * static_cast<std::size_t>(t.entries[first + e]);
      V s{}, sx{}, sy{}, sxx{}, sxy{}, syy{}, sr{}, sg{}, sb{}, sz{};
      for (int pair = pairs.starts[e]; pair < pairs.starts[e + 1]; ++pair) {
        const int block = pairs.blocks[pair];
        for (int k = 0; k < PARTS; ++k) {
          const int p = 16 * block + LANES * k;
          const V raw = load(pairs.raw[pair] + LANES * k);
          const V a = least(raw, all(ALPHA_MAX));
          const V now = load(left + p);
          const V next = fnma(a, now, now);
          const V weight = keep_gt(next, stop, a * now);
          store(left + p, keep_gt(next, stop, next));
          const V r = load(vr + p), g = load(vg + p), b = load(vb + p);
          if (WITH_GEOMETRY) {
            const V dx = (load(columns[block >> 2] + LANES * k) - all(q[X])) - all(q[X_REST]);
            const V dy = (load(lines[block & 3] + LANES * k) - all(q[Y])) - all(q[Y_REST]);
            V value = fma(all(q[RED]), r, fma(all(q[GREEN]), g, all(q[BLUE]) * b));
            if (WITH_Z) value = fma(all(q[DEPTH]), load(vz + p), value);
            const V rest = fnma(weight, value, load(behind + p));
            store(behind + p, rest);
            // d loss / d alpha, then d loss / d log(alpha); none where alpha is clamped or the pixel has stopped.
            const V by_alpha = fnma(rest, reciprocal(all(1) - a), now * value);
            V v = keep_gt(next, stop, a * by_alpha);
            v = keep_ge(all(ALPHA_MAX), raw, v);
            const V mx = v * dx, my = v * dy;
            s += v;
            sx += mx;
            sy += my;
            sxx = fma(mx, dx, sxx);
            sxy = fma(mx, dy, sxy);
            syy = fma(my, dy, syy);
          }
          if (WITH_COLOR) {
            sr = fma(weight, r, sr);
            sg = fma(weight, g, sg);
            sb = fma(weight, b, sb);
          }
          if (WITH_Z) sz = fma(weight, load(vz + p), sz);
        }
      }
      const V moments[12] = {s, sx, sy, sxx, sxy, syy, sz, V{}, sr, sg, sb, V{}};
      store_sums(moments, slot);
    }
    // Blocks whose pixels have all stopped.
    for (std::uint32_t todo = alive; todo; todo &= todo - 1) {
      const int block = __builtin_ctz(todo);
      bool goes_on = false;
      for (int k = 0; k < PARTS; ++k) goes_on |= any(load(left + 16 * block + LANES * k));
      if (!goes_on) alive &= ~(1u << block);
    }
  }
}

}  // namespace

void forward(const ForwardTile& t, std::uint32_t parts) {
  switch (t.directions) {
    case 1: return forward_tile<false, 1, false>(t);
    case 2: return forward_tile<false, 2, false>(t);
    case 3: return forward_tile<false, 3, false>(t);
    case 4: return forward_tile<false, 4, false>(t);
    default: break;
  }
  const bool known = parts & KNOWN_MASKS;
  if (parts & WITH_DEPTH) {
    known ? forward_tile<true, 0, true>(t) : forward_tile<true, 0, false>(t);
  } else {
    known ? forward_tile<false, 0, true>(t) : forward_tile<false, 0, false>(t);
  }
}

void backward(const BackwardTile& t, std::uint32_t parts) {
  switch (parts & (GEOMETRY | COLOR | WITH_DEPTH)) {
    case GEOMETRY: return backward_tile<true, false, false>(t);
    case COLOR: return backward_tile<false, true, false>(t);
    case GEOMETRY | COLOR: return backward_tile<true, true, false>(t);
    case GEOMETRY | WITH_DEPTH: return backward_tile<true, false, true>(t);
    case GEOMETRY | COLOR | WITH_DEPTH: return backward_tile<true, true, true>(t);
    default: return;
  }
}

}  // namespace RESPIRE_ISA
}  // namespace respire
