#pragma once
#include <cstddef>
#include <cstdint>

#include "rust/cxx.h"

namespace respire {

struct LossImage;  // src/ffi/splat/loss.rs explains it

// Floats of scratch that a band needs.
std::size_t loss_scratch(std::size_t width);
// Loss and gradient of as many lines, from `first` on, as the gradient has room for; see loss_kernel.h. Every length is
// checked; throws std::invalid_argument.
double loss_band(std::uint8_t isa, const LossImage& image, rust::Slice<const float> rendered, std::size_t first,
                 rust::Slice<float> gradient, rust::Slice<float> scratch);

}  // namespace respire
