#pragma once
#include <cstdint>

#include "rust/cxx.h"

namespace respire {

// From the sums of one row of tiles, `side` pixels wide, to lines of the images (no depth where that is empty); the twin is in src/splat/composite.rs.
void splat_develop(rust::Slice<const float> state, std::size_t width, std::size_t side,
                   std::array<float, 3> gain, std::array<float, 3> background, bool with_depth, rust::Slice<float> color, rust::Slice<float> depth,
                   rust::Slice<float> alpha);
// From the velocities of one row of tiles (`directions` of them in each) to lines of the velocity of the colour image along
// direction `k`; what is not finite stands still. The twin is in src/splat/tangent.rs.
void splat_develop_moving(rust::Slice<const float> moving, std::size_t directions, std::size_t k, std::size_t width,
                          std::size_t side, std::array<float, 3> gain, std::array<float, 3> background, rust::Slice<float> color);
// From image gradients (empty where there are none) to the adjoint of the tile at (x, y); adds to the gradient of the
// gain.
void splat_adjoint(rust::Slice<const float> state, std::size_t x, std::size_t y, std::size_t side, std::size_t width,
                   std::size_t height, std::array<float, 3> gain, std::array<float, 3> background, rust::Slice<const float> color,
                   rust::Slice<const float> depth, rust::Slice<const float> alpha, rust::Slice<float> adjoint,
                   std::array<double, 3>& by_gain);

}  // namespace respire
