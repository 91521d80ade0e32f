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

// 2^x for x <= 127, relative error 1.5e-7 (minimax polynomial of degree 5 of 2^f, |f| <= 1/2).
inline V exp2(V x) {
#if !defined(__AVX512F__)
  x = pick_gt(x, all(-1000.0f), x, all(-1000.0f));
#endif
  V n = nearest(x), f = x - n;
  V p = all(1.327647198e-3f);
  p = fma(p, f, all(9.675541334e-3f));
  p = fma(p, f, all(5.550713274e-2f));
  p = fma(p, f, all(2.402211972e-1f));
  p = fma(p, f, all(6.931469671e-1f));
  p = fma(p, f, all(1.0f));
  return power2(x, p, n);
}

// Pixel centres of a block relative to the tile's corner.
alignas(64) const float COLUMN[16] = {.5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5};
alignas(64) const float LINE[16] = {.5, .5, .5, .5, 1.5, 1.5, 1.5, 1.5, 2.5, 2.5, 2.5, 2.5, 3.5, 3.5, 3.5, 3.5};

// Blocks whose pixel centres the ellipse can reach: the x-extent of the ellipse over each band of 4 pixel rows, the
// four bands side by side in one vector, against the four columns of blocks.
[[maybe_unused]] inline std::uint32_t block_mask(const float* q, float tile_x, float tile_y) {
  const __m128 zero = _mm_setzero_ps();
  const float slack = 1e-3f + 1e-5f * (q[HALF_WIDTH] + q[HALF_HEIGHT]);
  const float hy = q[HALF_HEIGHT] + slack;
  const __m128 y0 = _mm_add_ps(_mm_setr_ps(0.5f, 4.5f, 8.5f, 12.5f), _mm_set1_ps(tile_y - q[Y]));
  const __m128 y1 = _mm_add_ps(y0, _mm_set1_ps(3.0f));
  const __m128 lo = _mm_max_ps(y0, _mm_set1_ps(-hy)), hi = _mm_min_ps(y1, _mm_set1_ps(hy));
  const __m128 inside = _mm_cmple_ps(lo, hi);
  // The ellipse is widest to the right at y = -B half_width / (2 C), to the left at the opposite point.
  const float widest = q[WIDEST];
  const __m128 y_right = _mm_min_ps(_mm_max_ps(_mm_set1_ps(widest), lo), hi);
  const __m128 y_left = _mm_min_ps(_mm_max_ps(_mm_set1_ps(-widest), lo), hi);
  const __m128 d = _mm_set1_ps(q[DISCRIMINANT]), k = _mm_set1_ps(q[FOUR_A_REACH]);
  const __m128 b = _mm_set1_ps(-q[B]), scale = _mm_set1_ps(q[HALF_OVER_A]);
  auto root = [&](__m128 y) { return _mm_sqrt_ps(_mm_max_ps(_mm_add_ps(_mm_mul_ps(_mm_mul_ps(d, y), y), k), zero)); };
  const float offset = q[X] - tile_x - 0.5f;
  __m128 right = _mm_mul_ps(scale, _mm_add_ps(_mm_mul_ps(b, y_right), root(y_right)));
  __m128 left = _mm_mul_ps(scale, _mm_sub_ps(_mm_mul_ps(b, y_left), root(y_left)));
  right = _mm_add_ps(right, _mm_set1_ps(offset + slack));
  left = _mm_add_ps(left, _mm_set1_ps(offset - slack));
  std::uint32_t mask = 0;
  for (int column = 0; column < 4; ++column) {
    const __m128 hit = _mm_and_ps(_mm_cmple_ps(left, _mm_set1_ps(4.0f * column + 3.0f)),
                                  _mm_cmpge_ps(right, _mm_set1_ps(4.0f * column)));
    mask |= static_cast<std::uint32_t>(_mm_movemask_ps(_mm_and_ps(hit, inside))) << (4 * column);
  }
  return mask;
}

#if defined(__AVX512F__)

