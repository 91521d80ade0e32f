// From Gaussians to splats, LANES at a time; compiled once per instruction set. The plain twin is src/splat/project.rs.
#include "cpp/splat/project.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

// Centres in camera axes and on screen, computed in double and rounded once: the order of splats and their places belong
// to the scene, not to rounding. `rest`: what rounding takes from the places on screen.
template <template <class> class Camera>
inline void place(const Scene& s, const V* position, V* t, V* point, V* rest) {
  const double *r = s.exact.rotation, *eye = s.exact.eye;
  float in[3][LANES], out[7][LANES];
  for (int k = 0; k < 3; ++k) store(in[k], position[k]);
  for (int half = 0; half < 2; ++half) {
    VD d[3], seen[5];
    for (int k = 0; k < 3; ++k) {
      VH v;
      __builtin_memcpy(&v, in[k] + LANES / 2 * half, sizeof v);
      d[k] = __builtin_convertvector(v, VD) - eye[k];
    }
    for (int k = 0; k < 3; ++k) seen[k] = r[3 * k] * d[0] + r[3 * k + 1] * d[1] + r[3 * k + 2] * d[2];
    Camera<V>::exact(s.exact, seen, seen + 3);
    for (int k = 0; k < 5; ++k) {
      const VH rounded = __builtin_convertvector(seen[k], VH);
      __builtin_memcpy(out[k] + LANES / 2 * half, &rounded, sizeof rounded);
      if (k < 3) continue;
      const VH left = __builtin_convertvector(seen[k] - __builtin_convertvector(rounded, VD), VH);
      __builtin_memcpy(out[k + 2] + LANES / 2 * half, &left, sizeof left);
    }
  }
  for (int k = 0; k < 3; ++k) t[k] = load(out[k]);
  for (int k = 0; k < 2; ++k) point[k] = load(out[3 + k]), rest[k] = load(out[5 + k]);
}

// The splats' velocities along one direction. A velocity that is not finite is none.
struct Velocity {
  const Scene& s;
  const TangentChunk& o;

  template <int DEGREE, int COLUMNS, template <class> class Camera>
  void run() const {
    constexpr int SH = 3 * (DEGREE + 1) * (DEGREE + 1);
    const View& w = s.view;
    for_groups(s, o.first, o.count, [&](const Group& group) {
      const std::size_t k0 = group.k0;
      const int count = group.count;
      const std::uint32_t* const index = group.index;
      bool seen = false;
      for (int l = 0; l < count; ++l) seen |= o.visible[k0 + l];
      if (!seen) return;
      ask_for_next<SH, COLUMNS>(s, group);
      if (group.in_a_row && o.positions) ask<3>(o.positions, group.from);
      ask<8, 1>(o.rows, k0);
      V position[3], from_eye[3], t[3], point[2], rest[2], sh[SH];
      centers(s, group, position, from_eye);
      // As where they are projected: the same bytes.
      place<Camera>(s, position, t, point, rest);
      Shape<COLUMNS> shape;
      shape.load(s, index);
      Dual away[3], color[3];
      Geometry<Dual, COLUMNS, Camera> g;
      g.place(w, t, shape.m);
      for (int k = 0; k < 3; ++k) constant(from_eye[k], &away[k]);
      move(group, g, away);
      g.complete(w, away);
      gather<SH>(s.sh, index, sh);
      shown<Dual, DEGREE>(g.direction, sh, color);
      write(group, g, color);
    });
  }

