// From splats to the lists of tiles, a band of tile rows at a time: splats are distributed to the bands that their
// boxes meet; each band is sorted by depth (stable radix sort) and counted out to its tiles. Plain code for any
// x86-64, since memory and branches limit it, not arithmetic. The plain twin is in src/splat/plain/bins.rs.
#include "cpp/splat/bin.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <vector>

#include "cpp/common/require.h"
#include "respire-bench/src/ffi/splat/bin.rs.h"

namespace respire {
namespace {

// A band has at most 2^MAX_SHIFT rows of tiles: the 1024 of the largest image (16384 pixels) in BANDS bands.
constexpr std::uint32_t MAX_SHIFT = 6;

// Entries are numbered in 32 bits. A number that wrapped would name the place of another entry.
constexpr std::uint64_t MAX_ENTRIES = 0xffffffff;
constexpr const char* TOO_MANY = "more entries of tiles than 32 bits can number";

struct Box {
  std::uint32_t x0, y0, x1, y1;
  explicit Box(const std::array<std::uint32_t, 2>& packed)
      : x0(packed[0] & 0xffff), y0(packed[0] >> 16), x1(packed[1] & 0xffff), y1(packed[1] >> 16) {}
  std::uint32_t width() const { return x1 - x0 + 1; }
};

// The data of a splat in a band, indexed by its number in the band while these numbers are sorted.
struct Record {
  std::uint32_t corner, size;  // first cell of its box; its height << 16 | its width
  std::uint32_t slot, splat;   // slot of the first cell
};

std::uint32_t upper(std::uint64_t item) { return static_cast<std::uint32_t>(item >> 32); }

// Stable sort of a by the upper word less `least`, bits from..from + passes * width of it; the result is in a or in b.
std::uint64_t* sort_by_digits(std::uint64_t* a, std::uint64_t* b, std::size_t n, std::uint32_t least, int from,
                              int width, int passes) {
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

// Stable insertion sort of a nearly sorted a by the upper word; false, with a part sorted, when that takes more than
// `max_moves` moves.
bool insertion_sort(std::uint64_t* a, std::size_t n, std::size_t max_moves) {
  for (std::size_t i = 1; i < n; ++i) {
    if (upper(a[i - 1]) <= upper(a[i])) continue;
    const std::uint64_t item = a[i];
    std::size_t k = i;
    for (; k > 0 && upper(a[k - 1]) > upper(item); --k) {
      a[k] = a[k - 1];
      if (max_moves-- == 0) {
        a[k - 1] = item;
        return false;
      }
    }
    a[k] = item;
  }
  return true;
}

// Stable sort of a by the upper word, which lies between `least` and `most`; the result is in a or in b.
const std::uint64_t* sort(std::uint64_t* a, std::uint64_t* b, std::size_t n, std::uint32_t least, std::uint32_t most) {
  const int bits = most > least ? 32 - __builtin_clz(most - least) : 0;
  if (!bits) return a;
  // Two digits from the top of the range bring nearly all items into their places, and insertion sort does the rest.
  int width = 8;
  while (width < 11 && (n >> width) > 1) ++width;
  if (bits > 2 * width) {
    a = sort_by_digits(a, b, n, least, bits - 2 * width, width, 2);
    if (insertion_sort(a, n, 4 * n)) return a;
  }
  // Where depths lie in clusters: all digits, as few and as even as possible.
  const int passes = (bits + 10) / 11;
  return sort_by_digits(a, b, n, least, 0, (bits + passes - 1) / passes, passes);
}

}  // namespace

void bin_count(const BinSplats& chunk, std::uint32_t shift, rust::Slice<std::uint32_t> starts, Counts& counts) {
  const std::size_t n = chunk.visible.size();
  require(chunk.boxes.size() == n && starts.size() == n && shift <= MAX_SHIFT, "tables of the bins differ in length");
  counts = Counts{};
  // A slice asks Rust for its pointer each time.
  const bool* visible = chunk.visible.data();
  const std::array<std::uint32_t, 2>* boxes = chunk.boxes.data();
  std::uint32_t* start = starts.data();
  if (!n || !std::memchr(visible, 1, n)) return;
  // Differences: counts that begin and end with each band and each row of tiles. A loop over the bands and rows of a
  // box would have an end that the processor cannot predict.
  std::uint32_t all = 0, band_changes[BANDS + 1] = {}, row_changes[(BANDS << MAX_SHIFT) + 1];
  std::uint64_t sum = 0;
  const std::uint32_t height = 1u << shift;
  std::fill_n(row_changes, BANDS * height + 1, 0u);
  for (std::size_t k = 0; k < n; ++k) {
    if (visible[k]) {
      const Box b(boxes[k]);
      require(b.x0 <= b.x1 && b.y0 <= b.y1 && (b.y1 >> shift) < BANDS, "a box of tiles is empty or too large");
      const std::uint32_t w = b.width();
      ++all;
      ++band_changes[b.y0 >> shift];
      --band_changes[(b.y1 >> shift) + 1];
      row_changes[b.y0] += w;
      row_changes[b.y1 + 1] -= w;
      sum += static_cast<std::uint64_t>(b.y1 - b.y0 + 1) * w;
    }
    start[k] = static_cast<std::uint32_t>(sum);
  }
  require(sum <= MAX_ENTRIES, TOO_MANY);
  // Sums of the differences are the splats of each band and the tiles of each row.
  std::uint32_t splats = 0, tiles = 0;
  for (std::size_t band = 0; band < BANDS; ++band) {
    std::uint32_t in_band = 0;
    for (std::uint32_t y = 0; y < height; ++y) in_band += tiles += row_changes[band * height + y];
    counts.splats[band] = splats += band_changes[band];
    counts.tiles[band] = in_band;
  }
  counts.visible = all;
}

void bin_distribute(const BinSplats& chunk, std::uint32_t shift, const Counts& counts, Distribution to) {
  const std::size_t n = chunk.visible.size();
  require(chunk.boxes.size() == n && chunk.keys.size() == n && to.starts.size() == n && shift <= MAX_SHIFT,
          "tables of the bins differ in length");
  std::size_t cursors[BANDS], sum = 0;
  for (std::size_t band = 0; band < BANDS; ++band) cursors[band] = sum, sum += counts.splats[band];
  require(to.items.size() == sum, "tables of the bins differ in length");
  const bool* visible = chunk.visible.data();
  const std::array<std::uint32_t, 2>* boxes = chunk.boxes.data();
  const std::uint32_t* keys = chunk.keys.data();
  std::uint32_t* start = to.starts.data();
  std::uint64_t* out = to.items.data();
  if (sum == 0) {
    // No splat of the chunk is visible: its slots are never read, only where those of the next chunk begin.
    if (n) start[n - 1] = to.base;
    return;
  }
  require(n > 0 && start[n - 1] <= MAX_ENTRIES - to.base, TOO_MANY);
  for (std::size_t k = 0; k < n; ++k) {
    start[k] += to.base;
    if (!visible[k]) continue;
    const Box b(boxes[k]);
    const std::uint64_t item = static_cast<std::uint64_t>(keys[k]) << 32 | (to.first + static_cast<std::uint32_t>(k));
    const std::uint32_t from = b.y0 >> shift, last = b.y1 >> shift;
    require(from <= last && last < BANDS && cursors[from] < sum, "more splats than were counted");
    out[cursors[from]++] = item;
    for (std::uint32_t band = from + 1; band <= last; ++band) {
      require(cursors[band] < sum, "more splats than were counted");
      out[cursors[band]++] = item;
    }
  }
}

void bin_fill(const BinItems& all, Band band) {
  const std::size_t n = band.scratch.size() / 4, cells = band.offsets.size(), splats = all.boxes.size();
  const std::uint32_t low = band.row_begin, high = band.row_end, tiles_x = all.tiles_x;
  require(low <= high && cells == static_cast<std::size_t>(high - low) * tiles_x && all.starts.size() == splats + 1 &&
              band.scratch.size() == 4 * n && band.targets.size() == band.entries.size(),
          "tables of the bins differ in length");
  // Boxes have 16 bits for a side, and records 32 for a place.
  require(high <= 0xffff && tiles_x <= 0xffff && n <= MAX_ENTRIES && band.entries.size() <= MAX_ENTRIES - band.first,
          TOO_MANY);
  const std::uint64_t* in = all.items.data();
  const std::array<std::uint32_t, 2>* boxes = all.boxes.data();
  const std::uint32_t* start = all.starts.data();
  // The scratch: items and their other half of the radix sort, then the records.
  std::uint64_t* scratch = band.scratch.data();
  Record* const records = reinterpret_cast<Record*>(scratch + 2 * n);
  std::uint32_t *const offset = band.offsets.data(), *const entry = band.entries.data(),
                       *const target = band.targets.data();
  const std::size_t item_count = all.items.size(), stride = tiles_x + 1;
  // The changes of the number of entries at each tile, so that sums along rows and columns count the entries of each.
  std::vector<std::uint32_t> cursors(stride * (high - low + 1), 0);
  std::uint32_t* const cursor = cursors.data();
  std::uint32_t least = ~0u, most = 0;
  std::size_t filled = 0;
  for (const ItemRange& piece : band.pieces) {
    require(piece.begin <= piece.end && piece.end <= item_count && piece.end - piece.begin <= n - filled,
            "a piece of the bins is out of range");
    for (std::size_t i = piece.begin; i < piece.end; ++i) {
      const std::uint32_t key = upper(in[i]), splat = static_cast<std::uint32_t>(in[i]);
      least = std::min(least, key), most = std::max(most, key);
      require(splat < splats, "an item names no splat");
      const Box b(boxes[splat]);
      require(b.x0 <= b.x1 && b.x1 < tiles_x && b.y0 <= b.y1 && b.y0 < high && b.y1 >= low,
              "a box of tiles is out of range");
      // The part of it in this band, from its first row.
      const std::uint32_t above = b.y0 < low ? low - b.y0 : 0, width = b.width();
      const std::uint32_t y0 = b.y0 + above - low, y1 = std::min(b.y1 + 1, high) - low;
      ++cursor[y0 * stride + b.x0];
      --cursor[y0 * stride + b.x1 + 1];
      --cursor[y1 * stride + b.x0];
      ++cursor[y1 * stride + b.x1 + 1];
      records[filled] = {static_cast<std::uint32_t>(y0 * stride) + b.x0, (y1 - y0) << 16 | width,
                         start[splat] + above * width, splat};
      scratch[filled] = static_cast<std::uint64_t>(key) << 32 | filled;
      ++filled;
    }
  }
  require(filled == n, "fewer splats than were counted");
  std::uint64_t sum = 0;
  std::vector<std::uint32_t> above(tiles_x, 0);
  for (std::size_t y = 0; y < high - low; ++y) {
    std::uint32_t row = 0;
    for (std::size_t x = 0; x < tiles_x; ++x) {
      std::uint32_t& here = cursor[y * stride + x];
      // Entries of this tile: those of the tile above, and the changes of this row up to here.
      row += here;
      const std::uint32_t count = above[x] += row;
      offset[y * tiles_x + x] = band.first + static_cast<std::uint32_t>(sum);
      here = static_cast<std::uint32_t>(sum);
      sum += count;
    }
  }
  require(sum == band.entries.size(), "other entries than were counted");
  // Front to back, so that each tile's entries are front to back.
  auto put = [=](std::uint32_t at, std::uint32_t splat, std::uint32_t slot) {
    entry[at] = splat;
    target[at] = slot;
  };
  const std::uint64_t* sorted = sort(scratch, scratch + n, n, least, most);
  for (std::size_t i = 0; i < n; ++i) {
    const Record r = records[static_cast<std::uint32_t>(sorted[i])];
    const std::uint32_t height = r.size >> 16, width = r.size & 0xffff;
    if (height <= 2 && width <= 2) {
      // Most splats: the same steps for one, two or four tiles, without a branch. A tile that the splat lacks is
      // written to the corner's next place, which the corner's own entry overwrites at the end.
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