// The masks of the sixteen entries `e` (those beyond `count` repeat another; their masks are 0), four entries side by
// side: `block_mask` with a lane for each entry and band.
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
    static_assert(X == 0 && Y == 1 && B == 3 && HALF_WIDTH == 10 && HALF_HEIGHT == 11 && DISCRIMINANT == 12 && WIDEST == 13 &&
                      HALF_OVER_A == 14 && FOUR_A_REACH == 15,
                  "the columns as they are picked below");
    const __m512 q0 = four(0), q2 = four(8), q3 = four(12);
    const __m512 b = _mm512_permute_ps(q0, 0xff), half_height = _mm512_permute_ps(q2, 0xff);
    const __m512 slack = _mm512_fmadd_ps(_mm512_set1_ps(1e-5f), _mm512_add_ps(_mm512_permute_ps(q2, 0xaa), half_height),
                                         _mm512_set1_ps(1e-3f));
    const __m512 limit = _mm512_add_ps(half_height, slack), below = _mm512_sub_ps(zero, limit);
    const __m512 y0 = _mm512_sub_ps(line, _mm512_permute_ps(q0, 0x55)), y1 = _mm512_add_ps(y0, _mm512_set1_ps(3.0f));
    const __m512 lo = _mm512_max_ps(y0, below), hi = _mm512_min_ps(y1, limit);
    const __m512 widest = _mm512_permute_ps(q3, 0x55);
    const __m512 y_right = _mm512_min_ps(_mm512_max_ps(widest, lo), hi);
    const __m512 y_left = _mm512_min_ps(_mm512_max_ps(_mm512_sub_ps(zero, widest), lo), hi);
    const __m512 d = _mm512_permute_ps(q3, 0x00), reach = _mm512_permute_ps(q3, 0xff), scale = _mm512_permute_ps(q3, 0xaa);
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

template <bool KNOWN, std::size_t ROOM>
void deal(const ForwardTile& t, std::size_t i, std::size_t end, std::uint32_t alive, std::uint32_t (*lists)[ROOM], int* sizes) {
  for (; i < end; ++i) {
    if (i + 6 < end) __builtin_prefetch(t.rows + 16 * static_cast<std::size_t>(t.entries[i + 6]));
    std::uint32_t mask = t.masks[i];
    if (!KNOWN) {
      mask = block_mask(t.rows + 16 * static_cast<std::size_t>(t.entries[i]), t.x, t.y) & alive;
      t.masks[i] = static_cast<std::uint16_t>(mask);
    }
    for (; mask; mask &= mask - 1) {
      const int s = __builtin_ctz(mask);
      lists[s][sizes[s]++] = t.entries[i];
    }
  }
}

#endif

