#pragma once
#include <cstddef>
#include <cstdint>

#include "rust/cxx.h"

namespace respire {

// Largest number of bands of tile rows in an image; the same as in src/ffi/splat/bin.rs.
constexpr std::size_t BANDS = 16;

// The records of src/ffi/splat/bin.rs, which explains them.
struct BinSplats;
struct BinItems;
struct Band;
struct Counts;
struct Distribution;

// All functions check every index and length, and throw std::invalid_argument. Boxes: two words per splat, x0 | y0 <<
// 16 and x1 | y1 << 16, in tiles, inclusive. A band has 2^shift rows of tiles.

// Of a chunk of splats: `starts[k]` = tiles of splats 0..=k, where any is visible; splats and tiles in each band.
void bin_count(const BinSplats& chunk, std::uint32_t shift, rust::Slice<std::uint32_t> starts, Counts& counts);
// Puts the visible splats of a chunk into items, band after band, in their order; adds the base to the starts. Where
// none is visible, only the last start is written.
void bin_distribute(const BinSplats& chunk, std::uint32_t shift, const Counts& counts, Distribution to);
// The lists of one band from the pieces of the items that belong to it; the slot of an entry is starts[splat] + its
// number in the splat's box.
void bin_fill(const BinItems& all, Band band);

}  // namespace respire
