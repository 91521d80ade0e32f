#include "cpp/splat.h"

#include <stdexcept>

#include "cpp/splat_kernel.h"

namespace respire {
namespace {

void check(std::uint8_t isa, std::size_t rows, rust::Slice<const std::uint32_t> entries, std::size_t masks) {
  if (isa > splat_widest_isa()) throw std::invalid_argument("this processor lacks the instruction set asked for");
  if (rows % 16 || masks != entries.size()) throw std::invalid_argument("tables of a tile differ in length");
  std::uint32_t most = 0;
  for (std::uint32_t e : entries) most = e > most ? e : most;
  if (!entries.empty() && most >= rows / 16) throw std::invalid_argument("tile entry names no splat");
}

}  // namespace

std::uint8_t splat_widest_isa() {
  __builtin_cpu_init();
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  const bool avx512 = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw");
  return avx512 ? 2 : avx2 ? 1 : 0;
}

void splat_forward(std::uint8_t isa, rust::Slice<const float> rows, rust::Slice<const std::uint32_t> entries,
                   rust::Slice<std::uint16_t> masks, float x, float y, rust::Slice<float> state, std::uint32_t parts) {
  check(isa, rows.size(), entries, masks.size());
  if (state.size() != 5 * PIXELS) throw std::invalid_argument("the state of a tile has 5 planes");
  const ForwardTile tile{rows.data(), entries.data(), masks.data(), entries.size(), x, y, state.data()};
  (isa == 2 ? avx512::forward : isa == 1 ? avx2::forward : baseline::forward)(tile, parts);
}

void splat_backward(std::uint8_t isa, rust::Slice<const float> rows, rust::Slice<const std::uint32_t> entries,
                    rust::Slice<const std::uint16_t> masks, float x, float y, rust::Slice<const float> adjoint,
                    rust::Slice<float> slots, std::uint32_t parts) {
  check(isa, rows.size(), entries, masks.size());
  if (adjoint.size() != 5 * PIXELS || slots.size() != 16 * entries.size()) {
    throw std::invalid_argument("tables of a tile differ in length");
  }
  const BackwardTile tile{rows.data(), entries.data(), masks.data(), entries.size(), x, y, adjoint.data(), slots.data()};
  (isa == 2 ? avx512::backward : isa == 1 ? avx2::backward : baseline::backward)(tile, parts);
}

}  // namespace respire
