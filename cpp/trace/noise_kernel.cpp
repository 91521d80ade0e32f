#include "cpp/trace/noise.h"

#include <immintrin.h>

// Everything but the kernels has internal linkage: the linker must not pick code compiled for a wider instruction set
// for other callers. Sums run over the corners in their order and nothing is contracted, so the vector width changes no
// bit.
namespace respire {
namespace RESPIRE_ISA {
namespace {

typedef float F4 __attribute__((vector_size(16)));
typedef float F8 __attribute__((vector_size(32)));
typedef std::int32_t I8 __attribute__((vector_size(32)));
typedef std::uint32_t U8 __attribute__((vector_size(32)));

// Hash factors of a cell's coordinates (Ericson, Real-Time Collision Detection, 7.1.3).
constexpr std::uint32_t X = 0x8da6b343u, Y = 0xd8163841u, Z = 0xcb1ab31fu;

// Vector form of `hash32` in sampler.h.
inline U8 hash(U8 x) {
  x ^= x >> 16, x *= 0x7feb352du, x ^= x >> 15, x *= 0x846ca68bu;
  return x ^ (x >> 16);
}

inline F8 all(float v) { return v - F8{}; }
inline F8 ten_bits(U8 h) { return __builtin_convertvector((I8)(h & 1023u), F8); }

struct Halves {
  F4 low, high;
};
inline Halves halves(F8 v) {
  Halves h;
  __builtin_memcpy(&h, &v, sizeof v);
  return h;
}

// The cell that holds a point: its coordinates, each times its hash factor, and the point's position in the cell.
struct Cell {
  std::uint32_t x, y, z;
  float local[3];
};
inline Cell cell_of(const float* p) {
  const float fx = __builtin_floorf(p[0]), fy = __builtin_floorf(p[1]), fz = __builtin_floorf(p[2]);
  return {static_cast<std::uint32_t>(static_cast<int>(fx)) * X,
          static_cast<std::uint32_t>(static_cast<int>(fy)) * Y,
          static_cast<std::uint32_t>(static_cast<int>(fz)) * Z,
          {p[0] - fx, p[1] - fy, p[2] - fz}};
}

// sum + t0 + t1 + t2 + t3, in this order, for four sums at once.
inline F4 add_in_order(F4 sum, F4 t0, F4 t1, F4 t2, F4 t3) {
  __m128 a = (__m128)t0, b = (__m128)t1, c = (__m128)t2, d = (__m128)t3;
  _MM_TRANSPOSE4_PS(a, b, c, d);
  return (((sum + (F4)a) + (F4)b) + (F4)c) + (F4)d;
}

// A cell and the cells around it, x fastest, then y, then z, in vectors of eight; the last five entries are padding.
constexpr int NEIGHBOURS = 27;
struct Around {
  float x[32], y[32], z[32];
  std::uint32_t hash_x[32], hash_y[32], hash_z[32], index[32];
};
constexpr Around around() {
  Around a{};
  for (int k = 0; k < 32; ++k) {
    const int x = k % 3 - 1, y = k / 3 % 3 - 1, z = k / 9 - 1;
    a.x[k] = static_cast<float>(x), a.y[k] = static_cast<float>(y);
    // Padding is too far away to be among the nearest two.
    a.z[k] = k < NEIGHBOURS ? static_cast<float>(z) : 1e9f;
    a.hash_x[k] = static_cast<std::uint32_t>(x) * X;
    a.hash_y[k] = static_cast<std::uint32_t>(y) * Y;
    a.hash_z[k] = static_cast<std::uint32_t>(z) * Z;
    a.index[k] = static_cast<std::uint32_t>(k);
  }
  return a;
}
alignas(32) constexpr Around AROUND = around();

template <typename T>
inline T load(const void* p) {
  T v;
  __builtin_memcpy(&v, p, sizeof v);
  return v;
}

// Index of the least of 32 numbers; of equal ones the first.
inline unsigned first_least(const F8* d) {
  __m128 least[8];
  __builtin_memcpy(least, d, sizeof least);
  __m128 m = least[0];
  for (int k = 1; k < 8; ++k) m = _mm_min_ps(m, least[k]);
  m = _mm_min_ps(m, _mm_shuffle_ps(m, m, 0x4e));
  m = _mm_min_ps(m, _mm_shuffle_ps(m, m, 0xb1));
  unsigned there = 0;
  for (int k = 0; k < 8; ++k) there |= static_cast<unsigned>(_mm_movemask_ps(_mm_cmpeq_ps(least[k], m))) << (4 * k);
  return static_cast<unsigned>(__builtin_ctz(there | 0x80000000u));
}

}  // namespace

Noise gradient_noise(const float* point, std::uint32_t seed) {
  const Cell cell = cell_of(point);
  const F4 t = {cell.local[0], cell.local[1], cell.local[2], 0.0f};
  const F4 far = t * t * t * (t * (t * 6.0f - 15.0f) + 10.0f), near = 1.0f - far;
  const F4 slope = 30.0f * t * t * (t * (t - 2.0f) + 1.0f);
  // Random gradients at the corners (x fastest, then y, then z), times the offsets from there.
  const U8 h = hash((cell.x + U8{0, X, 0, X, 0, X, 0, X}) ^ (cell.y + U8{0, 0, Y, Y, 0, 0, Y, Y}) ^
                    (cell.z + U8{0, 0, 0, 0, Z, Z, Z, Z}) ^ seed);
  const F8 gx = ten_bits(h) * (2.0f / 1023.0f) - 1.0f, gy = ten_bits(h >> 10) * (2.0f / 1023.0f) - 1.0f,
           gz = ten_bits(h >> 20) * (2.0f / 1023.0f) - 1.0f;
  const F8 n = gx * (all(t[0]) - F8{0, 1, 0, 1, 0, 1, 0, 1}) + gy * (all(t[1]) - F8{0, 0, 1, 1, 0, 0, 1, 1}) +
               gz * (all(t[2]) - F8{0, 0, 0, 0, 1, 1, 1, 1});
  const F8 u = {near[0], far[0], near[0], far[0], near[0], far[0], near[0], far[0]};
  const F8 v = {near[1], near[1], far[1], far[1], near[1], near[1], far[1], far[1]};
  const F8 w = {near[2], near[2], near[2], near[2], far[2], far[2], far[2], far[2]};
  const F8 du = all(slope[0]) * F8{-1, 1, -1, 1, -1, 1, -1, 1}, dv = all(slope[1]) * F8{-1, -1, 1, 1, -1, -1, 1, 1},
           dw = all(slope[2]) * F8{-1, -1, -1, -1, 1, 1, 1, 1};
  const F8 weight = u * v * w;
  const Halves value = halves(weight * n), x = halves(gx * weight + du * v * w * n),
               y = halves(gy * weight + dv * u * w * n), z = halves(gz * weight + dw * u * v * n);
  F4 sum = {};
  sum = add_in_order(sum, value.low, x.low, y.low, z.low);
  sum = add_in_order(sum, value.high, x.high, y.high, z.high) * 1.4f;
  return {sum[0], {sum[1], sum[2], sum[3]}};
}

Neighbours neighbours(const float* point, std::uint32_t seed) {
  const Cell cell = cell_of(point);
  alignas(32) F8 d[4];
  alignas(32) std::uint32_t hashes[32];
  for (int k = 0; k < 4; ++k) {
    const U8 h = hash((cell.x + load<U8>(AROUND.hash_x + 8 * k)) ^ (cell.y + load<U8>(AROUND.hash_y + 8 * k)) ^
                      (cell.z + load<U8>(AROUND.hash_z + 8 * k)) ^ seed);
    const F8 x = (load<F8>(AROUND.x + 8 * k) + ten_bits(h) * (1.0f / 1024.0f)) - cell.local[0];
    const F8 y = (load<F8>(AROUND.y + 8 * k) + ten_bits(h >> 10) * (1.0f / 1024.0f)) - cell.local[1];
    const F8 z = (load<F8>(AROUND.z + 8 * k) + ten_bits(h >> 20) * (1.0f / 1024.0f)) - cell.local[2];
    d[k] = x * x + y * y + z * z;
    __builtin_memcpy(hashes + 8 * k, &h, sizeof h);
  }
  Neighbours out;
  for (int k = 0; k < 2; ++k) {
    const unsigned i = first_least(d);
    const std::uint32_t h = hashes[i];
    out.cell[k] = h;
    out.place[k][0] = AROUND.x[i] + static_cast<float>(h & 1023u) * (1.0f / 1024.0f);
    out.place[k][1] = AROUND.y[i] + static_cast<float>((h >> 10) & 1023u) * (1.0f / 1024.0f);
    out.place[k][2] = AROUND.z[i] + static_cast<float>((h >> 20) & 1023u) * (1.0f / 1024.0f);
    // Computed again, which is faster than waiting until the squared distances lie in memory.
    const float x = out.place[k][0] - cell.local[0], y = out.place[k][1] - cell.local[1],
                z = out.place[k][2] - cell.local[2];
    out.distance2[k] = x * x + y * y + z * z;
    for (int j = 0; k == 0 && j < 4; ++j) d[j] = load<U8>(AROUND.index + 8 * j) == i ? all(2e18f) : d[j];
  }
  return out;
}

}  // namespace RESPIRE_ISA
}  // namespace respire
