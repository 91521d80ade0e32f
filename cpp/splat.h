#pragma once
#include <cstdint>

#include "rust/cxx.h"

namespace respire {

// Widest instruction set of this processor that a kernel was compiled for: 0 baseline x86-64, 1 AVX2+FMA, 2 AVX-512.
std::uint8_t splat_widest_isa();

// One tile with the kernels of `isa`. Every index and length is checked; throws std::invalid_argument.
void splat_forward(std::uint8_t isa, rust::Slice<const float> rows, rust::Slice<const std::uint32_t> entries,
                   rust::Slice<std::uint16_t> masks, float x, float y, rust::Slice<float> state, std::uint32_t parts);
void splat_backward(std::uint8_t isa, rust::Slice<const float> rows, rust::Slice<const std::uint32_t> entries,
                    rust::Slice<const std::uint16_t> masks, float x, float y, rust::Slice<const float> adjoint,
                    rust::Slice<float> slots, std::uint32_t parts);

}  // namespace respire
