// From Gaussians to splats, LANES at a time: projection, colours, velocities; compiled once per instruction set.
// After 3DGS (Kerbl et al. 2023, Eq. 5), with extents that end where alpha is 1/255; the plain twin, which explains
// the symbols, is src/splat/plain/project.rs. Left out: exact discs, which are projected in plain code
// (src/splat/plain/disc.rs).
#include "cpp/splat/project.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

// Centres in camera axes and on screen, computed in double and rounded once, so that neither the order of splats nor
// their positions depend on rounding. `rest`: the rounding error of the positions on screen.
template <template <class> class Camera>
inline void project_exactly(const Scene& s, const V* position, V* t, V* point, V* rest) {
  const double *r = s.exact.rotation, *eye = s.exact.eye;
  float in[3][LANES], out[7][LANES];
  for (int k = 0; k < 3; ++k) store(in[k], position[k]);
  for (int half = 0; half < 2; ++half) {
    VD d[3], exact[5];  // exact: t, then the image point
    for (int k = 0; k < 3; ++k) {
      VH v;
      __builtin_memcpy(&v, in[k] + LANES / 2 * half, sizeof v);
      d[k] = __builtin_convertvector(v, VD) - eye[k];
    }
    for (int k = 0; k < 3; ++k) exact[k] = r[3 * k] * d[0] + r[3 * k + 1] * d[1] + r[3 * k + 2] * d[2];
    Camera<V>::exact_point(s.exact, exact, exact + 3);
    for (int k = 0; k < 5; ++k) {
      const VH rounded = __builtin_convertvector(exact[k], VH);
      __builtin_memcpy(out[k] + LANES / 2 * half, &rounded, sizeof rounded);
      if (k < 3) continue;
      const VH left = __builtin_convertvector(exact[k] - __builtin_convertvector(rounded, VD), VH);
      __builtin_memcpy(out[k + 2] + LANES / 2 * half, &left, sizeof left);
    }
  }
  for (int k = 0; k < 3; ++k) t[k] = load(out[k]);
  for (int k = 0; k < 2; ++k) point[k] = load(out[3 + k]), rest[k] = load(out[5 + k]);
}

// The splats' velocities along one direction, by dual numbers. A velocity that is not finite becomes 0.
struct VelocityKernel {
  const Scene& s;
  const TangentChunk& o;

  template <int COLUMNS, template <class> class Camera>
  void run() const {
    if constexpr (WITH_DIRECTIONS) write_all<COLUMNS, Camera>();
  }

  template <int COLUMNS, template <class> class Camera>
  void write_all() const {
    const View& w = s.view;
    for_groups(s, o.first, o.count, [&](const LaneGroup& group) {
      const std::size_t k0 = group.k0;
      const int count = group.count;
      const std::uint32_t* const index = group.index;
      bool visible = false;
      for (int l = 0; l < count; ++l) visible |= o.visible[k0 + l];
      if (!visible) return;
      prefetch_next_group<COLUMNS>(s, group);
      if (group.contiguous && o.positions) prefetch_after(o.positions, group.from, 3);
      prefetch_after<1>(o.rows, k0, 8);
      V position[3], from_eye[3], t[3], point[2], rest[2];
      load_centers(s, group, position, from_eye);
      // The same operations as in the projection, hence the same bytes.
      project_exactly<Camera>(s, position, t, point, rest);
      Shape<COLUMNS> shape;
      shape.load(s, index);
      Dual away[3], color[3];
      Geometry<Dual, COLUMNS, Camera> g;
      g.set_constant(w, t, shape.m);
      for (int k = 0; k < 3; ++k) constant(from_eye[k], &away[k]);
      set_velocities(group, g, away);
      g.complete(w, away);
      color_towards(s, index, g.direction, color);
      write_rows(group, g, color);
    });
  }

