#pragma once
#include <cstdint>

namespace respire {

// The widest instruction set that this processor has and that kernels are compiled for: 0 baseline x86-64, 1 AVX2
// with FMA, 2 AVX-512.
std::uint8_t widest_isa();

}  // namespace respire
