// Compositing of one 16x16 tile, forward and backward, in GCC vector extensions; compiled once per instruction set
// with -DRESPIRE_ISA=<namespace>. The plain twin is src/splat/kernel.rs, which also explains the symbols.
//
// A tile is 16 blocks of 4x4 pixels. For each entry (splat in tile) a mask says which blocks the ellipse alpha >= 1/255
// can touch. Forward: entries are dealt to the lists of their blocks, and a block is composited with its state in
// registers. Backward: entry by entry, front to back, replaying the forward decisions, so that the nine sums of an
// entry are reduced once per tile. A pixel that has stopped is one whose running transmittance is 0.
#include "cpp/splat_kernel.h"

#include <immintrin.h>

namespace respire {
namespace RESPIRE_ISA {
namespace {

#if defined(__AVX512F__)
constexpr int LANES = 16;
#elif defined(__AVX2__)
constexpr int LANES = 8;
#else
constexpr int LANES = 4;
#endif
constexpr int PARTS = 16 / LANES;
typedef float V __attribute__((vector_size(4 * LANES)));
typedef float V4 __attribute__((vector_size(16)));

constexpr float ALPHA_MIN = 1.0f / 255.0f;
constexpr float ALPHA_MAX = 0.99f;
constexpr float STOP = 1e-4f;
constexpr float LOG2_255 = 7.994353436858858f;

inline V all(float v) { return v - V{}; }

#if defined(__AVX512F__)
inline V fma(V a, V b, V c) { return (V)_mm512_fmadd_ps((__m512)a, (__m512)b, (__m512)c); }
inline V fnma(V a, V b, V c) { return (V)_mm512_fnmadd_ps((__m512)a, (__m512)b, (__m512)c); }
inline V least(V a, V b) { return (V)_mm512_min_ps((__m512)a, (__m512)b); }
inline V keep_ge(V a, V b, V v) {
  return (V)_mm512_maskz_mov_ps(_mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_GE_OQ), (__m512)v);
}
inline V keep_gt(V a, V b, V v) {
  return (V)_mm512_maskz_mov_ps(_mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_GT_OQ), (__m512)v);
}
inline V pick_gt(V a, V b, V x, V y) {
  return (V)_mm512_mask_mov_ps((__m512)y, _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_GT_OQ), (__m512)x);
}
inline bool any(V a) { return _mm512_test_epi32_mask((__m512i)a, (__m512i)a) != 0; }
inline V power2(V x, V p, V n) { (void)x; return (V)_mm512_scalef_ps((__m512)p, (__m512)n); }
inline V nearest(V x) { return (V)_mm512_roundscale_ps((__m512)x, 8); }
inline V reciprocal(V x) {
  V r = (V)_mm512_rcp14_ps((__m512)x);
  return r * fnma(x, r, all(2));
}
inline V4 fold(V v) {
  __m256 h = _mm256_add_ps(_mm512_castps512_ps256((__m512)v),
                           _mm256_castpd_ps(_mm512_extractf64x4_pd(_mm512_castps_pd((__m512)v), 1)));
  return (V4)_mm_add_ps(_mm256_castps256_ps128(h), _mm256_extractf128_ps(h, 1));
}
#else
typedef int VI __attribute__((vector_size(4 * LANES)));
inline V keep_ge(V a, V b, V v) { return (V)((VI)v & (VI)(a >= b)); }
inline V keep_gt(V a, V b, V v) { return (V)((VI)v & (VI)(a > b)); }
inline V power2(V x, V p, V n) {
  // Below -126 the result is far under ALPHA_MIN whatever its exact value; the exponent must only not wrap.
  (void)x;
  V m = (V)__builtin_convertvector(n, VI);
  VI e = (VI)m + 127;
  e = e & (VI)(e > 0);
  return p * (V)(e << 23);
}
#if defined(__AVX2__)
inline V fma(V a, V b, V c) { return (V)_mm256_fmadd_ps((__m256)a, (__m256)b, (__m256)c); }
inline V fnma(V a, V b, V c) { return (V)_mm256_fnmadd_ps((__m256)a, (__m256)b, (__m256)c); }
inline V least(V a, V b) { return (V)_mm256_min_ps((__m256)a, (__m256)b); }
inline V pick_gt(V a, V b, V x, V y) {
  return (V)_mm256_blendv_ps((__m256)y, (__m256)x, _mm256_cmp_ps((__m256)a, (__m256)b, _CMP_GT_OQ));
}
inline bool any(V a) { return !_mm256_testz_si256((__m256i)a, (__m256i)a); }
inline V nearest(V x) { return (V)_mm256_round_ps((__m256)x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC); }
inline V4 fold(V v) {
  return (V4)_mm_add_ps(_mm256_castps256_ps128((__m256)v), _mm256_extractf128_ps((__m256)v, 1));
}
#else
inline V fma(V a, V b, V c) { return a * b + c; }
inline V fnma(V a, V b, V c) { return c - a * b; }
inline V least(V a, V b) { return (V)_mm_min_ps((__m128)a, (__m128)b); }
inline V pick_gt(V a, V b, V x, V y) { return (V)(((VI)x & (VI)(a > b)) | ((VI)y & ~(VI)(a > b))); }
inline bool any(V a) { return _mm_movemask_epi8(_mm_cmpeq_epi32((__m128i)a, _mm_setzero_si128())) != 0xffff; }
inline V nearest(V x) {
  // Adding and taking away 1.5 * 2^23 rounds to the nearest integer (|x| < 2^22: see the clamp in exp2).
  return (x + all(12582912.0f)) - all(12582912.0f);
}
inline V4 fold(V v) { return v; }
#endif
inline V reciprocal(V x) { return 1.0f / x; }
#endif