  // Sets the derivatives of t, c and `offset`, the vector from the eye.
  template <int COLUMNS, template <class> class Camera>
  void set_velocities(const LaneGroup& group, Geometry<Dual, COLUMNS, Camera>& g, Dual* offset) const {
    const View& w = s.view;
    V velocity[3] = {V{}, V{}, V{}}, rotated[3];
    if (o.pose) {
      const float *omega = o.pose, *tau = o.pose + 3;
      auto cross_omega = [&](const Dual* v, int k) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        return omega[a] * v[b].v - omega[b] * v[a].v;
      };
      // A motion of the camera (omega, tau): t' = omega x t + tau, c' = omega x c; the eye moves by -R^T tau only.
      for (int k = 0; k < 3; ++k) velocity[k] = broadcast(tau[k]);
      rotate_back(w, velocity, rotated);
      for (int k = 0; k < 3; ++k) offset[k].d = rotated[k], g.t[k].d = cross_omega(g.t, k) + tau[k];
      for (int c = 0; c < COLUMNS; ++c)
        for (int k = 0; k < 3; ++k) g.c[c][k].d = cross_omega(g.c[c], k);
      return;
    }
    if (o.positions) load_vectors(o.positions, group, velocity);
    rotate(w, velocity, rotated);
    for (int k = 0; k < 3; ++k) offset[k].d = velocity[k], g.t[k].d = rotated[k];
    if (!o.shape) return;
    V columns[3 * COLUMNS];
    gather<3 * COLUMNS>(o.shape, group.index, columns);
    for (int c = 0; c < COLUMNS; ++c) {
      rotate(w, columns + 3 * c, rotated);
      for (int k = 0; k < 3; ++k) g.c[c][k].d = rotated[k];
    }
  }

  // Writes the rows of a group. With alpha = 2^(l - A dx^2 - B dx dy - C dy^2), VX and VY come from the motion of the
  // centre, VXX, VXY and VYY from that of the conic; all times ln 2.
  template <int COLUMNS, template <class> class Camera>
  void write_rows(const LaneGroup& group, const Geometry<Dual, COLUMNS, Camera>& g, Dual* color) const {
    if (o.colors) {
      V recolored[3];
      gather<3>(o.colors, group.index, recolored);
      for (int k = 0; k < 3; ++k) color[k].d += recolored[k];
    }
    const Dual a = 0.5f * LOG2_E * g.conic[0], b = LOG2_E * g.conic[1], c = 0.5f * LOG2_E * g.conic[2];
    constexpr float LN_2 = 0.69314718f;
    const V dx = g.point[0].d, dy = g.point[1].d;
    V row[16];
    row[VX] = LN_2 * (2.0f * a.v * dx + b.v * dy), row[VY] = LN_2 * (b.v * dx + 2.0f * c.v * dy);
    row[VXX] = -LN_2 * a.d, row[VXY] = -LN_2 * b.d, row[VYY] = -LN_2 * c.d;
    V sum = row[VX] + row[VY] + row[VXX] + row[VXY] + row[VYY];
    for (int k = 0; k < 3; ++k) {
      row[VRED + k] = keep(color[k].v > 0.0f, color[k].d);
      sum += row[VRED + k];
    }
    const VI good = finite(sum);
    for (int k = 0; k < 8; ++k) row[k] = keep(good, row[k]);
    scatter<8>(o.rows + 8 * group.k0, group.count, row);
  }
};

// Splats of a chunk: rows, boxes of tiles, sort keys, visibility, and velocities where they are wanted.
struct ProjectionKernel {
  const Scene& s;
  const ProjectChunk& o;

  // Tile of a coordinate, clamped to the image.
  VI tile_of(V v, std::uint32_t tiles) const {
    return __builtin_convertvector(min(max(v * TILES_PER_PX, V{}), broadcast(static_cast<float>(tiles) - 1.0f)), VI);
  }

  // Conservative bounds by which groups out of view are skipped before anything else is computed.
  struct SkipBounds {
    float root;        // reach of a splat of opacity 1 in standard deviations, plus a thousandth
    float base_error;  // error of heights above the near plane (mm), apart from what large coordinates add
    // The field of view of a pinhole lies between two planes through the eye for each axis of the image. Beyond these
    // a splat with the largest standard deviation s reaches no further than by_size s + by_error times the error of
    // its centre.
    float sides[2][2][3], by_size[2], by_error[2];

    explicit SkipBounds(const View& w) {
      root = __builtin_sqrtf(2.0f / LOG2_E * REACH) * 1.001f;
      base_error = 1e-3f * w.near;
      for (float v : w.eye) base_error += 1e-6f * __builtin_fabsf(v);
      const float margin = root * __builtin_sqrtf(w.dilation) + 1e-2f;
      for (int k = 0; k < 2; ++k) {
        const float low = w.center[k] + margin, high = w.center[k] - w.size[k] - margin;
        for (int c = 0; c < 3; ++c) {
          sides[k][0][c] = -(w.focal[k] * w.rotation[3 * k + c] + low * w.rotation[6 + c]);
          sides[k][1][c] = w.focal[k] * w.rotation[3 * k + c] + high * w.rotation[6 + c];
        }
        by_size[k] = root * w.focal[k] * (1.0f + __builtin_fmaxf(-w.low[k], w.high[k]));
        by_error[k] = w.focal[k] + w.size[k] + margin;
      }
    }
  };

  // Dot product.
  static V along(const float* axis, const V* v) {
    return fma(broadcast(axis[2]), v[2], fma(broadcast(axis[1]), v[1], broadcast(axis[0]) * v[0]));
  }

