#pragma once
// A vector of LANES floats as wide as the instruction set that a file is compiled for, in GCC vector extensions, with
// the operations that those lack; transposition between tables of records and vectors of fields; dual numbers of
// vectors. AVX2 and AVX-512 give the same bits with every maker's processor: nothing takes an approximate reciprocal,
// and sums over lanes are taken in one order, that of four groups of four lanes. Everything has internal linkage: the linker must not pick code compiled for a wider instruction set for
// other files.
#if defined(__AVX2__)
#include <immintrin.h>
#else
// All that the baseline needs; it is read in a tenth of the time.
#include <emmintrin.h>
#endif

#include <cstddef>
#include <cstdint>

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
constexpr int PARTS = 16 / LANES;  // vectors that a block of 4x4 pixels, or a row of 16 floats, takes
typedef float V __attribute__((vector_size(4 * LANES)));
typedef int VI __attribute__((vector_size(4 * LANES)));
typedef float V4 __attribute__((vector_size(16)));
// Half as many lanes: what fits into a vector of doubles.
typedef float VH __attribute__((vector_size(2 * LANES)));
typedef double VD __attribute__((vector_size(4 * LANES)));
typedef double D4 __attribute__((vector_size(32)));

inline V broadcast(float v) { return v - V{}; }

// Below, lanes of a comparison (VI) are -1 where it holds and 0 elsewhere. The comments of the AVX-512 functions hold
// for the others of the same name.
#if defined(__AVX512F__)
// a b + c and c - a b, rounded once where the instruction set has it.
inline V fma(V a, V b, V c) { return (V)_mm512_fmadd_ps((__m512)a, (__m512)b, (__m512)c); }
inline V fnma(V a, V b, V c) { return (V)_mm512_fnmadd_ps((__m512)a, (__m512)b, (__m512)c); }
// min and max give b where the two cannot be compared.
inline V min(V a, V b) { return (V)_mm512_min_ps((__m512)a, (__m512)b); }
inline V max(V a, V b) { return (V)_mm512_max_ps((__m512)a, (__m512)b); }
// v where a >= b (a > b), 0 elsewhere.
inline V keep_ge(V a, V b, V v) {
  return (V)_mm512_maskz_mov_ps(_mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_GE_OQ), (__m512)v);
}
inline V keep_gt(V a, V b, V v) {
  return (V)_mm512_maskz_mov_ps(_mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_GT_OQ), (__m512)v);
}
// min(v, high) where v >= low, 0 elsewhere; low <= high.
inline V clip(V v, V low, V high) {
  return (V)_mm512_maskz_min_ps(_mm512_cmp_ps_mask((__m512)v, (__m512)low, _CMP_GE_OQ), (__m512)v, (__m512)high);
}
// x where a > b, y elsewhere.
inline V select_gt(V a, V b, V x, V y) {
  return (V)_mm512_mask_mov_ps((__m512)y, _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_GT_OQ), (__m512)x);
}
// Whether any lane has a bit set.
inline bool any(V a) { return _mm512_test_epi32_mask((__m512i)a, (__m512i)a) != 0; }
// p 2^n for whole n.
inline V scale_by_power_of_two(V p, V n) { return (V)_mm512_scalef_ps((__m512)p, (__m512)n); }
inline V round_to_integer(V x) { return (V)_mm512_roundscale_ps((__m512)x, 8); }
#else
inline V keep_ge(V a, V b, V v) { return (V)((VI)v & (VI)(a >= b)); }
inline V keep_gt(V a, V b, V v) { return (V)((VI)v & (VI)(a > b)); }
inline V scale_by_power_of_two(V p, V n) {
  // Below -126 the result is far under ALPHA_MIN whatever its exact value; the exponent must only not wrap.
  V m = (V) __builtin_convertvector(n, VI);
  VI e = (VI)m + 127;
  e = e & (VI)(e > 0);
  return p * (V)(e << 23);
}
#if defined(__AVX2__)
inline V fma(V a, V b, V c) { return (V)_mm256_fmadd_ps((__m256)a, (__m256)b, (__m256)c); }
inline V fnma(V a, V b, V c) { return (V)_mm256_fnmadd_ps((__m256)a, (__m256)b, (__m256)c); }
inline V min(V a, V b) { return (V)_mm256_min_ps((__m256)a, (__m256)b); }
inline V max(V a, V b) { return (V)_mm256_max_ps((__m256)a, (__m256)b); }
// Field N of each four in all four of them.
template <int N>
inline V broadcast_field(V v) {
  return (V)_mm256_permute_ps((__m256)v, 0x55 * N);
}
// One bit a lane.
inline int bits_of(VI condition) { return _mm256_movemask_ps((__m256)condition); }
inline V select_gt(V a, V b, V x, V y) {
  return (V)_mm256_blendv_ps((__m256)y, (__m256)x, _mm256_cmp_ps((__m256)a, (__m256)b, _CMP_GT_OQ));
}
inline bool any(V a) { return !_mm256_testz_si256((__m256i)a, (__m256i)a); }
inline V round_to_integer(V x) { return (V)_mm256_round_ps((__m256)x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC); }
#else
inline V fma(V a, V b, V c) { return a * b + c; }
inline V fnma(V a, V b, V c) { return c - a * b; }
inline V min(V a, V b) { return (V)_mm_min_ps((__m128)a, (__m128)b); }
inline V max(V a, V b) { return (V)_mm_max_ps((__m128)a, (__m128)b); }
template <int N>
inline V broadcast_field(V v) {
  return (V)_mm_shuffle_ps((__m128)v, (__m128)v, 0x55 * N);
}
inline int bits_of(VI condition) { return _mm_movemask_ps((__m128)condition); }
inline V select_gt(V a, V b, V x, V y) { return (V)(((VI)x & (VI)(a > b)) | ((VI)y & ~(VI)(a > b))); }
inline bool any(V a) { return _mm_movemask_epi8(_mm_cmpeq_epi32((__m128i)a, _mm_setzero_si128())) != 0xffff; }
inline V round_to_integer(V x) {
  // Adding and taking away 1.5 * 2^23 rounds to the nearest integer (|x| < 2^22: see the clamp in exp2).
  return (x + broadcast(12582912.0f)) - broadcast(12582912.0f);
}
#endif
inline V clip(V v, V low, V high) { return keep_ge(v, low, min(v, high)); }
#endif

