// From splats to the lists of tiles, a band of tile rows at a time: dealing, a stable radix sort by depth, a counting
// sort by tile. Plain code for any x86-64: what it waits for is memory and branches, not arithmetic. The plain twin is in
// src/splat/bin.rs.
#include "cpp/splat_bin.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "respire-bench/src/ffi/splat_bin.rs.h"

namespace respire {
namespace {

void require(bool good, const char* what) {
  if (!good) throw std::invalid_argument(what);
}

struct Box {
  std::uint32_t x0, y0, x1, y1;
  explicit Box(const std::uint32_t* packed)
      : x0(packed[0] & 0xffff), y0(packed[0] >> 16), x1(packed[1] & 0xffff), y1(packed[1] >> 16) {}
  std::uint32_t width() const { return x1 - x0 + 1; }
};

// Stable sort of a by the upper word, by as few digits as the range of keys needs; the result is in a or in b.
const std::uint64_t* sort(std::uint64_t* a, std::uint64_t* b, std::size_t n, std::uint32_t least, std::uint32_t most) {
  constexpr int MOST_BITS = 11;
  const int bits = most > least ? 32 - __builtin_clz(most - least) : 0;
  const int passes = (bits + MOST_BITS - 1) / MOST_BITS;
  if (!passes) return a;
  const int width = (bits + passes - 1) / passes;
  const std::uint32_t mask = (1u << width) - 1;
  std::array<std::array<std::uint32_t, 1 << MOST_BITS>, 3> counts;
  for (int p = 0; p < passes; ++p) std::fill_n(counts[p].begin(), mask + 1, 0u);
  auto digit = [&](std::uint64_t item, int p) { return ((static_cast<std::uint32_t>(item >> 32) - least) >> (p * width)) & mask; };
  for (std::size_t i = 0; i < n; ++i)
    for (int p = 0; p < passes; ++p) ++counts[p][digit(a[i], p)];
  for (int p = 0; p < passes; ++p) {
    std::uint32_t sum = 0;
    for (std::uint32_t d = 0; d <= mask; ++d) {
      const std::uint32_t count = counts[p][d];
      counts[p][d] = sum;
      sum += count;
    }
    for (std::size_t i = 0; i < n; ++i) b[counts[p][digit(a[i], p)]++] = a[i];
    std::swap(a, b);
  }
  return a;
}

}  // namespace

void bin_count(rust::Slice<const std::uint32_t> boxes, rust::Slice<const bool> visible, std::uint32_t shift,
               rust::Slice<std::uint32_t> starts, rust::Slice<std::uint32_t> counts) {
  const std::size_t n = visible.size();
  require(boxes.size() == 2 * n && starts.size() == n && counts.size() == 2 * BANDS && shift < 16,
          "tables of the bins differ in length");
  // A slice asks Rust for its pointer each time.
  const bool* seen = visible.data();
  const std::uint32_t* box = boxes.data();
  std::uint32_t* start = starts.data();
  if (!std::memchr(seen, 1, n)) {
    std::fill_n(start, n, 0u);
    std::fill_n(counts.data(), 2 * BANDS, 0u);
    return;
  }
  std::uint32_t bands[2 * BANDS] = {}, sum = 0;
  for (std::size_t k = 0; k < n; ++k) {
    if (seen[k]) {
      const Box b(box + 2 * k);
      require(b.x0 <= b.x1 && b.y0 <= b.y1 && (b.y1 >> shift) < BANDS, "a box of tiles is empty or too large");
      const std::uint32_t w = b.width(), last = b.y1 >> shift;
      std::uint32_t y = b.y0;
      for (std::uint32_t band = b.y0 >> shift; band <= last; ++band) {
        const std::uint32_t end = std::min(b.y1 + 1, (band + 1) << shift);
        bands[band] += 1;
        bands[BANDS + band] += (end - y) * w;
        y = end;
      }
      sum += (b.y1 - b.y0 + 1) * w;
    }
    start[k] = sum;
  }
  std::copy_n(bands, 2 * BANDS, counts.data());
}

void bin_deal(std::uint32_t first, rust::Slice<const std::uint32_t> boxes, rust::Slice<const bool> visible,
              rust::Slice<const std::uint32_t> keys, std::uint32_t shift, std::uint32_t base,
              rust::Slice<std::uint32_t> starts, rust::Slice<const std::uint32_t> counts,
              rust::Slice<std::uint64_t> items) {
  const std::size_t n = visible.size();
  require(boxes.size() == 2 * n && keys.size() == n && starts.size() == n && counts.size() == 2 * BANDS && shift < 16,
          "tables of the bins differ in length");
  std::size_t cursors[BANDS], sum = 0;
  for (std::size_t band = 0; band < BANDS; ++band) cursors[band] = sum, sum += counts[band];
  require(items.size() == sum, "tables of the bins differ in length");
  const bool* seen = visible.data();
  const std::uint32_t *box = boxes.data(), *key = keys.data();
  std::uint32_t* start = starts.data();
  std::uint64_t* out = items.data();
  if (sum == 0) {
    std::fill_n(start, n, base);
    return;
  }
  for (std::size_t k = 0; k < n; ++k) {
    start[k] += base;
    if (!seen[k]) continue;
    const Box b(box + 2 * k);
    const std::uint64_t item = static_cast<std::uint64_t>(key[k]) << 32 | (first + static_cast<std::uint32_t>(k));
    const std::uint32_t last = b.y1 >> shift;
    for (std::uint32_t band = b.y0 >> shift; band <= last; ++band) {
      require(band < BANDS && cursors[band] < sum, "more splats than were counted");
      out[cursors[band]++] = item;
    }
  }
}

void bin_fill(rust::Slice<const std::uint64_t> items, rust::Slice<const std::uint32_t> pieces,
              rust::Slice<const std::uint32_t> boxes, rust::Slice<const std::uint32_t> starts, std::uint32_t tiles_x,
              std::uint32_t low, std::uint32_t high, std::uint32_t first, rust::Slice<std::uint64_t> scratch,
              rust::Slice<std::uint32_t> offsets, rust::Slice<std::uint32_t> entries,
              rust::Slice<std::uint32_t> targets) {
  const std::size_t n = scratch.size() / 2, cells = offsets.size(), splats = boxes.size() / 2;
  require(low <= high && cells == static_cast<std::size_t>(high - low) * tiles_x && starts.size() == splats + 1 &&
              scratch.size() == 2 * n && targets.size() == entries.size() && pieces.size() % 2 == 0,
          "tables of the bins differ in length");
  const std::uint64_t* in = items.data();
  const std::uint32_t *box = boxes.data(), *piece = pieces.data(), *start = starts.data();
  std::uint64_t* room = scratch.data();
  std::uint32_t *const offset = offsets.data(), *const entry = entries.data(), *const target = targets.data();
  const std::size_t piece_count = pieces.size(), item_count = items.size();
  std::vector<std::uint32_t> cursors(cells, 0);
  std::uint32_t least = ~0u, most = 0;
  std::size_t filled = 0;
  auto rows = [&](const Box& b, auto&& row) {
    const std::uint32_t end = std::min(b.y1 + 1, high);
    for (std::uint32_t y = std::max(b.y0, low); y < end; ++y) row(y);
  };
  for (std::size_t p = 0; p < piece_count; p += 2) {
    const std::uint32_t from = piece[p], to = piece[p + 1];
    require(from <= to && to <= item_count && to - from <= n - filled, "a piece of the bins is out of range");
    for (std::size_t i = from; i < to; ++i) {
      const std::uint64_t item = in[i];
      const std::uint32_t key = static_cast<std::uint32_t>(item >> 32);
      least = std::min(least, key), most = std::max(most, key);
      room[filled++] = item;
      require(static_cast<std::uint32_t>(item) < splats, "an item names no splat");
      const Box b(box + 2 * static_cast<std::size_t>(static_cast<std::uint32_t>(item)));
      require(b.x0 <= b.x1 && b.x1 < tiles_x, "a box of tiles is out of range");
      rows(b, [&](std::uint32_t y) {
        std::uint32_t* row = cursors.data() + (y - low) * tiles_x;
        for (std::uint32_t x = b.x0; x <= b.x1; ++x) ++row[x];
      });
    }
  }
  require(filled == n, "fewer splats than were counted");
  std::uint32_t sum = 0;
  for (std::size_t c = 0; c < cells; ++c) {
    offset[c] = first + sum;
    const std::uint32_t count = cursors[c];
    cursors[c] = sum;
    sum += count;
  }
  require(sum == entries.size(), "other entries than were counted");
  const std::uint64_t* sorted = sort(room, room + n, n, least, most);
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint32_t j = static_cast<std::uint32_t>(sorted[i]);
    const Box b(box + 2 * static_cast<std::size_t>(j));
    rows(b, [&](std::uint32_t y) {
      std::uint32_t* row = cursors.data() + (y - low) * tiles_x;
      std::uint32_t slot = start[j] + (y - b.y0) * b.width();
      for (std::uint32_t x = b.x0; x <= b.x1; ++x, ++slot) {
        const std::uint32_t at = row[x]++;
        entry[at] = j;
        target[at] = slot;
      }
    });
  }
}

}  // namespace respire
