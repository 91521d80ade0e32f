#pragma once
#include <array>
#include <cstddef>
#include <cstdint>

#include "rust/cxx.h"

namespace respire {

// Sixteen numbers that begin at a cache line: the columns of a splat or a disc, or the moments of an entry
// (`Aligned<f32>` of src/ffi/splat/rasterize.rs).
struct alignas(64) AlignedRow {
  float columns[16];
};
static_assert(sizeof(AlignedRow) == 64, "as in Rust");

// The records of src/ffi/splat/rasterize.rs, which explains them.
struct SplatScene;
struct SplatMotion;
struct SplatChunk;
struct SplatMoments;
struct SplatGradients;
struct SplatCameraGradient;
struct SplatForward;
struct SplatBackward;
struct SplatDiscs;

// All functions check every index and length, and throw std::invalid_argument. `isa` as of widest_isa.

// Splats of a chunk of Gaussians, on an image of tiles[0] x tiles[1] tiles; where the chunk has room for velocities,
// those along the motion too.
void splat_project(std::uint8_t isa, const SplatScene& scene, std::array<std::uint32_t, 2> tiles, SplatChunk chunk,
                   const SplatMotion& motion);
// Their colours again, where visible; false when one is not finite.
bool splat_recolor(std::uint8_t isa, const SplatScene& scene, std::size_t first, rust::Slice<const bool> visible,
                   rust::Slice<AlignedRow> rows);
// Their velocities along a motion, where visible.
void splat_velocities(std::uint8_t isa, const SplatScene& scene, std::size_t first, rust::Slice<const bool> visible,
                      const SplatMotion& motion, rust::Slice<std::array<float, 8>> rows);
// Gradients from moments.
SplatCameraGradient splat_chain(std::uint8_t isa, const SplatScene& scene, const SplatMoments& moments,
                                SplatGradients gradients);
// Composites one tile.
void splat_forward(std::uint8_t isa, SplatForward tile);
// Writes the slots that the tile's targets name, of `slot_count`: no other thread may use those at the same time.
void splat_backward(std::uint8_t isa, const SplatBackward& tile, AlignedRow* slots, bool* live, std::size_t slot_count);
// Composites the exact discs of one tile to `state`, as of splat_forward.
void splat_disc_forward(std::uint8_t isa, const SplatDiscs& discs, bool with_depth, rust::Slice<float> state);
// Backward: DISC_SUMS sums for each entry.
void splat_disc_backward(std::uint8_t isa, const SplatDiscs& discs, rust::Slice<const float> adjoint,
                         std::uint32_t parts, rust::Slice<float> sums);

}  // namespace respire
