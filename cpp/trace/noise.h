#pragma once
// Random functions of space, the same bytes on every processor: a gradient noise (after Perlin, SIGGRAPH 2002) and the
// Voronoi diagram of one jittered point per unit cell. `cpp/trace/noise_kernel.cpp` holds them, compiled once per
// instruction set: all eight corners of a cell, or eight of its 27 neighbours, at a time.

#include <cstdint>

namespace respire {

// Value in about [-1, 1] and its gradient.
struct Noise {
  float value, gradient[3];
};

// The two jittered points nearest to a point, in order: place relative to the cell that the point lies in, squared
// distance, and the hash that names its cell. Equally far points come in the order of their cells (z, y, x).
struct Neighbours {
  float place[2][3], distance2[2];
  std::uint32_t cell[2];
};

// Period of a feature and size of a cell are 1.
struct NoiseKernel {
  Noise (*gradient)(const float* point, std::uint32_t seed);
  Neighbours (*neighbours)(const float* point, std::uint32_t seed);
};

#define RESPIRE_NOISE(isa)                                       \
  namespace isa {                                                \
  Noise gradient_noise(const float* point, std::uint32_t seed);  \
  Neighbours neighbours(const float* point, std::uint32_t seed); \
  }
RESPIRE_NOISE(baseline)
RESPIRE_NOISE(avx2)
RESPIRE_NOISE(avx512)
#undef RESPIRE_NOISE

// The kernels of an instruction set, numbered as by `widest_isa`.
inline NoiseKernel noise_kernel(std::uint8_t isa) {
  switch (isa) {
    case 2: return {avx512::gradient_noise, avx512::neighbours};
    case 1: return {avx2::gradient_noise, avx2::neighbours};
    default: return {baseline::gradient_noise, baseline::neighbours};
  }
}

}  // namespace respire