// 1 / x for x in 1e-37..1e37, relative error 1.2e-7: a linear guess from the bits, 12 % off at most, and two steps of
// Halley's method, which cube the error. Division takes twice as long; the processor's own approximation has other last
// bits with every maker.
inline V reciprocal(V x) {
  V r = (V)(0x7ef311c3 - (VI)x);
  for (int step = 0; step < 2; ++step) {
    const V error = fnma(x, r, broadcast(1));
    r = fma(r, fma(error, error, error), r);
  }
  return r;
}

// Each of U vectors: 2^x for x <= 127, relative error 1.5e-7 (minimax polynomial of degree 5 of 2^f, |f| <= 1/2).
template <int U>
inline void exp2(V* x) {
  constexpr float TERMS[] = {9.675541334e-3f, 5.550713274e-2f, 2.402211972e-1f, 6.931469671e-1f, 1.0f};
  V n[U], p[U];
  for (int u = 0; u < U; ++u) {
#if !defined(__AVX512F__)
    x[u] = select_gt(x[u], broadcast(-1000.0f), x[u], broadcast(-1000.0f));
#endif
    n[u] = round_to_integer(x[u]);
  }
  for (int u = 0; u < U; ++u) x[u] = x[u] - n[u], p[u] = broadcast(1.327647198e-3f);
  for (float term : TERMS)
    for (int u = 0; u < U; ++u) p[u] = fma(p[u], x[u], broadcast(term));
  for (int u = 0; u < U; ++u) x[u] = scale_by_power_of_two(p[u], n[u]);
}

inline V load(const float* p) {
  V v;
  __builtin_memcpy(&v, p, sizeof v);
  return v;
}
inline void store(float* p, V v) { __builtin_memcpy(p, &v, sizeof v); }

// Adds the lanes to four sums in double, four lanes after four: the same sums for every LANES.
inline void add_in_double(D4& sums, V v) {
  V4 four[LANES / 4];
  __builtin_memcpy(four, &v, sizeof v);
  for (const V4& group : four) sums += __builtin_convertvector(group, D4);
}