  // Splats that surely lie beside the image, before their covariance is known. With s the largest standard deviation,
  // half a box of a pinhole is at most root (f / z sqrt(1 + bound^2) s + sqrt(dilation)): times z, that is linear in
  // the centre, which is known to `error`. For a fisheye the distance from the cone of its field of view is tested
  // (`cone` in src/splat/plain/exact_camera.rs).
  template <int COLUMNS>
  VI surely_beside(const LaneGroup& group, const V* offset, V height, V error, const SkipBounds& bounds) const {
    const View& w = s.view;
    V size;
    if (COLUMNS == 2) {
      V axes[6], sum{};
      gather<6>(s.shape, group.index, axes);
      for (const V& v : axes) sum += v * v;
      size = square_root(sum);
    } else {
      V scales[3];
      load_vectors(s.scales, group, scales);
      for (V& v : scales) v = absolute(v);
      size = max(max(scales[0], scales[1]), scales[2]);
    }
    if (w.fisheye) {
      const V x = rotated_component(w, offset, 0), y = rotated_component(w, offset, 1);
      return w.cone_cosine * square_root(x * x + y * y) - w.cone_sine * height - bounds.root * w.cone_reach * size -
                 2.0f * error >
             0.0f;
    }
    VI out{};
    for (int k = 0; k < 2; ++k) {
      const V spread = fma(broadcast(bounds.by_size[k]), size, bounds.by_error[k] * error);
      out |= max(along(bounds.sides[k][0], offset), along(bounds.sides[k][1], offset)) > spread;
    }
    return out;
  }

  // The first group from k0 on that is not surely behind or beside the image. A short loop of its own for groups out
  // of sight costs two thirds of leaving the long one of `run` early, which begins by saving registers and making
  // room for 8 KB.
  template <int COLUMNS>
  std::size_t next_group(std::size_t k0, const SkipBounds& bounds) const {
    const View& w = s.view;
    for (; k0 < o.count; k0 += LANES) {
      LaneGroup group(s, o.first, k0, o.count);
      if (!group.contiguous) group.fill_index(s);
      V position[3], offset[3];
      load_centers(s, group, position, offset);
      const V far = absolute(position[0]) + absolute(position[1]) + absolute(position[2]),
              height = along(w.rotation + 6, offset);
      const V error = fma(broadcast(1e-6f), far, broadcast(bounds.base_error));
      const VI visible = height + error >= w.near;
      if (!any_of(visible)) continue;
      if (!w.skip_beside || any_of(load_scalars(s.opacities, group) > 1.0f)) break;
      if (COLUMNS == 2 && group.contiguous) group.fill_index(s);
      if (any_of(visible & ~surely_beside<COLUMNS>(group, offset, height, error, bounds))) break;
    }
    return k0;
  }

  template <int COLUMNS, template <class> class Camera>
  void run() const {
    if constexpr (WITH_DIRECTIONS) {
      if (o.motion) return run_as<Dual, COLUMNS, Camera>();
    }
    run_as<V, COLUMNS, Camera>();
  }

