#pragma once
#include <cstddef>
#include <cstdint>

#include "rust/cxx.h"

namespace respire {

struct SplatScene;
struct SplatMotion;
struct SplatDiscs;

// All functions check every index and length, and throw std::invalid_argument.

// Splats of the Gaussians number first..first + visible.size() of the scene; see splat_kernel.h for the tables. Tiles are
// `side` pixels wide. With `velocities`, 8 floats per splat, those along a motion, too.
void splat_project(std::uint8_t isa, const SplatScene& scene, std::size_t first, std::uint32_t tiles_x,
                   std::uint32_t tiles_y, std::uint32_t side, rust::Slice<float> rows, rust::Slice<std::uint32_t> boxes,
                   rust::Slice<std::uint32_t> keys, rust::Slice<bool> visible, const SplatMotion& motion,
                   rust::Slice<float> velocities);
// Their colours again, where visible; false when one is not finite.
bool splat_recolor(std::uint8_t isa, const SplatScene& scene, std::size_t first, rust::Slice<const bool> visible,
                   rust::Slice<float> rows);
// Their velocities along a motion.
void splat_velocities(std::uint8_t isa, const SplatScene& scene, std::size_t first, rust::Slice<const bool> visible,
                      const SplatMotion& motion, rust::Slice<float> rows);
// Gradients from moments; a slice that is not wanted is empty.
void splat_chain(std::uint8_t isa, const SplatScene& scene, std::size_t first, rust::Slice<const std::uint32_t> starts,
                 rust::Slice<const float> slots, std::uint32_t wanted,
                 rust::Slice<float> positions, rust::Slice<float> shape, rust::Slice<float> scales,
                 rust::Slice<float> opacities, rust::Slice<float> sh, rust::Slice<double> camera);
// The `blocks` of one tile. `velocities`: 8 floats per splat and direction, direction by direction.
void splat_forward(std::uint8_t isa, rust::Slice<const float> rows, rust::Slice<const std::uint32_t> entries,
                   rust::Slice<std::uint16_t> masks, float x, float y, std::uint16_t blocks, rust::Slice<float> state,
                   std::uint32_t parts, rust::Slice<const float> velocities, rust::Slice<float> moving);
// Writes the slots that `targets` name, of slot_count slots of 16 floats: no other thread may use those at the same time.
void splat_backward(std::uint8_t isa, rust::Slice<const float> rows, rust::Slice<const std::uint32_t> entries,
                    rust::Slice<const std::uint16_t> masks, rust::Slice<const std::uint32_t> targets, float x, float y,
                    rust::Slice<const float> adjoint, float* slots, std::size_t slot_count, std::uint32_t parts);
// The exact discs of one tile: sums and light that is left, to `state` as of splat_forward.
void splat_disc_forward(std::uint8_t isa, const SplatDiscs& discs, bool with_depth, rust::Slice<float> state);
// Backward: DISC_SUMS sums for each entry.
void splat_disc_backward(std::uint8_t isa, const SplatDiscs& discs, rust::Slice<const float> adjoint,
                         std::uint32_t parts, rust::Slice<float> sums);

}  // namespace respire