#if defined(__AVX512F__)
// join: LANES / 4 vectors of four to one; split: the inverse.
inline V square_root(V v) { return (V)_mm512_sqrt_ps((__m512)v); }
inline VD square_root(VD v) { return (VD)_mm512_sqrt_pd((__m512d)v); }
inline V join(const __m128* p) {
  __m512 v = _mm512_insertf32x4(_mm512_castps128_ps512(p[0]), p[1], 1);
  return (V)_mm512_insertf32x4(_mm512_insertf32x4(v, p[2], 2), p[3], 3);
}
inline void split(V v, __m128* p) {
  p[0] = _mm512_castps512_ps128((__m512)v);
  p[1] = _mm512_extractf32x4_ps((__m512)v, 1);
  p[2] = _mm512_extractf32x4_ps((__m512)v, 2);
  p[3] = _mm512_extractf32x4_ps((__m512)v, 3);
}
#elif defined(__AVX2__)
inline V square_root(V v) { return (V)_mm256_sqrt_ps((__m256)v); }
inline VD square_root(VD v) { return (VD)_mm256_sqrt_pd((__m256d)v); }
inline V join(const __m128* p) { return (V)_mm256_insertf128_ps(_mm256_castps128_ps256(p[0]), p[1], 1); }
inline void split(V v, __m128* p) {
  p[0] = _mm256_castps256_ps128((__m256)v);
  p[1] = _mm256_extractf128_ps((__m256)v, 1);
}
#else
inline V square_root(V v) { return (V)_mm_sqrt_ps((__m128)v); }
inline VD square_root(VD v) { return (VD)_mm_sqrt_pd((__m128d)v); }
inline V join(const __m128* p) { return (V)p[0]; }
inline void split(V v, __m128* p) { p[0] = (__m128)v; }
#endif

inline V select(VI condition, V yes, V no) { return (V)(((VI)yes & condition) | ((VI)no & ~condition)); }
inline V keep(VI condition, V v) { return (V)((VI)v & condition); }
inline bool any_of(VI condition) { return any((V)condition); }
inline V absolute(V v) { return (V)((VI)v & 0x7fffffff); }
// 0 times infinity and infinities of both signs give NaN: a sum is finite only if every term is.
inline VI finite(V v) { return (v - v) == V{}; }

// log2 of a positive, finite, normal number: relative error of 2^result below 1e-6 for |result| < 16.
inline V log2(V x) {
  const VI bits = (VI)x;
  // Mantissa in [sqrt(1/2), sqrt(2)).
  const VI exponent = (bits - 0x3f3504f3) >> 23;
  const V m = (V)(bits - (exponent << 23));
  const V s = (m - 1.0f) / (m + 1.0f), ss = s * s;
  V p = broadcast(0.32059889f);
  p = fma(p, ss, broadcast(0.41219858f));
  p = fma(p, ss, broadcast(0.57707802f));
  p = fma(p, ss, broadcast(0.96179669f));
  p = fma(p, ss, broadcast(2.88539008f));
  return fma(p, s, __builtin_convertvector(exponent, V));
}

// N < 4 floats, nothing read beyond. Two floats are moved as one double, by a copy, since they are aligned as floats.
template <int N>
inline __m128 load_few(const float* p) {
  if (N == 1) return _mm_load_ss(p);
  double both;
  __builtin_memcpy(&both, p, sizeof both);
  const __m128 two = _mm_castpd_ps(_mm_set_sd(both));
  return N == 2 ? two : _mm_movelh_ps(two, _mm_load_ss(p + 2));
}

template <int N>
inline void store_few(float* p, __m128 v) {
  if (N == 1) return _mm_store_ss(p, v);
  const double both = _mm_cvtsd_f64(_mm_castps_pd(v));
  __builtin_memcpy(p, &both, sizeof both);
  if (N == 3) _mm_store_ss(p + 2, _mm_movehl_ps(v, v));
}

// Four vectors as the rows of 4x4 matrices, one per four lanes: transposed.
inline void transpose(V* v) {
#if defined(__AVX512F__)
  const __m512 a = (__m512)v[0], b = (__m512)v[1], c = (__m512)v[2], d = (__m512)v[3];
  const __m512 ab = _mm512_unpacklo_ps(a, b), cd = _mm512_unpacklo_ps(c, d);
  const __m512 ab_high = _mm512_unpackhi_ps(a, b), cd_high = _mm512_unpackhi_ps(c, d);
  v[0] = (V)_mm512_shuffle_ps(ab, cd, 0x44), v[1] = (V)_mm512_shuffle_ps(ab, cd, 0xee);
  v[2] = (V)_mm512_shuffle_ps(ab_high, cd_high, 0x44), v[3] = (V)_mm512_shuffle_ps(ab_high, cd_high, 0xee);
#elif defined(__AVX2__)
  const __m256 a = (__m256)v[0], b = (__m256)v[1], c = (__m256)v[2], d = (__m256)v[3];
  const __m256 ab = _mm256_unpacklo_ps(a, b), cd = _mm256_unpacklo_ps(c, d);
  const __m256 ab_high = _mm256_unpackhi_ps(a, b), cd_high = _mm256_unpackhi_ps(c, d);
  v[0] = (V)_mm256_shuffle_ps(ab, cd, 0x44), v[1] = (V)_mm256_shuffle_ps(ab, cd, 0xee);
  v[2] = (V)_mm256_shuffle_ps(ab_high, cd_high, 0x44), v[3] = (V)_mm256_shuffle_ps(ab_high, cd_high, 0xee);
#else
  __m128 a = (__m128)v[0], b = (__m128)v[1], c = (__m128)v[2], d = (__m128)v[3];
  _MM_TRANSPOSE4_PS(a, b, c, d);
  v[0] = (V)a, v[1] = (V)b, v[2] = (V)c, v[3] = (V)d;
#endif
}

