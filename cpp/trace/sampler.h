#pragma once
// Low-discrepancy numbers for one path: two-dimensional Sobol points, Owen-scrambled and shuffled by hashing and
// padded to any number of dimensions (Burley, "Practical Hash-based Owen Scrambling", JCGT 2020), with the
// Laine-Karras hash of psychopath.io, 2021 ("Building a better LK hash"). Both Sobol matrices are applied in
// bit-reversed form: the first is then the identity, the second is the Pascal matrix modulo 2, which is five
// shift-and-xor steps by Lucas' theorem. Far down a path, where stratification buys nothing, plain hashing.

#include <cstdint>

namespace respire {

// Integer hash "lowbias32" (Wellons).
inline std::uint32_t hash32(std::uint32_t x) {
  x ^= x >> 16, x *= 0x7feb352du, x ^= x >> 15, x *= 0x846ca68bu;
  return x ^ (x >> 16);
}

inline std::uint32_t reverse_bits(std::uint32_t x) {
  x = __builtin_bswap32(x);
  x = ((x & 0x0f0f0f0fu) << 4) | ((x >> 4) & 0x0f0f0f0fu);
  x = ((x & 0x33333333u) << 2) | ((x >> 2) & 0x33333333u);
  return ((x & 0x55555555u) << 1) | ((x >> 1) & 0x55555555u);
}

// Owen scramble of a bit-reversed number: every bit depends on the lower ones alone.
inline std::uint32_t scramble_reversed(std::uint32_t x, std::uint32_t seed) {
  x ^= x * 0x3d20adeau;
  x += seed;
  x *= (seed >> 16) | 1u;
  x ^= x * 0x05526c56u;
  x ^= x * 0x53a22864u;
  return x;
}

// Bit-reversed second Sobol coordinate of index `i`.
inline std::uint32_t pascal(std::uint32_t i) {
  i ^= (i >> 1) & 0x55555555u;
  i ^= (i >> 2) & 0x33333333u;
  i ^= (i >> 4) & 0x0f0f0f0fu;
  i ^= (i >> 8) & 0x00ff00ffu;
  return i ^ ((i >> 16) & 0x0000ffffu);
}

// [0, 1) from the upper 24 bits.
inline float unit_float(std::uint32_t x) { return static_cast<float>(x >> 8) * 0x1p-24f; }

class Sampler {
 public:
  // `pixel_key` differs between pixels, frames and seeds; `index` counts the samples of the pixel.
  Sampler(std::uint32_t pixel_key, std::uint32_t index)
      : key_(pixel_key),
        reversed_index_(reverse_bits(index)),
        state_(hash32(pixel_key ^ hash32(index + 0x9e3779b9u))) {}

  float next1() {
    if (dimension_ >= STRATIFIED) return unit_float(next_hash());
    std::uint32_t seed = hash32(key_ + ++dimension_ * 0x68bc21ebu);
    std::uint32_t i = shuffled(seed);
    return unit_float(reverse_bits(scramble_reversed(i, hash32(seed + 1))));
  }

  void next2(float& u, float& v) {
    if (dimension_ >= STRATIFIED) {
      u = unit_float(next_hash());
      v = unit_float(next_hash());
      return;
    }
    std::uint32_t seed = hash32(key_ + ++dimension_ * 0x68bc21ebu);
    std::uint32_t i = shuffled(seed);
    std::uint32_t other = hash32(seed + 1);
    u = unit_float(reverse_bits(scramble_reversed(i, other)));
    v = unit_float(reverse_bits(scramble_reversed(pascal(i), other * 0x9e3779b1u + 0x7f4a7c15u)));
  }

  // A number without stratification, for the steps of a random walk.
  float random() { return unit_float(next_hash()); }

 private:
  // Dimensions that are stratified; later ones use plain hashing.
  static constexpr std::uint32_t STRATIFIED = 24;

  std::uint32_t shuffled(std::uint32_t seed) const { return reverse_bits(scramble_reversed(reversed_index_, seed)); }
  std::uint32_t next_hash() { return hash32(state_ += 0x9e3779b9u); }

  std::uint32_t key_, reversed_index_, state_, dimension_ = 0;
};

}  // namespace respire
