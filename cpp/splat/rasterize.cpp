#include "cpp/splat/rasterize.h"

#include <stdexcept>

#include "cpp/common/isa.h"
#include "cpp/splat/kernel.h"
#include "respire-bench/src/ffi/splat/rasterize.rs.h"

namespace respire {
namespace {

void require(bool good, const char* what) {
  if (!good) throw std::invalid_argument(what);
}

void check_isa(std::uint8_t isa) {
  require(isa <= widest_isa(), "this processor lacks the instruction set asked for");
}

// The kernels of `isa`.
#define CALL(isa, function, ...)                             \
  switch (isa) {                                             \
    case 2: return avx512::function(__VA_ARGS__);            \
    case 1: return avx2::function(__VA_ARGS__);              \
    default: return baseline::function(__VA_ARGS__);         \
  }

bool all_below(rust::Slice<const std::uint32_t> values, std::size_t bound) {
  std::uint32_t most = 0;
  for (std::uint32_t v : values) most = v > most ? v : most;
  return values.empty() || most < bound;
}

void check_tile(std::uint8_t isa, std::size_t rows, rust::Slice<const std::uint32_t> entries, std::size_t masks) {
  check_isa(isa);
  require(rows % 16 == 0 && masks == entries.size(), "tables of a tile differ in length");
  require(all_below(entries, rows / 16), "tile entry names no splat");
}

// The scene as the kernels see it, where numbers first..first + count exist.
Scene scene_of(const SplatScene& s, View& view, std::size_t first, std::size_t count) {
  const std::size_t n = s.opacities.size(), columns = s.scales.empty() ? 6 : 4;
  const std::size_t basis = (s.sh_degree + 1) * (s.sh_degree + 1);
  require(s.sh_degree <= 3 && s.positions.size() == 3 * n && s.shape.size() == columns * n &&
              (s.scales.empty() || s.scales.size() == 3 * n) && s.sh.size() == 3 * basis * n,
          "the arrays of the Gaussians differ in length");
  require(s.view.size() == sizeof(View) / sizeof(float) && s.exact.size() == 20, "a view has 33 numbers and 20");
  const std::size_t known = s.all ? n : s.active.size();
  require(first <= known && count <= known - first, "there are not as many Gaussians");
  if (!s.all) {
    const std::uint32_t* active = s.active.data();
    std::uint32_t most = 0;
    for (std::size_t k = first; k < first + count; ++k) most = active[k] > most ? active[k] : most;
    require(count == 0 || most < n, "an active index names no Gaussian");
  }
  __builtin_memcpy(&view, s.view.data(), sizeof view);
  return {&view,          s.positions.data(), s.shape.data(),     s.scales.empty() ? nullptr : s.scales.data(),
          s.opacities.data(), s.sh.data(),    s.sh_degree, s.all ? nullptr : s.active.data(), s.exact.data()};
}

const float* given(rust::Slice<const float> values, std::size_t wanted) {
  require(values.empty() || values.size() == wanted, "a motion has another length than the Gaussians");
  return values.empty() ? nullptr : values.data();
}

TangentChunk tangent_of(const SplatScene& scene, std::size_t first, std::size_t count, const bool* visible,
                        const SplatMotion& motion, rust::Slice<float> rows) {
  require(rows.empty() || rows.size() == 8 * count, "tables of a motion differ in length");
  require(motion.pose.empty() || motion.pose.size() == 6, "a motion of the camera has 6 numbers");
  const std::size_t n = scene.opacities.size(), columns = scene.scales.empty() ? 6 : 9;
  return {first,
          count,
          visible,
          given(motion.positions, 3 * n),
          given(motion.shape, columns * n),
          given(motion.colors, 3 * n),
          motion.pose.empty() ? nullptr : motion.pose.data(),
          rows.data()};
}

DiscTile disc_tile_of(std::uint8_t isa, const SplatDiscs& d) {
  check_isa(isa);
  require(d.rows.size() % 16 == 0 && d.discs.size() == d.rows.size() && all_below(d.entries, d.rows.size() / 16),
          "tile entry names no disc");
  require(d.rays.size() == 3 * static_cast<std::size_t>(d.width) * d.height && d.blocks != 0 && d.x < d.width && d.y < d.height,
          "a tile of discs lies outside the image");
  return {d.rows.data(), d.discs.data(), d.entries.data(), d.entries.size(), d.x, d.y, d.width, d.height, d.blocks,
          d.rays.data(), d.pinhole, {d.per_px[0], d.per_px[1]}, d.near, d.filter};
}

float stop_of(std::uint32_t parts) { return parts & ENDLESS ? -1.0f : STOP; }

}  // namespace

void splat_project(std::uint8_t isa, const SplatScene& scene, std::size_t first, std::uint32_t tiles_x,
                   std::uint32_t tiles_y, std::uint32_t side, rust::Slice<float> rows, rust::Slice<std::uint32_t> boxes,
                   rust::Slice<std::uint32_t> keys, rust::Slice<bool> visible, const SplatMotion& motion,
                   rust::Slice<float> velocities) {
  check_isa(isa);
  const std::size_t count = visible.size();
  require(rows.size() == 16 * count && boxes.size() == 2 * count && keys.size() == count, "tables of a projection differ in length");
  View view;
  const Scene s = scene_of(scene, view, first, count);
  require(side > 0, "a tile has no pixels");
  const TangentChunk tangent = tangent_of(scene, first, count, visible.data(), motion, velocities);
  const ProjectChunk chunk{first, count, tiles_x, tiles_y, 1.0f / static_cast<float>(side), rows.data(), boxes.data(),
                           keys.data(), visible.data(), velocities.empty() ? nullptr : &tangent};
  CALL(isa, project, s, chunk)
}

bool splat_recolor(std::uint8_t isa, const SplatScene& scene, std::size_t first, rust::Slice<const bool> visible,
                   rust::Slice<float> rows) {
  check_isa(isa);
  const std::size_t count = visible.size();
  require(rows.size() == 16 * count, "tables of a projection differ in length");
  View view;
  const Scene s = scene_of(scene, view, first, count);
  bool finite = true;
  const RecolorChunk chunk{first, count, visible.data(), rows.data(), &finite};
  const auto run = [&] { CALL(isa, recolor, s, chunk) };
  run();
  return finite;
}

void splat_velocities(std::uint8_t isa, const SplatScene& scene, std::size_t first, rust::Slice<const bool> visible,
                      const SplatMotion& motion, rust::Slice<float> rows) {
  check_isa(isa);
  const std::size_t count = visible.size();
  require(rows.size() == 8 * count, "tables of a motion differ in length");
  View view;
  const Scene s = scene_of(scene, view, first, count);
  const TangentChunk chunk = tangent_of(scene, first, count, visible.data(), motion, rows);
  CALL(isa, velocities, s, chunk)
}

void splat_chain(std::uint8_t isa, const SplatScene& scene, std::size_t first, rust::Slice<const std::uint32_t> starts,
                 rust::Slice<const float> slots, std::uint32_t wanted,
                 rust::Slice<float> positions, rust::Slice<float> shape, rust::Slice<float> scales,
                 rust::Slice<float> opacities, rust::Slice<float> sh, rust::Slice<double> camera) {
  check_isa(isa);
  require(!starts.empty() && camera.size() == 10, "tables of a chain differ in length");
  const std::size_t count = starts.size() - 1;
  const bool discs = scene.scales.empty();
  auto has = [&](std::uint32_t group, std::size_t size, std::size_t each) {
    require(!(wanted & group) || size == each * count, "a wanted gradient has no room");
  };
  has(POSITIONS, positions.size(), 3);
  has(SHAPES, shape.size(), discs ? 6 : 4);
  has(SHAPES, scales.size(), discs ? 0 : 3);
  has(OPACITIES, opacities.size(), 1);
  has(HARMONICS, sh.size(), 3 * (scene.sh_degree + 1) * (scene.sh_degree + 1));
  View view;
  const Scene s = scene_of(scene, view, first, count);
  // A slice asks Rust for its pointer each time.
  const std::uint32_t* start = starts.data();
  bool ascending = true;
  for (std::size_t k = 0; k < count; ++k) ascending &= start[k] <= start[k + 1];
  require(ascending, "entries of a splat are out of order");
  require(start[count] <= slots.size() / 16, "an entry has no slot");
  const ChainChunk chunk{first,          count,         starts.data(),    slots.data(), wanted,
                         positions.data(), shape.data(), scales.data(), opacities.data(), sh.data(),    camera.data()};
  CALL(isa, chain, s, chunk)
}

void splat_forward(std::uint8_t isa, rust::Slice<const float> rows, rust::Slice<const std::uint32_t> entries,
                   rust::Slice<std::uint16_t> masks, float x, float y, std::uint16_t blocks, rust::Slice<float> state,
                   std::uint32_t parts, rust::Slice<const float> velocities, rust::Slice<float> moving) {
  check_tile(isa, rows.size(), entries, masks.size());
  const std::size_t splats = rows.size() / 16;
  const std::size_t directions = moving.size() / (MOVING * PIXELS);
  require(state.size() == PLANES * PIXELS && moving.size() == directions * MOVING * PIXELS && directions <= TOGETHER &&
              velocities.size() == directions * 8 * splats,
          "tables of a tile differ in length");
  ForwardTile tile{rows.data(), entries.data(), masks.data(), entries.size(), x, y, blocks, stop_of(parts), state.data(),
                   static_cast<std::uint32_t>(directions), {}, moving.data()};
  for (std::size_t d = 0; d < directions; ++d) tile.velocities[d] = velocities.data() + d * 8 * splats;
  CALL(isa, forward, tile, parts)
}

void splat_backward(std::uint8_t isa, rust::Slice<const float> rows, rust::Slice<const std::uint32_t> entries,
                    rust::Slice<const std::uint16_t> masks, rust::Slice<const std::uint32_t> targets, float x, float y,
                    rust::Slice<const float> adjoint, float* slots, std::size_t slot_count, std::uint32_t parts) {
  check_tile(isa, rows.size(), entries, masks.size());
  require(adjoint.size() == PLANES * PIXELS && targets.size() == entries.size(), "tables of a tile differ in length");
  require(all_below(targets, slot_count), "an entry has no slot");
  const BackwardTile tile{rows.data(), entries.data(), masks.data(), entries.size(), x, y, stop_of(parts), adjoint.data(), targets.data(), slots};
  CALL(isa, backward, tile, parts)
}

void splat_disc_forward(std::uint8_t isa, const SplatDiscs& discs, bool with_depth, rust::Slice<float> state) {
  const DiscTile tile = disc_tile_of(isa, discs);
  require(state.size() == PLANES * PIXELS, "tables of a tile differ in length");
  CALL(isa, disc_forward, tile, with_depth, state.data())
}

void splat_disc_backward(std::uint8_t isa, const SplatDiscs& discs, rust::Slice<const float> adjoint,
                         std::uint32_t parts, rust::Slice<float> sums) {
  const DiscTile tile = disc_tile_of(isa, discs);
  require(adjoint.size() == PLANES * PIXELS && sums.size() == DISC_SUMS * tile.count, "tables of a tile differ in length");
  CALL(isa, disc_backward, tile, adjoint.data(), parts, sums.data())
}

}  // namespace respire