// 2^x for x <= 127, relative error 2e-7 (Taylor polynomial of degree 6 of 2^f, |f| <= 1/2).
inline V exp2(V x) {
#if !defined(__AVX512F__)
  x = pick_gt(x, all(-1000.0f), x, all(-1000.0f));
#endif
  V n = nearest(x), f = x - n;
  V p = all(1.5397100e-4f);
  p = fma(p, f, all(1.3335997e-3f));
  p = fma(p, f, all(9.6181290e-3f));
  p = fma(p, f, all(5.5504109e-2f));
  p = fma(p, f, all(2.4022651e-1f));
  p = fma(p, f, all(6.9314718e-1f));
  p = fma(p, f, all(1.0f));
  return power2(x, p, n);
}

inline V load(const float* p) {
  V v;
  __builtin_memcpy(&v, p, sizeof v);
  return v;
}
inline void store(float* p, V v) { __builtin_memcpy(p, &v, sizeof v); }

// Pixel centres of a block relative to the tile's corner.
alignas(64) const float COLUMN[16] = {.5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5, .5, 1.5, 2.5, 3.5};
alignas(64) const float LINE[16] = {.5, .5, .5, .5, 1.5, 1.5, 1.5, 1.5, 2.5, 2.5, 2.5, 2.5, 3.5, 3.5, 3.5, 3.5};