// One block over one list. `state`: PLANES planes and, behind them, what is left of each pixel (0 where it has
// stopped); `moving`: MOVING planes for each of the K directions of `t`.
template <bool WITH_Z, int K>
bool composite(const ForwardTile& t, const std::uint32_t* list, int count, float x, float y, float* state, float* moving) {
  const V stop = all(t.stop);
  bool alive = false;
  for (int k = 0; k < PARTS; ++k) {
    float* s = state + LANES * k;
    const V px = load(COLUMN + LANES * k) + all(x), py = load(LINE + LANES * k) + all(y);
    V r = load(s), g = load(s + PIXELS), b = load(s + 2 * PIXELS), z{};
    if (WITH_Z) z = load(s + 3 * PIXELS);
    V kept = load(s + 4 * PIXELS), left = load(s + 5 * PIXELS);
    V m[K + 1][MOVING];
    for (int d = 0; d < K; ++d)
      for (int c = 0; c < MOVING; ++c) m[d][c] = load(moving + (d * MOVING + c) * PIXELS + LANES * k);
    for (int j = 0; j < count; ++j) {
      const std::size_t splat = list[j];
      const float* q = t.rows + 16 * splat;
      const V dx = px - all(q[X]), dy = py - all(q[Y]);
      const V u = fma(all(q[A]), dx, all(q[B]) * dy);
      V w = fnma(all(q[C]) * dy, dy, all(q[LOG2_OPACITY]));
      w = fnma(u, dx, w);
      const V raw = exp2(w);
      V a = least(raw, all(ALPHA_MAX));
      a = keep_ge(a, all(ALPHA_MIN), a);
      const V next = fnma(a, left, left);
      const V weight = keep_gt(next, stop, a * left);
      for (int d = 0; d < K; ++d) {
        const float* v = t.velocities[d] + 8 * splat;
        const V p = fma(all(v[VXX]), dx, fma(all(v[VXY]), dy, all(v[VX])));
        const V by_log = fma(p, dx, fma(all(v[VYY]), dy, all(v[VY])) * dy);
        // d weight = d alpha T + alpha dT; no alpha moves where it is clamped, nothing where the pixel has stopped.
        const V by_alpha = keep_ge(all(ALPHA_MAX), raw, by_log * weight);
        const V by_weight = keep_gt(next, stop, fma(a, m[d][3], by_alpha));
        m[d][0] = fma(by_weight, all(q[RED]), fma(weight, all(v[VRED]), m[d][0]));
        m[d][1] = fma(by_weight, all(q[GREEN]), fma(weight, all(v[VGREEN]), m[d][1]));
        m[d][2] = fma(by_weight, all(q[BLUE]), fma(weight, all(v[VBLUE]), m[d][2]));
        m[d][3] -= by_weight;
      }
      kept = pick_gt(next, stop, next, kept);
      left = keep_gt(next, stop, next);
      r = fma(weight, all(q[RED]), r);
      g = fma(weight, all(q[GREEN]), g);
      b = fma(weight, all(q[BLUE]), b);
      if (WITH_Z) z = fma(weight, all(q[DEPTH]), z);
      if ((j & 7) == 7 && !any(left)) break;
    }
    store(s, r);
    store(s + PIXELS, g);
    store(s + 2 * PIXELS, b);
    if (WITH_Z) store(s + 3 * PIXELS, z);
    store(s + 4 * PIXELS, kept);
    store(s + 5 * PIXELS, left);
    for (int d = 0; d < K; ++d)
      for (int c = 0; c < MOVING; ++c) store(moving + (d * MOVING + c) * PIXELS + LANES * k, m[d][c]);
    alive |= any(left);
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

template <bool WITH_GEOMETRY, bool WITH_COLOR, bool WITH_Z>
void backward_tile(const BackwardTile& t) {
  alignas(64) float left[PIXELS], behind[PIXELS];
  for (int i = 0; i < PIXELS; ++i) left[i] = 1;
  __builtin_memcpy(behind, t.adjoint + 4 * PIXELS, sizeof behind);
  const float *vr = t.adjoint, *vg = vr + PIXELS, *vb = vg + PIXELS, *vz = vb + PIXELS;
  const V stop = all(t.stop);
  std::uint32_t alive = 0xffff;
  for (std::size_t i = 0; i < t.count; ++i) {
    float* slot = t.slots + 16 * static_cast<std::size_t>(t.targets[i]);
    if (!(t.masks[i] & alive)) {
      __builtin_memset(slot, 0, 16 * sizeof(float));
      continue;
    }
    if (i + 4 < t.count) __builtin_prefetch(t.rows + 16 * static_cast<std::size_t>(t.entries[i + 4]));
    const float* q = t.rows + 16 * static_cast<std::size_t>(t.entries[i]);
    V s{}, sx{}, sy{}, sxx{}, sxy{}, syy{}, sr{}, sg{}, sb{}, sz{};
    for (std::uint32_t mask = t.masks[i] & alive; mask; mask &= mask - 1) {
      const int block = __builtin_ctz(mask);
      const float x = t.x + 4.0f * (block >> 2), y = t.y + 4.0f * (block & 3);
      bool block_alive = false;
      for (int k = 0; k < PARTS; ++k) {
        const int p = 16 * block + LANES * k;
        // The very operations of `composite`, in its order.
        const V dx = (load(COLUMN + LANES * k) + all(x)) - all(q[X]), dy = (load(LINE + LANES * k) + all(y)) - all(q[Y]);
        const V u = fma(all(q[A]), dx, all(q[B]) * dy);
        V w = fnma(all(q[C]) * dy, dy, all(q[LOG2_OPACITY]));
        w = fnma(u, dx, w);
        const V raw = exp2(w);
        V a = least(raw, all(ALPHA_MAX));
        a = keep_ge(a, all(ALPHA_MIN), a);
        const V now = load(left + p);
        const V next = fnma(a, now, now);
        const V weight = keep_gt(next, stop, a * now);
        const V after = keep_gt(next, stop, next);
        store(left + p, after);
        block_alive |= any(after);
        const V r = load(vr + p), g = load(vg + p), b = load(vb + p);
        if (WITH_GEOMETRY) {
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
      if (!block_alive) alive &= ~(1u << block);
    }
    const V moments[12] = {s, sx, sy, sxx, sxy, syy, sz, V{}, sr, sg, sb, V{}};
    store_sums(moments, slot);
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
