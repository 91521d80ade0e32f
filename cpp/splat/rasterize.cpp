// The dispatcher of the vectorised rasteriser: checks the arguments from Rust once per call, fills the plain structs
// of kernel.h and calls the kernels of one instruction set.
#include "cpp/splat/rasterize.h"

#include <algorithm>

#include "cpp/common/isa.h"
#include "cpp/common/require.h"
#include "cpp/splat/kernel.h"
#include "respire-bench/src/ffi/splat/rasterize.rs.h"

namespace respire {
namespace {

const Kernels& kernels_of(std::uint8_t isa) {
  require(isa <= widest_isa(), "this processor lacks the instruction set asked for");
  switch (isa) {
    case 2: return avx512::KERNELS;
    case 1: return avx2::KERNELS;
    default: return baseline::KERNELS;
  }
}

// Tables of records as the numbers in them. Each call asks Rust for the pointer, so none of these stands in a loop.
const float* floats(rust::Slice<const AlignedRow> rows) { return reinterpret_cast<const float*>(rows.data()); }
float* floats(rust::Slice<AlignedRow> rows) { return reinterpret_cast<float*>(rows.data()); }
template <class T, std::size_t N>
T* flat(rust::Slice<std::array<T, N>> rows) {
  return reinterpret_cast<T*>(rows.data());
}
template <class T, std::size_t N>
const T* flat(rust::Slice<const std::array<T, N>> rows) {
  return reinterpret_cast<const T*>(rows.data());
}
const float* null_if_empty(rust::Slice<const float> values) { return values.empty() ? nullptr : values.data(); }

bool all_below(rust::Slice<const std::uint32_t> values, std::size_t bound) {
  std::uint32_t most = 0;
  for (std::uint32_t v : values) most = v > most ? v : most;
  return values.empty() || most < bound;
}

template <class T, std::size_t N>
void copy(const std::array<T, N>& from, T (&to)[N]) {
  std::copy(from.begin(), from.end(), to);
}

View view_of(const SplatCamera& camera) {
  View view;
  copy(camera.rotation, view.rotation);
  copy(camera.eye, view.eye);
  copy(camera.focal, view.focal);
  copy(camera.center, view.center);
  copy(camera.low, view.low);
  copy(camera.high, view.high);
  copy(camera.size, view.size);
  view.near = camera.near;
  view.dilation = camera.dilation;
  view.by_opacity = camera.extent_by_opacity ? 1.0f : 0.0f;
  view.skip_beside = camera.skip_beside;
  view.compensate = camera.compensate;
  view.fisheye = camera.fisheye;
  copy(camera.distortion, view.lens);
  view.cone_cosine = camera.cone_cosine;
  view.cone_sine = camera.cone_sine;
  view.cone_reach = camera.cone_reach;
  return view;
}

ExactView exact_view_of(const SplatExactCamera& camera) {
  ExactView view;
  copy(camera.rotation, view.rotation);
  copy(camera.eye, view.eye);
  copy(camera.focal, view.focal);
  copy(camera.center, view.center);
  copy(camera.distortion, view.lens);
  return view;
}

// The scene as the kernels take it; checks that numbers first..first + count exist.
Scene scene_of(const SplatScene& s, std::size_t first, std::size_t count) {
  const std::size_t n = s.opacities.size(), columns = s.scales.empty() ? 6 : 4;
  const std::size_t basis = (s.sh_degree + 1) * (s.sh_degree + 1);
  require(s.sh_degree <= 3 && s.positions.size() == 3 * n && s.shape.size() == columns * n &&
              (s.scales.empty() || s.scales.size() == 3 * n) && s.sh.size() == 3 * basis * n,
          "the arrays of the Gaussians differ in length");
  const std::size_t known = s.all ? n : s.active.size();
  require(first <= known && count <= known - first, "there are not as many Gaussians");
  const std::uint32_t* active = s.all ? nullptr : s.active.data();
  if (active) {
    std::uint32_t most = 0;
    for (std::size_t k = first; k < first + count; ++k) most = active[k] > most ? active[k] : most;
    require(count == 0 || most < n, "an active index names no Gaussian");
  }
  Scene scene;
  scene.view = view_of(s.camera);
  scene.exact = exact_view_of(s.exact_camera);
  scene.positions = s.positions.data();
  scene.shape = s.shape.data();
  scene.scales = null_if_empty(s.scales);
  scene.opacities = s.opacities.data();
  scene.sh = s.sh.data();
  scene.sh_degree = s.sh_degree;
  scene.active = active;
  return scene;
}

TangentChunk tangent_of(const SplatScene& scene, std::size_t first, rust::Slice<const bool> visible,
                        const SplatMotion& motion, rust::Slice<std::array<float, 8>> rows) {
  const std::size_t n = scene.opacities.size(), columns = scene.scales.empty() ? 6 : 9;
  const auto is_none_or = [](rust::Slice<const float> values, std::size_t size) {
    return values.empty() || values.size() == size;
  };
  require(
      is_none_or(motion.positions, 3 * n) && is_none_or(motion.shape, columns * n) && is_none_or(motion.colors, 3 * n),
      "a motion has another length than the Gaussians");
  require(is_none_or(motion.pose, 6), "a motion of the camera has 6 numbers");
  TangentChunk chunk;
  chunk.first = first;
  chunk.count = visible.size();
  chunk.visible = visible.data();
  chunk.positions = null_if_empty(motion.positions);
  chunk.shape = null_if_empty(motion.shape);
  chunk.colors = null_if_empty(motion.colors);
  chunk.pose = null_if_empty(motion.pose);
  chunk.rows = flat(rows);
  return chunk;
}

DiscTile disc_tile_of(const SplatDiscs& d) {
  require(d.discs.size() == d.rows.size() && all_below(d.entries, d.rows.size()), "a tile entry names no disc");
  require(d.rays.size() == static_cast<std::size_t>(d.width) * d.height && d.x < d.width && d.y < d.height,
          "a tile of discs lies outside the image");
  DiscTile tile;
  tile.rows = floats(d.rows);
  tile.discs = floats(d.discs);
  tile.entries = d.entries.data();
  tile.count = d.entries.size();
  tile.x = d.x, tile.y = d.y;
  tile.width = d.width, tile.height = d.height;
  tile.rays = flat(d.rays);
  tile.pinhole = d.pinhole;
  copy(d.per_px, tile.per_px);
  tile.near = d.near;
  tile.filter = d.filter;
  return tile;
}

void require_directions(bool wanted) { require(WITH_DIRECTIONS || !wanted, "built without velocities"); }

// The threshold for a pixel's transmittance; -1, which none reaches, if pixels do not stop.
float stop_of(std::uint32_t parts) { return parts & ENDLESS ? -1.0f : STOP; }

}  // namespace

void splat_project(std::uint8_t isa, const SplatScene& scene, std::array<std::uint32_t, 2> tiles, SplatChunk out,
                   const SplatMotion& motion) {
  const Kernels& kernels = kernels_of(isa);
  const std::size_t count = out.visible.size();
  require(out.rows.size() == count && out.boxes.size() == count && out.keys.size() == count,
          "tables of a projection differ in length");
  const auto fits_box = [](std::uint32_t tiles) { return tiles > 0 && tiles <= 0xffff; };
  require(fits_box(tiles[0]) && fits_box(tiles[1]), "boxes of tiles have 16 bits for a side");
  require(out.velocities.empty() || out.velocities.size() == count, "tables of a motion differ in length");
  TangentChunk tangent;
  const bool moving = !out.velocities.empty();
  require_directions(moving);
  if (moving) tangent = tangent_of(scene, out.first, {out.visible.data(), count}, motion, out.velocities);
  ProjectChunk chunk;
  chunk.first = out.first;
  chunk.count = count;
  chunk.tiles_x = tiles[0], chunk.tiles_y = tiles[1];
  chunk.rows = floats(out.rows);
  chunk.boxes = flat(out.boxes);
  chunk.keys = out.keys.data();
  chunk.visible = out.visible.data();
  chunk.motion = moving ? &tangent : nullptr;
  kernels.project(scene_of(scene, out.first, count), chunk);
}

bool splat_recolor(std::uint8_t isa, const SplatScene& scene, std::size_t first, rust::Slice<const bool> visible,
                   rust::Slice<AlignedRow> rows) {
  const Kernels& kernels = kernels_of(isa);
  require(rows.size() == visible.size(), "tables of a projection differ in length");
  const RecolorChunk chunk{first, visible.size(), visible.data(), floats(rows)};
  return kernels.recolor(scene_of(scene, first, visible.size()), chunk);
}

void splat_velocities(std::uint8_t isa, const SplatScene& scene, std::size_t first, rust::Slice<const bool> visible,
                      const SplatMotion& motion, rust::Slice<std::array<float, 8>> rows) {
  const Kernels& kernels = kernels_of(isa);
  require_directions(true);
  require(rows.size() == visible.size(), "tables of a motion differ in length");
  kernels.velocities(scene_of(scene, first, visible.size()), tangent_of(scene, first, visible, motion, rows));
}

SplatCameraGradient splat_chain(std::uint8_t isa, const SplatScene& scene, const SplatMoments& moments,
                                SplatGradients out) {
  const Kernels& kernels = kernels_of(isa);
  require(!moments.starts.empty(), "tables of a chain differ in length");
  const std::size_t count = moments.starts.size() - 1;
  const bool discs = scene.scales.empty();
  const auto check_room = [&](std::uint32_t group, rust::Slice<float> place, std::size_t each) {
    require(!(moments.wanted & group) || place.size() == each * count, "a wanted gradient has no room");
  };
  check_room(POSITIONS, out.positions, 3);
  check_room(SHAPES, out.shape, discs ? 6 : 4);
  check_room(SHAPES, out.scales, discs ? 0 : 3);
  check_room(OPACITIES, out.opacities, 1);
  check_room(HARMONICS, out.sh, 3 * (scene.sh_degree + 1) * (scene.sh_degree + 1));
  const std::size_t groups = (count + GROUP - 1) / GROUP;
  require(out.written.size() == groups && out.heard.size() == groups, "tables of a chain differ in length");
  const std::uint32_t* const starts = moments.starts.data();
  bool ascending = true;
  for (std::size_t k = 0; k < count; ++k) ascending &= starts[k] <= starts[k + 1];
  require(ascending, "entries of a splat are out of order");
  require(starts[count] <= moments.slots.size() && starts[count] <= moments.live.size(), "an entry has no slot");
  SplatCameraGradient camera;
  ChainChunk chunk;
  chunk.first = moments.first;
  chunk.count = count;
  chunk.starts = starts;
  chunk.slots = floats(moments.slots);
  chunk.live = moments.live.data();
  chunk.wanted = moments.wanted;
  chunk.positions = out.positions.data();
  chunk.shape = out.shape.data();
  chunk.scales = out.scales.data();
  chunk.opacities = out.opacities.data();
  chunk.sh = out.sh.data();
  chunk.pose = camera.pose.data();
  chunk.intrinsics = camera.intrinsics.data();
  chunk.written = out.written.data();
  chunk.heard = out.heard.data();
  kernels.chain(scene_of(scene, moments.first, count), chunk);
  return camera;
}

void splat_forward(std::uint8_t isa, SplatForward t) {
  const Kernels& kernels = kernels_of(isa);
  const std::size_t splats = t.rows.size(), directions = t.moving.size() / (MOVING * PIXELS);
  require(all_below(t.entries, splats), "a tile entry names no splat");
  require(t.masks.size() == t.entries.size() && t.state.size() == PLANES * PIXELS, "tables of a tile differ in length");
  require(t.moving.size() == directions * MOVING * PIXELS && directions <= MAX_DIRECTIONS &&
              t.velocities.size() == directions * splats,
          "tables of a tile's motion differ in length");
  require_directions(directions > 0);
  ForwardTile tile;
  tile.rows = floats(t.rows);
  tile.entries = t.entries.data();
  tile.masks = t.masks.data();
  tile.count = t.entries.size();
  tile.x = t.corner[0], tile.y = t.corner[1];
  tile.stop = stop_of(t.parts);
  tile.state = t.state.data();
  tile.directions = static_cast<std::uint32_t>(directions);
  const float* velocities = flat(t.velocities);
  for (std::size_t d = 0; d < directions; ++d) tile.velocities[d] = velocities + d * 8 * splats;
  tile.moving = t.moving.data();
  kernels.forward(tile, t.parts);
}

void splat_backward(std::uint8_t isa, const SplatBackward& t, AlignedRow* slots, bool* live, std::size_t slot_count) {
  const Kernels& kernels = kernels_of(isa);
  require(all_below(t.entries, t.rows.size()), "a tile entry names no splat");
  require(
      t.masks.size() == t.entries.size() && t.targets.size() == t.entries.size() && t.adjoint.size() == PLANES * PIXELS,
      "tables of a tile differ in length");
  require(all_below(t.targets, slot_count), "an entry has no slot");
  BackwardTile tile;
  tile.rows = floats(t.rows);
  tile.entries = t.entries.data();
  tile.masks = t.masks.data();
  tile.count = t.entries.size();
  tile.x = t.corner[0], tile.y = t.corner[1];
  tile.stop = stop_of(t.parts);
  tile.adjoint = t.adjoint.data();
  tile.targets = t.targets.data();
  tile.slots = reinterpret_cast<float*>(slots);
  tile.live = live;
  kernels.backward(tile, t.parts);
}

void splat_disc_forward(std::uint8_t isa, const SplatDiscs& discs, bool with_depth, rust::Slice<float> state) {
  const Kernels& kernels = kernels_of(isa);
  require(state.size() == PLANES * PIXELS, "tables of a tile differ in length");
  kernels.disc_forward(disc_tile_of(discs), with_depth, state.data());
}

void splat_disc_backward(std::uint8_t isa, const SplatDiscs& discs, rust::Slice<const float> adjoint,
                         std::uint32_t parts, rust::Slice<float> sums) {
  const Kernels& kernels = kernels_of(isa);
  require(adjoint.size() == PLANES * PIXELS && sums.size() == DISC_SUMS * discs.entries.size(),
          "tables of a tile differ in length");
  kernels.disc_backward(disc_tile_of(discs), adjoint.data(), parts, sums.data());
}

}  // namespace respire