// Blocks whose pixel centres the ellipse can reach: the x-extent of the ellipse over each band of 4 pixel rows, the
// four bands side by side in one vector, against the four columns of blocks.
inline std::uint32_t block_mask(const float* q, float tile_x, float tile_y) {
  const __m128 zero = _mm_setzero_ps();
  const float reach = q[LOG2_OPACITY] + LOG2_255;
  const float slack = 1e-3f + 1e-5f * (q[HALF_WIDTH] + q[HALF_HEIGHT]);
  const float hy = q[HALF_HEIGHT] + slack;
  const __m128 y0 = _mm_add_ps(_mm_setr_ps(0.5f, 4.5f, 8.5f, 12.5f), _mm_set1_ps(tile_y - q[Y]));
  const __m128 y1 = _mm_add_ps(y0, _mm_set1_ps(3.0f));
  const __m128 lo = _mm_max_ps(y0, _mm_set1_ps(-hy)), hi = _mm_min_ps(y1, _mm_set1_ps(hy));
  const __m128 inside = _mm_cmple_ps(lo, hi);
  // The ellipse is widest to the right at y = -B half_width / (2 C), to the left at the opposite point.
  const float widest = -0.5f * q[B] * q[HALF_WIDTH] / q[C];
  const __m128 y_right = _mm_min_ps(_mm_max_ps(_mm_set1_ps(widest), lo), hi);
  const __m128 y_left = _mm_min_ps(_mm_max_ps(_mm_set1_ps(-widest), lo), hi);
  const float half_over_a = 0.5f / q[A];
  const __m128 d = _mm_set1_ps(q[DISCRIMINANT]), k = _mm_set1_ps(4 * q[A] * reach);
  const __m128 b = _mm_set1_ps(-q[B]), scale = _mm_set1_ps(half_over_a);
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

struct Block {
  V part[PARTS];
};

template <bool WITH_Z>
void composite(const float* rows, const std::uint32_t* list, int count, float x, float y, float* state, bool& done) {
  V px[PARTS], py[PARTS], left[PARTS], kept[PARTS], r[PARTS], g[PARTS], b[PARTS], z[PARTS];
  for (int k = 0; k < PARTS; ++k) {
    px[k] = load(COLUMN + LANES * k) + all(x);
    py[k] = load(LINE + LANES * k) + all(y);
    float* s = state + LANES * k;
    r[k] = load(s);
    g[k] = load(s + PIXELS);
    b[k] = load(s + 2 * PIXELS);
    if (WITH_Z) z[k] = load(s + 3 * PIXELS);
    kept[k] = load(s + 4 * PIXELS);
    left[k] = load(s + 5 * PIXELS);
  }
  for (int j = 0; j < count; ++j) {
    const float* q = rows + 16 * static_cast<std::size_t>(list[j]);
    for (int k = 0; k < PARTS; ++k) {
      const V dx = px[k] - all(q[X]), dy = py[k] - all(q[Y]);
      const V u = fma(all(q[A]), dx, all(q[B]) * dy);
      V w = fnma(all(q[C]) * dy, dy, all(q[LOG2_OPACITY]));
      w = fnma(u, dx, w);
      V a = least(exp2(w), all(ALPHA_MAX));
      a = keep_ge(a, all(ALPHA_MIN), a);
      const V next = fnma(a, left[k], left[k]);
      const V weight = keep_gt(next, all(STOP), a * left[k]);
      kept[k] = pick_gt(next, all(STOP), next, kept[k]);
      left[k] = keep_gt(next, all(STOP), next);
      r[k] = fma(weight, all(q[RED]), r[k]);
      g[k] = fma(weight, all(q[GREEN]), g[k]);
      b[k] = fma(weight, all(q[BLUE]), b[k]);
      if (WITH_Z) z[k] = fma(weight, all(q[DEPTH]), z[k]);
    }
    if ((j & 7) == 7) {
      bool alive = false;
      for (int k = 0; k < PARTS; ++k) alive |= any(left[k]);
      if (!alive) break;
    }
  }
  bool alive = false;
  for (int k = 0; k < PARTS; ++k) {
    float* s = state + LANES * k;
    store(s, r[k]);
    store(s + PIXELS, g[k]);
    store(s + 2 * PIXELS, b[k]);
    if (WITH_Z) store(s + 3 * PIXELS, z[k]);
    store(s + 4 * PIXELS, kept[k]);
    store(s + 5 * PIXELS, left[k]);
    alive |= any(left[k]);
  }
  done = !alive;
}

template <bool WITH_Z>
void forward_tile(const ForwardTile& t) {
  constexpr std::size_t CHUNK = 192;
  std::uint32_t lists[16][CHUNK];
  int sizes[16];
  alignas(64) float state[6 * PIXELS];
  for (int i = 0; i < 4 * PIXELS; ++i) state[i] = 0;
  for (int i = 4 * PIXELS; i < 6 * PIXELS; ++i) state[i] = 1;
  std::uint32_t alive = 0xffff;
  std::size_t i = 0;
  while (i < t.count && alive) {
    const std::size_t end = i + CHUNK < t.count ? i + CHUNK : t.count;
    for (int& size : sizes) size = 0;
    for (; i < end; ++i) {
      if (i + 6 < end) __builtin_prefetch(t.rows + 16 * static_cast<std::size_t>(t.entries[i + 6]));
      std::uint32_t mask = block_mask(t.rows + 16 * static_cast<std::size_t>(t.entries[i]), t.x, t.y) & alive;
      t.masks[i] = static_cast<std::uint16_t>(mask);
      for (; mask; mask &= mask - 1) {
        const int s = __builtin_ctz(mask);
        lists[s][sizes[s]++] = t.entries[i];
      }
    }
    for (std::uint32_t todo = alive; todo; todo &= todo - 1) {
      const int s = __builtin_ctz(todo);
      if (!sizes[s]) continue;
      bool done = false;
      composite<WITH_Z>(t.rows, lists[s], sizes[s], t.x + 4.0f * (s >> 2), t.y + 4.0f * (s & 3), state + 16 * s, done);
      if (done) alive &= ~(1u << s);
    }
  }
  for (; i < t.count; ++i) t.masks[i] = 0;
  __builtin_memcpy(t.state, state, 5 * PIXELS * sizeof(float));
}

// Four sums at once: lane k of the result is the sum over the lanes of argument k.
inline __m128 sums(V a, V b, V c, V d) {
  const __m128 fa = (__m128)fold(a), fb = (__m128)fold(b), fc = (__m128)fold(c), fd = (__m128)fold(d);
  const __m128 ab = _mm_add_ps(_mm_unpacklo_ps(fa, fb), _mm_unpackhi_ps(fa, fb));
  const __m128 cd = _mm_add_ps(_mm_unpacklo_ps(fc, fd), _mm_unpackhi_ps(fc, fd));
  return _mm_add_ps(_mm_movelh_ps(ab, cd), _mm_movehl_ps(cd, ab));
}

template <bool WITH_GEOMETRY, bool WITH_COLOR, bool WITH_Z>
void backward_tile(const BackwardTile& t) {
  alignas(64) float left[PIXELS], behind[PIXELS];
  for (int i = 0; i < PIXELS; ++i) left[i] = 1;
  __builtin_memcpy(behind, t.adjoint + 4 * PIXELS, sizeof behind);
  const float *vr = t.adjoint, *vg = vr + PIXELS, *vb = vg + PIXELS, *vz = vb + PIXELS;
  std::uint32_t alive = 0xffff;
  for (std::size_t i = 0; i < t.count; ++i) {
    if (!t.masks[i]) continue;
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
        const V weight = keep_gt(next, all(STOP), a * now);
        const V after = keep_gt(next, all(STOP), next);
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
          V v = keep_gt(next, all(STOP), a * by_alpha);
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
    float* slot = t.slots + 16 * i;
    if (WITH_GEOMETRY) {
      _mm_storeu_ps(slot, sums(s, sx, sy, sxx));
      _mm_storeu_ps(slot + 4, sums(sxy, syy, sz, V{}));
    }
    if (WITH_COLOR) _mm_storeu_ps(slot + 8, sums(sr, sg, sb, V{}));
  }
}

}  // namespace

void forward(const ForwardTile& t, std::uint32_t parts) {
  if (parts & WITH_DEPTH) {
    forward_tile<true>(t);
  } else {
    forward_tile<false>(t);
  }
}

void backward(const BackwardTile& t, std::uint32_t parts) {
  switch (parts) {
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