  // Sets a group at rest moving; `offset` is its vector from the eye.
  template <int COLUMNS, template <class> class Camera>
  void move(const Group& group, Geometry<Dual, COLUMNS, Camera>& g, Dual* offset) const {
    const View& w = s.view;
    V velocity[3] = {V{}, V{}, V{}}, turned[3];
    if (o.pose) {
      const float *omega = o.pose, *tau = o.pose + 3;
      auto turning = [&](const Dual* v, int k) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        return omega[a] * v[b].v - omega[b] * v[a].v;
      };
      // Turning leaves the eye where it is.
      for (int k = 0; k < 3; ++k) velocity[k] = all(tau[k]);
      turn_back(w, velocity, turned);
      for (int k = 0; k < 3; ++k) offset[k].d = turned[k], g.t[k].d = turning(g.t, k) + tau[k];
      for (int c = 0; c < COLUMNS; ++c)
        for (int k = 0; k < 3; ++k) g.c[c][k].d = turning(g.c[c], k);
      return;
    }
    if (o.positions) threes(o.positions, group, velocity);
    turn(w, velocity, turned);
    for (int k = 0; k < 3; ++k) offset[k].d = velocity[k], g.t[k].d = turned[k];
    if (!o.shape) return;
    V columns[3 * COLUMNS];
    gather<3 * COLUMNS>(o.shape, group.index, columns);
    for (int c = 0; c < COLUMNS; ++c) {
      turn(w, columns + 3 * c, turned);
      for (int k = 0; k < 3; ++k) g.c[c][k].d = turned[k];
    }
  }

  // The rows of a group.
  template <int COLUMNS, template <class> class Camera>
  void write(const Group& group, const Geometry<Dual, COLUMNS, Camera>& g, Dual* color) const {
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

struct Projection {
  const Scene& s;
  const ProjectChunk& o;

  // Tile of a coordinate, clamped to the image.
  VI cell(V v, std::uint32_t tiles) const {
    return __builtin_convertvector(smaller(larger(v * TILES_PER_PX, V{}), all(static_cast<float>(tiles) - 1.0f)), VI);
  }

  // What keeps a look at a group on the safe side.
  struct Room {
    float root;       // of what standard deviations are multiplied with, for the reach of a splat whose opacity is no more than 1
    float uncertain;  // of heights above the near plane, apart from what large coordinates add
    // A pinhole sees what lies between two planes for each axis of the image, through the eye; outwards from these a splat with the
    // largest standard deviation s reaches no further than by_size s + by_error times the uncertainty of its centre.
    float sides[2][2][3], by_size[2], by_error[2];

    explicit Room(const View& w) {
      root = __builtin_sqrtf(2.0f / LOG2_E * REACH) * 1.001f;
      uncertain = 1e-3f * w.near;
      for (float v : w.eye) uncertain += 1e-6f * __builtin_fabsf(v);
      const float margin = root * __builtin_sqrtf(w.dilation) + 1e-2f;
      for (int k = 0; k < 2; ++k) {
        const float low = w.center[k] + margin, high = w.center[k] - w.size[k] - margin;
        for (int c = 0; c < 3; ++c) {
          sides[k][0][c] = -(w.focal[k] * w.rotation[3 * k + c] + low * w.rotation[6 + c]);
          sides[k][1][c] = w.focal[k] * w.rotation[3 * k + c] + high * w.rotation[6 + c];
        }
        by_size[k] = root * w.focal[k] * (1.0f + w.limit[k]);
        by_error[k] = w.focal[k] + w.size[k] + margin;
      }
    }
  };

  static V along(const float* axis, const V* v) { return fma(all(axis[2]), v[2], fma(all(axis[1]), v[1], all(axis[0]) * v[0])); }

  // Splats that lie beside the image for sure, before their covariance is known. With s the largest standard deviation,
  // half a box of a pinhole is at most sqrt(scale) (f / z sqrt(1 + limit^2) s + sqrt(dilation)): times z, that is linear in
  // the centre, which is known to `error`.
  // A fisheye sees a cone, and its splats are known by their distance from that (`Exact::cone` in src/splat/lens.rs).
  template <int COLUMNS>
  VI beside(const Group& group, const V* offset, V height, V error, const Room& room) const {
    const View& w = s.view;
    V size;
    if (COLUMNS == 2) {
      V axes[6], sum{};
      gather<6>(s.shape, group.index, axes);
      for (const V& v : axes) sum += v * v;
      size = square_root(sum);
    } else {
      V scales[3];
      threes(s.scales, group, scales);
      for (V& v : scales) v = absolute(v);
      size = larger(larger(scales[0], scales[1]), scales[2]);
    }
    if (w.fisheye) {
      const V x = turned(w, offset, 0), y = turned(w, offset, 1);
      return w.cone_cosine * square_root(x * x + y * y) - w.cone_sine * height - room.root * w.cone_reach * size - 2.0f * error > 0.0f;
    }
    VI out{};
    for (int k = 0; k < 2; ++k) {
      const V spread = fma(all(room.by_size[k]), size, room.by_error[k] * error);
      out |= larger(along(room.sides[k][0], offset), along(room.sides[k][1], offset)) > spread;
    }
    return out;
  }

  // The first group from k0 on that is not behind or beside for sure. For what is out of sight, a short loop of its own costs two thirds
  // of leaving the long one of `run` early, which begins by saving registers and making room for 8 KB.
  template <int COLUMNS>
  std::size_t next(std::size_t k0, const Room& room) const {
    const View& w = s.view;
    for (; k0 < o.count; k0 += LANES) {
      Group group(s, o.first, k0, o.count);
      if (!group.in_a_row) group.name(s);
      V position[3], offset[3];
      centers(s, group, position, offset);
      const V far = absolute(position[0]) + absolute(position[1]) + absolute(position[2]), height = along(w.rotation + 6, offset);
      const V error = fma(all(1e-6f), far, all(room.uncertain));
      const VI seen = height + error >= w.near;
      if (!any_of(seen)) continue;
      if (!w.skip_beside || any_of(ones(s.opacities, group) > 1.0f)) break;
      if (COLUMNS == 2 && group.in_a_row) group.name(s);
      if (any_of(seen & ~beside<COLUMNS>(group, offset, height, error, room))) break;
    }
    return k0;
  }

  template <int DEGREE, int COLUMNS, template <class> class Camera>
  void run() const {
    o.motion ? run_as<Dual, DEGREE, COLUMNS, Camera>() : run_as<V, DEGREE, COLUMNS, Camera>();
  }

  // For values, or for these and their velocities, which are the same operations on the values.
  template <class N, int DEGREE, int COLUMNS, template <class> class Camera>
  void run_as() const {
    constexpr int SH = 3 * (DEGREE + 1) * (DEGREE + 1);
    constexpr bool MOVING = sizeof(N) == sizeof(Dual);
    const View& w = s.view;
    __builtin_memset(o.visible, 0, o.count);
    const Room room(w);
    for (std::size_t from = next<COLUMNS>(0, room); from < o.count; from = next<COLUMNS>(from + LANES, room)) {
      Group group(s, o.first, from, o.count);
      group.name(s);
      const std::size_t k0 = group.k0;
      const int count = group.count;
      const std::uint32_t* const index = group.index;
      V position[3], offset[3];
      centers(s, group, position, offset);
      const V opacity = ones(s.opacities, group);
      ask_for_next<SH, COLUMNS>(s, group);
      ask<16, 1>(o.rows, k0);
      if (MOVING) {
        ask<8, 1>(o.motion->rows, k0);
        if (group.in_a_row && o.motion->positions) ask<3>(o.motion->positions, group.from);
      }
      V log2_opacity = log2(opacity);
      VI seen = (log2_opacity + REACH > 0.0f) & finite(opacity) & (opacity > 1e-3f);
      if (!any_of(seen)) continue;
      V t[3], point[2], rest[2];
      place<Camera>(s, position, t, point, rest);
      seen &= t[2] >= w.near;
      Shape<COLUMNS> shape;
      shape.load(s, index);
      Geometry<N, COLUMNS, Camera> g;
      N away[3];
      g.place(w, t, shape.m);
      for (int k = 0; k < 3; ++k) constant(offset[k], &away[k]);
      if constexpr (MOVING) Velocity{s, *o.motion}.move(group, g, away);
      g.complete(w, away);
      if (w.compensate) {
        log2_opacity += 0.5f * log2(value(g.plain_determinant) * value(g.inverse_determinant));
        seen &= log2_opacity + REACH > 0.0f;
      }
      const V scale = 2.0f / LOG2_E * (w.by_opacity * log2_opacity + REACH);
      const V half[2] = {square_root(scale * value(g.covariance[0])), square_root(scale * value(g.covariance[2]))};
      seen &= g.good;
      for (int k = 0; k < 2; ++k) seen &= (point[k] + half[k] > 0.0f) & (point[k] - half[k] < w.size[k]);
      if (!any_of(seen)) continue;
      V sh[SH];
      N color[3];
      gather<SH>(s.sh, index, sh);
      shown<N, DEGREE>(g.direction, sh, color);
      seen &= finite(value(color[0]) + value(color[1]) + value(color[2]));
      if constexpr (MOVING) Velocity{s, *o.motion}.write(group, g, color);
      V row[16];
      row[X] = point[0], row[Y] = point[1];
      row[A] = 0.5f * LOG2_E * value(g.conic[0]), row[B] = LOG2_E * value(g.conic[1]), row[C] = 0.5f * LOG2_E * value(g.conic[2]);
      row[LOG2_OPACITY] = log2_opacity;
      for (int k = 0; k < 3; ++k) row[RED + k] = larger(value(color[k]), V{});
      row[DEPTH] = t[2];
      row[HALF_WIDTH] = half[0], row[HALF_HEIGHT] = half[1];
      row[DISCRIMINANT] = -LOG2_E * LOG2_E * value(g.inverse_determinant);
      row[WIDEST] = -0.5f * row[B] * half[0] / row[C];
      row[X_REST] = rest[0], row[Y_REST] = rest[1];
      scatter<16>(o.rows + 16 * k0, count, row);
      const VI key = (VI)t[2];
      // Tiles of the pixel centres that the box holds; the slack of the masks (splat_lists.h).
      const V inside = 0.499f - 1e-5f * (half[0] + half[1]);
      const std::uint32_t tiles[2] = {o.tiles_x, o.tiles_y};
      VI low{}, high{};
      for (int k = 0; k < 2; ++k) {
        const V from = point[k] - half[k] + inside, to = point[k] + half[k] - inside;
        low |= cell(from, tiles[k]) << 16 * k, high |= cell(larger(from, to), tiles[k]) << 16 * k;
      }
      for (int l = 0; l < count; ++l) {
        o.boxes[2 * (k0 + l)] = static_cast<std::uint32_t>(low[l]);
        o.boxes[2 * (k0 + l) + 1] = static_cast<std::uint32_t>(high[l]);
        o.keys[k0 + l] = static_cast<std::uint32_t>(key[l]);
        o.visible[k0 + l] = seen[l] != 0;
      }
    }
  }
};

// The colours of splats whose geometry stays: the operations of `Projection`.
struct Recoloring {
  const Scene& s;
  const RecolorChunk& o;
  bool finite_colors = true;

  template <int DEGREE, int COLUMNS, template <class> class Camera>
  void run() {
    constexpr int SH = 3 * (DEGREE + 1) * (DEGREE + 1);
    for_groups(s, o.first, o.count, [&](const Group& group) {
      const std::size_t k0 = group.k0;
      const int count = group.count;
      const std::uint32_t* const index = group.index;
      VI seen{};
      for (int l = 0; l < count; ++l) seen[l] = o.visible[k0 + l] ? -1 : 0;
      if (!any_of(seen)) return;
      V position[3], offset[3], direction[3], distance, sh[SH], color[3];
      centers(s, group, position, offset);
      aim(offset, direction, distance);
      gather<SH>(s.sh, index, sh);
      shown<V, DEGREE>(direction, sh, color);
      if (any_of(seen & ~finite(color[0] + color[1] + color[2]))) finite_colors = false;
      for (int k = 0; k < 3; ++k) color[k] = larger(color[k], V{});
      for (int l = 0; l < count; ++l)
        if (seen[l])
          for (int k = 0; k < 3; ++k) o.rows[16 * (k0 + l) + RED + k] = color[k][l];
    });
  }
};

}  // namespace

void project(const Scene& scene, const ProjectChunk& chunk) {
  const Projection f{scene, chunk};
  for_scene(scene, f);
}

bool recolor(const Scene& scene, const RecolorChunk& chunk) {
  Recoloring f{scene, chunk};
  for_scene(scene, f);
  return f.finite_colors;
}

void velocities(const Scene& scene, const TangentChunk& chunk) {
  const Velocity f{scene, chunk};
  for_scene(scene, f);
}

}  // namespace RESPIRE_ISA
}  // namespace respire
