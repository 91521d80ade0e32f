#pragma once
#include <array>
#include <cstddef>

#include "rust/cxx.h"

namespace respire {

// The records of src/ffi/splat/image.rs, which explains them.
struct ImageFormation;
struct TilePlace;
struct PixelGradients;

// All functions check every length, and throw std::invalid_argument.

// From the sums of one row of tiles to lines of the images (no depth where that is empty); the twin is in
// src/splat/plain/image.rs.
void splat_develop(rust::Slice<const float> state, std::size_t width, const ImageFormation& formation,
                   rust::Slice<float> color, rust::Slice<float> depth, rust::Slice<float> alpha);
// From the velocities of one row of tiles (`directions` of them in each) to lines of the velocity of the colour image
// along one direction; a velocity that is not finite becomes 0. The twin is in src/splat/plain/moving.rs.
void splat_develop_moving(rust::Slice<const float> moving, std::size_t directions, std::size_t direction,
                          std::size_t width, const ImageFormation& formation, rust::Slice<float> color);
// From image gradients (empty where there are none) to the adjoint of one tile; returns the tile's part of the
// gradient of the gain. The twin is in src/splat/plain/image.rs.
std::array<double, 3> splat_adjoint(rust::Slice<const float> state, const TilePlace& place,
                                    const ImageFormation& formation, const PixelGradients& image,
                                    rust::Slice<float> adjoint);

}  // namespace respire