  // For values (N = V), or for values and velocities (N = Dual), with the same operations on the values.
  template <class N, int COLUMNS, template <class> class Camera>
  void run_as() const {
    constexpr bool MOVING = sizeof(N) == sizeof(Dual);
    const View& w = s.view;
    __builtin_memset(o.visible, 0, o.count);
    const SkipBounds bounds(w);
    for (std::size_t from = next_group<COLUMNS>(0, bounds); from < o.count;
         from = next_group<COLUMNS>(from + LANES, bounds)) {
      LaneGroup group(s, o.first, from, o.count);
      group.fill_index(s);
      const std::size_t k0 = group.k0;
      const int count = group.count;
      const std::uint32_t* const index = group.index;
      V position[3], offset[3];
      load_centers(s, group, position, offset);
      const V opacity = load_scalars(s.opacities, group);
      prefetch_next_group<COLUMNS>(s, group);
      prefetch_after<1>(o.rows, k0, 16);
      if (MOVING) {
        prefetch_after<1>(o.motion->rows, k0, 8);
        if (group.contiguous && o.motion->positions) prefetch_after(o.motion->positions, group.from, 3);
      }
      // Below 1/255 an opacity is never blended; the other two conditions keep NaN and denormals out of the logarithm.
      V log2_opacity = log2(opacity);
      VI visible = (log2_opacity + REACH > 0.0f) & finite(opacity) & (opacity > 1e-3f);
      if (!any_of(visible)) continue;
      // Centre, then covariance on screen.
      V t[3], point[2], rest[2];
      project_exactly<Camera>(s, position, t, point, rest);
      visible &= t[2] >= w.near;
      Shape<COLUMNS> shape;
      shape.load(s, index);
      Geometry<N, COLUMNS, Camera> g;
      N away[3];
      g.set_constant(w, t, shape.m);
      for (int k = 0; k < 3; ++k) constant(offset[k], &away[k]);
      if constexpr (MOVING) VelocityKernel{s, *o.motion}.set_velocities(group, g, away);
      g.complete(w, away);
      // Compensation: o sqrt(det / det dilated).
      if (w.compensate) {
        log2_opacity += 0.5f * log2(value(g.plain_determinant) * value(g.inverse_determinant));
        visible &= log2_opacity + REACH > 0.0f;
      }
      // Half sizes of the box of alpha >= 1/255: sqrt(2 ln(255 o) times the variance along the axis).
      const V scale = 2.0f / LOG2_E * (w.by_opacity * log2_opacity + REACH);
      const V half[2] = {square_root(scale * value(g.covariance[0])), square_root(scale * value(g.covariance[2]))};
      visible &= g.good;
      for (int k = 0; k < 2; ++k) visible &= (point[k] + half[k] > 0.0f) & (point[k] - half[k] < w.size[k]);
      if (!any_of(visible)) continue;
      // Colour.
      N color[3];
      color_towards(s, index, g.direction, color);
      visible &= finite(value(color[0]) + value(color[1]) + value(color[2]));
      if constexpr (MOVING) VelocityKernel{s, *o.motion}.write_rows(group, g, color);
      // The row (`at` in src/splat/types/table.rs).
      V row[16];
      row[X] = point[0], row[Y] = point[1];
      row[A] = 0.5f * LOG2_E * value(g.conic[0]), row[B] = LOG2_E * value(g.conic[1]),
      row[C] = 0.5f * LOG2_E * value(g.conic[2]);
      row[LOG2_OPACITY] = log2_opacity;
      for (int k = 0; k < 3; ++k) row[RED + k] = max(value(color[k]), V{});
      row[DEPTH] = t[2];
      row[HALF_WIDTH] = half[0], row[HALF_HEIGHT] = half[1];
      row[DISCRIMINANT] = -LOG2_E * LOG2_E * value(g.inverse_determinant);
      row[WIDEST] = -0.5f * row[B] * half[0] / row[C];
      row[X_REST] = rest[0], row[Y_REST] = rest[1];
      scatter<16>(o.rows + 16 * k0, count, row);
      const VI key = (VI)t[2];
      // Tiles of the pixel centres that the box holds, with the slack of the masks (lists.h).
      const V inside = 0.499f - 1e-5f * (half[0] + half[1]);
      const std::uint32_t tiles[2] = {o.tiles_x, o.tiles_y};
      VI low{}, high{};
      for (int k = 0; k < 2; ++k) {
        const V from = point[k] - half[k] + inside, to = point[k] + half[k] - inside;
        low |= tile_of(from, tiles[k]) << 16 * k, high |= tile_of(max(from, to), tiles[k]) << 16 * k;
      }
      for (int l = 0; l < count; ++l) {
        o.boxes[2 * (k0 + l)] = static_cast<std::uint32_t>(low[l]);
        o.boxes[2 * (k0 + l) + 1] = static_cast<std::uint32_t>(high[l]);
        o.keys[k0 + l] = static_cast<std::uint32_t>(key[l]);
        o.visible[k0 + l] = visible[l] != 0;
      }
    }
  }
};

// The colours of splats whose geometry stays, with the operations of `ProjectionKernel`.
struct RecolorKernel {
  const Scene& s;
  const RecolorChunk& o;

  // Returns false when a visible colour is not finite.
  bool run() const {
    bool finite_colors = true;
    for_groups(s, o.first, o.count, [&](const LaneGroup& group) {
      const std::size_t k0 = group.k0;
      const int count = group.count;
      const std::uint32_t* const index = group.index;
      VI visible{};
      for (int l = 0; l < count; ++l) visible[l] = o.visible[k0 + l] ? -1 : 0;
      if (!any_of(visible)) return;
      V position[3], offset[3], direction[3], distance, color[3];
      load_centers(s, group, position, offset);
      normalize_vector(offset, direction, distance);
      color_towards(s, index, direction, color);
      if (any_of(visible & ~finite(color[0] + color[1] + color[2]))) finite_colors = false;
      for (int k = 0; k < 3; ++k) color[k] = max(color[k], V{});
      for (int l = 0; l < count; ++l)
        if (visible[l])
          for (int k = 0; k < 3; ++k) o.rows[16 * (k0 + l) + RED + k] = color[k][l];
    });
    return finite_colors;
  }
};

}  // namespace

void project(const Scene& scene, const ProjectChunk& chunk) {
  const ProjectionKernel f{scene, chunk};
  for_scene(scene, f);
}

bool recolor(const Scene& scene, const RecolorChunk& chunk) { return RecolorKernel{scene, chunk}.run(); }

void velocities(const Scene& scene, const TangentChunk& chunk) {
  const VelocityKernel f{scene, chunk};
  for_scene(scene, f);
}

}  // namespace RESPIRE_ISA
}  // namespace respire