// The sums over each group of four lanes, (v[0] + v[2]) + (v[1] + v[3]), of four vectors: lane 4 g + k of the result is
// that of group g of argument k.
inline V sums_of_groups(V a, V b, V c, V d) {
#if defined(__AVX512F__)
  const __m512 ab = _mm512_add_ps(_mm512_unpacklo_ps((__m512)a, (__m512)b), _mm512_unpackhi_ps((__m512)a, (__m512)b));
  const __m512 cd = _mm512_add_ps(_mm512_unpacklo_ps((__m512)c, (__m512)d), _mm512_unpackhi_ps((__m512)c, (__m512)d));
  return (V)_mm512_add_ps(_mm512_shuffle_ps(ab, cd, 0x44), _mm512_shuffle_ps(ab, cd, 0xee));
#elif defined(__AVX2__)
  const __m256 ab = _mm256_add_ps(_mm256_unpacklo_ps((__m256)a, (__m256)b), _mm256_unpackhi_ps((__m256)a, (__m256)b));
  const __m256 cd = _mm256_add_ps(_mm256_unpacklo_ps((__m256)c, (__m256)d), _mm256_unpackhi_ps((__m256)c, (__m256)d));
  return (V)_mm256_add_ps(_mm256_shuffle_ps(ab, cd, 0x44), _mm256_shuffle_ps(ab, cd, 0xee));
#else
  const __m128 ab = _mm_add_ps(_mm_unpacklo_ps((__m128)a, (__m128)b), _mm_unpackhi_ps((__m128)a, (__m128)b));
  const __m128 cd = _mm_add_ps(_mm_unpacklo_ps((__m128)c, (__m128)d), _mm_unpackhi_ps((__m128)c, (__m128)d));
  return (V)_mm_add_ps(_mm_movelh_ps(ab, cd), _mm_movehl_ps(cd, ab));
#endif
}

// The sum of the four groups of the sixteen lanes in `parts`, (0 + 2) + (1 + 3).
inline __m128 sum_of_sixteen(const V* parts) {
  __m128 g[4];
  for (int p = 0; p < PARTS; ++p) split(parts[p], g + LANES / 4 * p);
  return _mm_add_ps(_mm_add_ps(g[0], g[2]), _mm_add_ps(g[1], g[3]));
}

// Gathers N fields of the records named by `index`: out[f] lane l = base[N * index[l] + f].
template <int N>
inline void gather(const float* base, const std::uint32_t* index, V* out) {
  constexpr int REST = N % 4 ? N % 4 : 1;
  for (int f = 0; f < N; f += 4) {
    V rows[4];
    for (int j = 0; j < 4; ++j) {
      __m128 parts[LANES / 4];
      for (int g = 0; g < LANES / 4; ++g) {
        const float* p = base + static_cast<std::size_t>(N) * index[4 * g + j] + f;
        parts[g] = f + 4 <= N ? _mm_loadu_ps(p) : load_few<REST>(p);
      }
      rows[j] = join(parts);
    }
    transpose(rows);
    for (int k = 0; k < 4 && f + k < N; ++k) out[f + k] = rows[k];
  }
}

