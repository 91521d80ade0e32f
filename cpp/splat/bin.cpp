// From splats to the lists of tiles, a band of tile rows at a time: dealing, a stable radix sort by depth, a counting
// sort by tile. Plain code for any x86-64: what it waits for is memory and branches, not arithmetic. The plain twin is in
// src/splat/bin.rs.
#include "cpp/splat/bin.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "respire-bench/src/ffi/splat/bin.rs.h"

namespace respire {
namespace {

void require(bool good, const char* what) {
  if (!good) throw std::invalid_argument(what);
}

// Of the 1024 rows of tiles that an image has at most, in bands.
constexpr std::uint32_t MOST_SHIFT = 6;

struct Box {
  std::uint32_t x0, y0, x1, y1;
  explicit Box(const std::uint32_t* packed)
      : x0(packed[0] & 0xffff), y0(packed[0] >> 16), x1(packed[1] & 0xffff), y1(packed[1] >> 16) {}
  std::uint32_t width() const { return x1 - x0 + 1; }
};

// What a band knows of a splat while it is sorted by its number in the band.
struct Record {
  std::uint32_t corner, size;  // first cell of its box; its height << 16 | its width
  std::uint32_t slot, splat;   // slot of the first cell
};

std::uint32_t upper(std::uint64_t item) { return static_cast<std::uint32_t>(item >> 32); }

// Stable sort of a by the upper word less `least`, bits from..from + passes * width of it; the result is in a or in b.
std::uint64_t* sort_by_digits(std::uint64_t* a, std::uint64_t* b, std::size_t n, std::uint32_t least, int from, int width,
                              int passes) {
  constexpr int MOST_BITS = 11;
  std::array<std::array<std::uint32_t, 1 << MOST_BITS>, 3> counts;
  const std::uint32_t mask = (1u << width) - 1;
  auto digit = [&](std::uint64_t item, int p) { return ((upper(item) - least) >> (from + p * width)) & mask; };
  for (int p = 0; p < passes; ++p) std::fill_n(counts[p].begin(), mask + 1, 0u);
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

// Stable sort of a nearly sorted a by the upper word; false when that takes more than `most` moves (it is still a stable
// sort of the upper bits then).
bool insert_late_ones(std::uint64_t* a, std::size_t n, std::size_t most) {
  for (std::size_t i = 1; i < n; ++i) {
    if (upper(a[i - 1]) <= upper(a[i])) continue;
    const std::uint64_t item = a[i];
    std::size_t k = i;
    for (; k > 0 && upper(a[k - 1]) > upper(item); --k) {
      a[k] = a[k - 1];
      if (most-- == 0) {
        a[k - 1] = item;
        return false;
      }
    }
    a[k] = item;
  }
  return true;
}

// Stable sort of a by the upper word; the result is in a or in b. Two digits from the top of the range bring nearly all
// into their places, and what is left is a walk; unless the depths lie in clusters.
const std::uint64_t* sort(std::uint64_t* a, std::uint64_t* b, std::size_t n, std::uint32_t least, std::uint32_t most) {
  const int bits = most > least ? 32 - __builtin_clz(most - least) : 0;
  if (!bits) return a;
  int width = 8;
  while (width < 11 && (n >> width) > 1) ++width;
  if (bits > 2 * width) {
    a = sort_by_digits(a, b, n, least, bits - 2 * width, width, 2);
    if (insert_late_ones(a, n, 4 * n)) return a;
  }
  const int passes = (bits + 10) / 11;
  return sort_by_digits(a, b, n, least, 0, (bits + passes - 1) / passes, passes);
}

}  // namespace

std::uint32_t bin_count(rust::Slice<const std::uint32_t> boxes, rust::Slice<const bool> visible, std::uint32_t shift,
                        rust::Slice<std::uint32_t> starts, rust::Slice<std::uint32_t> counts) {
  const std::size_t n = visible.size();
  require(boxes.size() == 2 * n && starts.size() == n && counts.size() == 2 * BANDS && shift <= MOST_SHIFT,
          "tables of the bins differ in length");
  // A slice asks Rust for its pointer each time.
  const bool* seen = visible.data();
  const std::uint32_t* box = boxes.data();
  std::uint32_t* start = starts.data();
  if (!n || !std::memchr(seen, 1, n)) {
    std::fill_n(counts.data(), 2 * BANDS, 0u);
    return 0;
  }
  // What begins and ends with a band and with a row of tiles: no loop over what a box meets, whose end nobody foresees.
  std::uint32_t all = 0, sum = 0, first_last[BANDS + 1] = {}, rows[(BANDS << MOST_SHIFT) + 1];
  const std::uint32_t height = 1u << shift;
  std::fill_n(rows, BANDS * height + 1, 0u);
  for (std::size_t k = 0; k < n; ++k) {
    if (seen[k]) {
      const Box b(box + 2 * k);
      require(b.x0 <= b.x1 && b.y0 <= b.y1 && (b.y1 >> shift) < BANDS, "a box of tiles is empty or too large");
      const std::uint32_t w = b.width();
      ++all;
      ++first_last[b.y0 >> shift];
      --first_last[(b.y1 >> shift) + 1];
      rows[b.y0] += w;
      rows[b.y1 + 1] -= w;
      sum += (b.y1 - b.y0 + 1) * w;
    }
    start[k] = sum;
  }
  std::uint32_t splats = 0, tiles = 0;
  for (std::size_t band = 0; band < BANDS; ++band) {
    std::uint32_t in_band = 0;
    for (std::uint32_t y = 0; y < height; ++y) in_band += tiles += rows[band * height + y];
    counts[band] = splats += first_last[band];
    counts[BANDS + band] = in_band;
  }
  return all;
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
    // Nobody asks for the slots of a chunk that nobody sees, but for where the next one begins.
    if (n) start[n - 1] = base;
    return;
  }
  for (std::size_t k = 0; k < n; ++k) {
    start[k] += base;
    if (!seen[k]) continue;
    const Box b(box + 2 * k);
    const std::uint64_t item = static_cast<std::uint64_t>(key[k]) << 32 | (first + static_cast<std::uint32_t>(k));
    const std::uint32_t from = b.y0 >> shift, last = b.y1 >> shift;
    require(from <= last && last < BANDS && cursors[from] < sum, "more splats than were counted");
    out[cursors[from]++] = item;
    for (std::uint32_t band = from + 1; band <= last; ++band) {
      require(cursors[band] < sum, "more splats than were counted");
      out[cursors[band]++] = item;
    }
  }
}

void bin_fill(rust::Slice<const std::uint64_t> items, rust::Slice<const std::uint32_t> pieces,
              rust::Slice<const std::uint32_t> boxes, rust::Slice<const std::uint32_t> starts, std::uint32_t tiles_x,
              std::uint32_t low, std::uint32_t high, std::uint32_t first, rust::Slice<std::uint64_t> scratch,
              rust::Slice<std::uint32_t> offsets, rust::Slice<std::uint32_t> entries,
              rust::Slice<std::uint32_t> targets) {
  const std::size_t n = scratch.size() / 4, cells = offsets.size(), splats = boxes.size() / 2;
  require(low <= high && cells == static_cast<std::size_t>(high - low) * tiles_x && starts.size() == splats + 1 &&
              scratch.size() == 4 * n && targets.size() == entries.size() && pieces.size() % 2 == 0,
          "tables of the bins differ in length");
  const std::uint64_t* in = items.data();
  const std::uint32_t *box = boxes.data(), *piece = pieces.data(), *start = starts.data();
  std::uint64_t* room = scratch.data();
  Record* const records = reinterpret_cast<Record*>(room + 2 * n);
  std::uint32_t *const offset = offsets.data(), *const entry = entries.data(), *const target = targets.data();
  const std::size_t piece_count = pieces.size(), item_count = items.size(), stride = tiles_x + 1;
  // First what begins and ends at each tile, so that sums along rows and columns count its entries.
  std::vector<std::uint32_t> cursors(stride * (high - low + 1), 0);
  std::uint32_t* const cursor = cursors.data();
  std::uint32_t least = ~0u, most = 0;
  std::size_t filled = 0;
  for (std::size_t p = 0; p < piece_count; p += 2) {
    const std::uint32_t from = piece[p], to = piece[p + 1];
    require(from <= to && to <= item_count && to - from <= n - filled, "a piece of the bins is out of range");
    for (std::size_t i = from; i < to; ++i) {
      const std::uint32_t key = upper(in[i]), splat = static_cast<std::uint32_t>(in[i]);
      least = std::min(least, key), most = std::max(most, key);
      require(splat < splats, "an item names no splat");
      Box b(box + 2 * static_cast<std::size_t>(splat));
      require(b.x0 <= b.x1 && b.x1 < tiles_x && b.y0 <= b.y1 && b.y0 < high && b.y1 >= low, "a box of tiles is out of range");
      // The part of it in this band, from its first row.
      const std::uint32_t above = b.y0 < low ? low - b.y0 : 0, width = b.width();
      const std::uint32_t y0 = b.y0 + above - low, y1 = std::min(b.y1 + 1, high) - low;
      ++cursor[y0 * stride + b.x0];
      --cursor[y0 * stride + b.x1 + 1];
      --cursor[y1 * stride + b.x0];
      ++cursor[y1 * stride + b.x1 + 1];
      records[filled] = {static_cast<std::uint32_t>(y0 * stride) + b.x0, (y1 - y0) << 16 | width, start[splat] + above * width, splat};
      room[filled] = static_cast<std::uint64_t>(key) << 32 | filled;
      ++filled;
    }
  }
  require(filled == n, "fewer splats than were counted");
  std::uint32_t sum = 0;
  std::vector<std::uint32_t> above(tiles_x, 0);
  for (std::size_t y = 0; y < high - low; ++y) {
    std::uint32_t row = 0;
    for (std::size_t x = 0; x < tiles_x; ++x) {
      std::uint32_t& here = cursor[y * stride + x];
      // Entries of this tile: what the rows above hand down, and what begins and ends here.
      row += here;
      const std::uint32_t count = above[x] += row;
      offset[y * tiles_x + x] = first + sum;
      here = sum;
      sum += count;
    }
  }
  require(sum == entries.size(), "other entries than were counted");
  auto put = [=](std::uint32_t at, std::uint32_t splat, std::uint32_t slot) {
    entry[at] = splat;
    target[at] = slot;
  };
  const std::uint64_t* sorted = sort(room, room + n, n, least, most);
  for (std::size_t i = 0; i < n; ++i) {
    const Record r = records[static_cast<std::uint32_t>(sorted[i])];
    const std::uint32_t height = r.size >> 16, width = r.size & 0xffff;
    if (height <= 2 && width <= 2) {
      // Most splats: the same steps for one, two or four tiles. What is no tile of its own is put into the corner's next
      // place, where the corner itself comes last.
      const std::uint32_t right = width - 1, down = height - 1, both = right & down;
      std::uint32_t *const c0 = cursor + r.corner, *const c1 = c0 + right, *const c2 = c0 + down * stride;
      std::uint32_t* const c3 = c0 + both * (stride + 1);
      const std::uint32_t at0 = *c0, at1 = *c1, at2 = *c2, at3 = *c3;
      put(at3, r.splat, r.slot + width + 1);
      put(at2, r.splat, r.slot + width);
      put(at1, r.splat, r.slot + 1);
      put(at0, r.splat, r.slot);
      *c3 = at3 + both, *c2 = at2 + down, *c1 = at1 + right, *c0 = at0 + 1;
      continue;
    }
    std::uint32_t slot = r.slot;
    for (std::uint32_t y = 0; y < height; ++y)
      for (std::uint32_t x = 0; x < width; ++x, ++slot) put(cursor[r.corner + y * stride + x]++, r.splat, slot);
  }
}

}  // namespace respire
