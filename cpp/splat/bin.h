#pragma once
#include <cstddef>
#include <cstdint>

#include "rust/cxx.h"

namespace respire {

// Bands of tile rows that an image has at most; the same as in src/splat/bin.rs.
constexpr std::size_t BANDS = 16;

// All functions check every index and length, and throw std::invalid_argument. `boxes`: two words per splat, x0 | y0 << 16
// and x1 | y1 << 16, in tiles, inclusive. A band has 2^shift rows of tiles.

// Of a chunk of splats: `starts[k]` = tiles of splats 0..=k; `counts` = splats in each band, then tiles in each band.
std::uint32_t bin_count(rust::Slice<const std::uint32_t> boxes, rust::Slice<const bool> visible, std::uint32_t shift,
                        rust::Slice<std::uint32_t> starts, rust::Slice<std::uint32_t> counts);
// Puts the visible splats of a chunk, the first of them number `first`, into `items` (key << 32 | splat), band after
// band, in their order; adds `base` to `starts`.
void bin_deal(std::uint32_t first, rust::Slice<const std::uint32_t> boxes, rust::Slice<const bool> visible,
              rust::Slice<const std::uint32_t> keys, std::uint32_t shift, std::uint32_t base,
              rust::Slice<std::uint32_t> starts, rust::Slice<const std::uint32_t> counts,
              rust::Slice<std::uint64_t> items);
// The lists of the tile rows low..high from the pieces of `items` that belong to them (pairs of begin and end). Entries
// begin at number `first`; `targets`: the slot of each entry, starts[splat] + its number in the splat's box.
void bin_fill(rust::Slice<const std::uint64_t> items, rust::Slice<const std::uint32_t> pieces,
              rust::Slice<const std::uint32_t> boxes, rust::Slice<const std::uint32_t> starts, std::uint32_t tiles_x,
              std::uint32_t low, std::uint32_t high, std::uint32_t first, rust::Slice<std::uint64_t> scratch,
              rust::Slice<std::uint32_t> offsets, rust::Slice<std::uint32_t> entries,
              rust::Slice<std::uint32_t> targets);

}  // namespace respire