// out[f] lane l = base[3 * l + f], of LANES Gaussians one after the other.
#if defined(__AVX512F__)
inline void load_triples(const float* base, V* out) {
  const __m512 a = _mm512_loadu_ps(base), b = _mm512_loadu_ps(base + 16), c = _mm512_loadu_ps(base + 32);
  const __m512i third = _mm512_setr_epi32(0, 3, 6, 9, 12, 15, 18, 21, 24, 27, 30, 33, 36, 39, 42, 45);
  const __m512i lane = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  for (int f = 0; f < 3; ++f) {
    const __m512i from = _mm512_add_epi32(third, _mm512_set1_epi32(f));
    const __m512 ab = _mm512_permutex2var_ps(a, from, b);
    // From 32 on: in c, which the second permutation numbers from 16 on.
    const __mmask16 in_c = _mm512_cmpge_epi32_mask(from, _mm512_set1_epi32(32));
    out[f] = (V)_mm512_permutex2var_ps(ab, _mm512_mask_sub_epi32(lane, in_c, from, _mm512_set1_epi32(16)), c);
  }
}
#else
#if defined(__AVX2__)
// Four floats at p, and the twelfth from there on.
inline V load_four_of_each(const float* p) {
  return (V)_mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p)), _mm_loadu_ps(p + 12), 1);
}
template <int ORDER>
inline V shuffle(V a, V b) {
  return (V)_mm256_shuffle_ps((__m256)a, (__m256)b, ORDER);
}
#else
inline V load_four_of_each(const float* p) { return load(p); }
template <int ORDER>
inline V shuffle(V a, V b) {
  return (V)_mm_shuffle_ps((__m128)a, (__m128)b, ORDER);
}
#endif
inline void load_triples(const float* base, V* out) {
  // Per four Gaussians: a = x0 y0 z0 x1, b = y1 z1 x2 y2, c = z2 x3 y3 z3.
  const V a = load_four_of_each(base), b = load_four_of_each(base + 4), c = load_four_of_each(base + 8);
  const V xy = shuffle<_MM_SHUFFLE(2, 1, 3, 2)>(b, c), yz = shuffle<_MM_SHUFFLE(1, 0, 2, 1)>(a, b);
  out[0] = shuffle<_MM_SHUFFLE(2, 0, 3, 0)>(a, xy);
  out[1] = shuffle<_MM_SHUFFLE(3, 1, 2, 0)>(yz, xy);
  out[2] = shuffle<_MM_SHUFFLE(3, 0, 3, 1)>(yz, c);
}
#endif

// base[N * l + f] = in[f] lane l, for the first `count` lanes; written in the order of the addresses, which is fastest.
template <int N>
inline void scatter(float* base, int count, const V* in) {
  constexpr int FOURS = (N + 3) / 4, REST = N % 4 ? N % 4 : 1;
  __m128 parts[4 * FOURS][LANES / 4];
  for (int f = 0; f < FOURS; ++f) {
    V rows[4];
    for (int k = 0; k < 4; ++k) rows[k] = 4 * f + k < N ? in[4 * f + k] : V{};
    transpose(rows);
    for (int k = 0; k < 4; ++k) split(rows[k], parts[4 * f + k]);
  }
  for (int l = 0; l < LANES; ++l) {
    if (l >= count) break;
    float* p = base + static_cast<std::size_t>(N) * l;
    for (int f = 0; f < FOURS; ++f) {
      const __m128 v = parts[4 * f + l % 4][l / 4];
      if (4 * f + 4 <= N) {
        _mm_storeu_ps(p + 4 * f, v);
      } else {
        store_few<REST>(p + 4 * f, v);
      }
    }
  }
}

// A value and its derivative along one direction: a + b e with e^2 = 0.
struct Dual {
  V v, d;
};
inline Dual operator+(Dual a, Dual b) { return {a.v + b.v, a.d + b.d}; }
inline Dual operator-(Dual a, Dual b) { return {a.v - b.v, a.d - b.d}; }
inline Dual operator-(Dual a) { return {-a.v, -a.d}; }
inline Dual operator*(Dual a, Dual b) { return {a.v * b.v, a.d * b.v + a.v * b.d}; }
inline Dual operator*(Dual a, float b) { return {a.v * b, a.d * b}; }
inline Dual operator*(float a, Dual b) { return b * a; }
inline Dual operator*(Dual a, V b) { return {a.v * b, a.d * b}; }
inline Dual operator+(Dual a, float b) { return {a.v + b, a.d}; }
inline Dual operator-(Dual a, float b) { return {a.v - b, a.d}; }
inline Dual reciprocal_of(Dual a) {
  const V r = 1.0f / a.v;
  return {r, -a.d * r * r};
}
inline V reciprocal_of(V a) { return 1.0f / a; }
inline Dual square_root(Dual a) {
  const V r = square_root(a.v);
  return {r, keep(r > 0.0f, a.d * 0.5f / r)};
}
inline V clamp(V a, float low, float high) { return min(max(a, broadcast(low)), broadcast(high)); }
inline Dual clamp(Dual a, float low, float high) {
  const V c = clamp(a.v, low, high);
  return {c, keep(c == a.v, a.d)};
}
inline V value(V a) { return a; }
inline V value(Dual a) { return a.v; }
// Sets a number that does not depend on anything.
inline void constant(V a, V* out) { *out = a; }
inline void constant(V a, Dual* out) { *out = {a, V{}}; }

}  // namespace
}  // namespace RESPIRE_ISA
}  // namespace respire
