#pragma once
#include <cstddef>
#include <cstdint>

#include "rust/cxx.h"

namespace respire {

struct LossImage;

// Floats of scratch that a band needs.
std::size_t loss_scratch(std::size_t width);
// Loss and gradient of lines y0 .. y0 + gradient.size() / (3 * width); see loss_kernel.h. Every length is checked; throws
// std::invalid_argument.
double loss_band(std::uint8_t isa, const LossImage& image, rust::Slice<const float> rendered, std::size_t y0,
                 rust::Slice<float> gradient, rust::Slice<float> room);

}  // namespace respire
