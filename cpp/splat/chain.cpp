// From the moments of splats to the gradients of Gaussians and camera, LANES at a time: the reverse of project.cpp,
// with its symbols. Compiled once per instruction set; the plain twin, which derives the equations, is
// src/splat/plain/chain.rs.
#include "cpp/splat/project.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

// Gradient of the sum of w[k] times COUNT functions by the vector v, as if its length were free.
template <int COUNT>
inline void basis_pullback(const V* v, const V* w, V* g) {
  const V x = v[0], y = v[1], z = v[2];
  g[0] = -C1 * w[3], g[1] = -C1 * w[1], g[2] = C1 * w[2];
  if constexpr (COUNT >= 9) {
    g[0] += C2[0] * y * w[4] - 2.0f * C2[2] * x * w[6] + C2[3] * z * w[7] + 2.0f * C2[4] * x * w[8];
    g[1] += C2[0] * x * w[4] + C2[1] * z * w[5] - 2.0f * C2[2] * y * w[6] - 2.0f * C2[4] * y * w[8];
    g[2] += C2[1] * y * w[5] + 4.0f * C2[2] * z * w[6] + C2[3] * x * w[7];
  }
  if constexpr (COUNT >= 16) {
    const V xx = x * x, yy = y * y, zz = z * z, four_zz = 4.0f * zz;
    g[0] += C3[0] * 6.0f * x * y * w[9] + C3[1] * y * z * w[10] - C3[2] * 2.0f * x * y * w[11] -
            C3[3] * 6.0f * x * z * w[12] + C3[4] * (four_zz - 3.0f * xx - yy) * w[13] + C3[5] * 2.0f * x * z * w[14] +
            C3[6] * 3.0f * (xx - yy) * w[15];
    g[1] += C3[0] * 3.0f * (xx - yy) * w[9] + C3[1] * x * z * w[10] + C3[2] * (four_zz - xx - 3.0f * yy) * w[11] -
            C3[3] * 6.0f * y * z * w[12] - C3[4] * 2.0f * x * y * w[13] - C3[5] * 2.0f * y * z * w[14] -
            C3[6] * 6.0f * x * y * w[15];
    g[2] += C3[1] * x * y * w[10] + C3[2] * 8.0f * y * z * w[11] + C3[3] * (6.0f * zz - 3.0f * xx - 3.0f * yy) * w[12] +
            C3[4] * 8.0f * x * z * w[13] + C3[5] * (xx - yy) * w[14];
  }
}

inline V dot(const V* a, const V* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// The gradient by the colours before the clamp, `by_color`, from that after it; by the vector from the eye; and the
// functions of the direction, by which that of the coefficients follows.
[[gnu::noinline]] void color_pullback(const Scene& s, const std::uint32_t* index, const V* direction, V distance,
                                      const V* by_clamped, V* functions, V* by_color, V* by_offset) {
  for_degree(s, [&](auto degree) {
    constexpr int BASIS = degree.BASIS;
    V sh[degree.SH], color[3];
    gather<degree.SH>(s.sh, index, sh);
    basis<V, BASIS>(direction, functions);
    sum_color<V, BASIS>(functions, sh, color);
    for (int k = 0; k < 3; ++k) by_color[k] = keep(color[k] > 0.0f, by_clamped[k]);
    if constexpr (BASIS > 1) {
      V weights[BASIS], by_direction[3];
      for (int i = 0; i < BASIS; ++i) weights[i] = dot(sh + 3 * i, by_color);
      basis_pullback<BASIS>(direction, weights, by_direction);
      // Through the normalisation of the direction.
      const V along = dot(by_direction, direction), by_distance = 1.0f / distance;
      for (int k = 0; k < 3; ++k) by_offset[k] = (by_direction[k] - along * direction[k]) * by_distance;
    }
  });
}

// Writes the gradients by the coefficients of `count` Gaussians from number k0 on.
[[gnu::noinline]] void write_harmonics(const Scene& s, float* base, std::size_t k0, int count, VI good,
                                       const V* functions, const V* by_color) {
  for_degree(s, [&](auto degree) {
    V by_sh[degree.SH];
    for (int i = 0; i < degree.SH; ++i) by_sh[i] = keep(good, functions[i / 3] * by_color[i % 3]);
    scatter<degree.SH>(base + degree.SH * k0, count, by_sh);
  });
}

// Adds to by_u the gradient through the factor sqrt(det / det dilated) of the opacity; by_log is that by its
// logarithm. det is the sum of the squared cross products of the u.
template <class G, int COLUMNS>
inline void compensation_pullback(const G& g, V by_log, V by_u[COLUMNS][2]) {
  const V over = 1.0f / g.plain_determinant;
  for (int k = 0; k < COLUMNS; ++k) {
    const V x = g.u[k][0], y = g.u[k][1];
    V dx = -(g.conic[0] * x + g.conic[1] * y), dy = -(g.conic[1] * x + g.conic[2] * y);
    for (int other = 0; other < COLUMNS; ++other) {
      if (other == k) continue;
      const V cross = (x * g.u[other][1] - y * g.u[other][0]) * over;
      dx += cross * g.u[other][1], dy -= cross * g.u[other][0];
    }
    by_u[k][0] += by_log * dx, by_u[k][1] += by_log * dy;
  }
}

inline double total(const D4& v) { return (v[0] + v[2]) + (v[1] + v[3]); }

// How many slots ahead of the sum slots are prefetched.
constexpr int AHEAD = 48;

struct ChainKernel {
  const Scene& s;
  const ChainChunk& o;

  bool wants(std::uint32_t groups) const { return (o.wanted & groups) != 0; }

  // Sums of the slots of LANES splats, field by field. Splats that are not visible have no slots.
  void sum_slots(std::size_t k0, int count, V* m) const {
    alignas(64) float sums[LANES][16];
    for (int l = 0; l < LANES; ++l) {
      V total[PARTS];
      for (V& v : total) v = V{};
      if (l < count) {
        for (std::uint32_t e = o.starts[k0 + l]; e < o.starts[k0 + l + 1]; ++e) {
          if (!o.live[e]) continue;
          const float* slot = o.slots + 16 * static_cast<std::size_t>(e);
          __builtin_prefetch(slot + 16 * AHEAD);
          for (int p = 0; p < PARTS; ++p) total[p] += load(slot + LANES * p);
        }
      }
      for (int p = 0; p < PARTS; ++p) store(sums[l] + LANES * p, total[p]);
    }
    std::uint32_t lane[LANES];
    for (int l = 0; l < LANES; ++l) lane[l] = static_cast<std::uint32_t>(l);
    gather<16>(&sums[0][0], lane, m);
  }

  static bool any_live(const bool* from, const bool* to) {
    bool any = false;
    for (; from < to; ++from) any |= *from;
    return any;
  }

  template <int N>
  void write(float* base, std::size_t k0, int count, VI good, V* values) const {
    for (int k = 0; k < N; ++k) values[k] = keep(good, values[k]);
    scatter<N>(base + N * k0, count, values);
  }

  // Of `each` numbers a Gaussian.
  void clear(float* base, std::size_t k0, int count, int each) const {
    __builtin_memset(base + each * k0, 0, sizeof *base * static_cast<std::size_t>(each * count));
  }

  template <int COLUMNS, template <class> class Camera>
  void run() const {
    const View& w = s.view;
    const int harmonics = harmonics_of(s);
    const bool through_position = wants(POSITIONS | POSE | LENS), shapes = wants(SHAPES);
    D4 pose_sums[6] = {}, lens_sums[4] = {};
    for_groups(s, o.first, o.count, [&](const LaneGroup& group) {
      const std::size_t k0 = group.k0;
      const int count = group.count;
      static_assert(GROUP % LANES == 0, "lanes of one group of vectors share a flag");
      auto clear_all = [&] {
        if (!o.written[k0 / GROUP]) return;
        if (wants(POSITIONS)) clear(o.positions, k0, count, 3);
        if (wants(OPACITIES)) clear(o.opacities, k0, count, 1);
        if (wants(HARMONICS)) clear(o.sh, k0, count, harmonics);
        if (shapes && COLUMNS == 2) clear(o.shape, k0, count, 6);
        if (shapes && COLUMNS == 3) clear(o.shape, k0, count, 4), clear(o.scales, k0, count, 3);
      };
      // Behind what is opaque no slot was written. Splats that are not visible have none.
      const bool* const live = o.live + o.starts[k0];
      if (!any_live(live, o.live + o.starts[k0 + count])) return clear_all();
      const std::uint32_t* const index = group.index;
      // Tables of a hundred thousand Gaussians fit into no near cache, and there are a dozen of them: too many
      // streams for the processor's own prefetcher.
      prefetch_next_group<COLUMNS>(s, group);
      if (wants(POSITIONS)) prefetch_after<1>(o.positions, k0, 3);
      if (wants(OPACITIES)) prefetch_after<1>(o.opacities, k0, 1);
      if (wants(HARMONICS)) prefetch_after<1>(o.sh, k0, harmonics);
      if (shapes) prefetch_after<1>(o.shape, k0, COLUMNS == 2 ? 6 : 4);
      if (shapes && COLUMNS == 3) prefetch_after<1>(o.scales, k0, 3);
      V m[16];
      sum_slots(k0, count, m);
      o.heard[k0 / GROUP] = true;
      VI visible;
      for (int l = 0; l < LANES; ++l) visible[l] = l < count && o.starts[k0 + l] != o.starts[k0 + l + 1] ? -1 : 0;
      // The projection again.
      V opacity[1], position[3], offset[3];
      gather<1>(s.opacities, index, opacity);
      load_centers(s, group, position, offset);
      Geometry<V, COLUMNS, Camera> g;
      rotate(w, offset, g.t);
      Shape<COLUMNS> shape;
      shape.load(s, index);
      for (int k = 0; k < COLUMNS; ++k) rotate(w, shape.m[k], g.c[k]);
      g.complete(w, offset);

      // Opacity: d log(alpha) / d o = 1 / o.
      V by_opacity[1] = {m[S] / opacity[0]};
      V sum = by_opacity[0] + m[SRED] + m[SGREEN] + m[SBLUE];
      // Colour: to the coefficients, and through the direction to the centre.
      V functions[16], by_color[3], by_offset[3] = {V{}, V{}, V{}};
      if (wants(HARMONICS) || (through_position && s.sh_degree > 0)) {
        color_pullback(s, index, g.direction, g.distance, m + SRED, functions, by_color, by_offset);
      }
      // Shape, centre, camera.
      V by_columns[3][3], by_position[3] = {V{}, V{}, V{}}, pose[6], lens[4];
      for (V& v : pose) v = V{};
      for (V& v : lens) v = V{};
      if (through_position || shapes) {
        // Gradient by the covariance, -Q G Q from the gradient G by the conic Q; then by the u, whose outer products
        // sum to the covariance.
        const V a = g.conic[0], b = g.conic[1], c = g.conic[2];
        const V ga = -0.5f * m[SXX], gb = -0.5f * m[SXY], gc = -0.5f * m[SYY];
        const V e0 = a * ga + b * gb, e1 = a * gb + b * gc, e2 = b * ga + c * gb, e3 = b * gb + c * gc;
        const V va = -(e0 * a + e1 * b), vb = -(e0 * b + e1 * c), vc = -(e2 * b + e3 * c);
        V by_u[COLUMNS][2], by_c[COLUMNS][3];
        for (int k = 0; k < COLUMNS; ++k) {
          by_u[k][0] = 2.0f * (va * g.u[k][0] + vb * g.u[k][1]);
          by_u[k][1] = 2.0f * (vb * g.u[k][0] + vc * g.u[k][1]);
        }
        if (w.compensate) compensation_pullback<Geometry<V, COLUMNS, Camera>, COLUMNS>(g, m[S], by_u);
        for (int k = 0; k < COLUMNS; ++k) g.camera.apply_transposed(w, by_u[k], by_c[k]);
        if (shapes) {
          for (int k = 0; k < COLUMNS; ++k) {
            rotate_back(w, by_c[k], by_columns[k]);
            sum += by_columns[k][0] + by_columns[k][1] + by_columns[k][2];
          }
        }
        // By t, through the image point and the Jacobian; by the pose (a turn omega: v' = omega x v) and the
        // intrinsics.
        if (through_position) {
          const V by_point[2] = {a * m[SX] + b * m[SY], b * m[SX] + c * m[SY]};
          V by_t[3];
          g.camera.template pullback<COLUMNS>(w, by_point, by_u, g.c, by_t);
          by_t[2] += m[SDEPTH];
          rotate_back(w, by_t, by_position);
          for (int k = 0; k < 3; ++k) {
            by_position[k] += by_offset[k];
            sum += by_position[k];
          }
          if (wants(POSE)) {
            V eye[3];
            rotate(w, by_offset, eye);
            auto add_turn = [&](const V* v, const V* by) {
              pose[0] += v[1] * by[2] - v[2] * by[1];
              pose[1] += v[2] * by[0] - v[0] * by[2];
              pose[2] += v[0] * by[1] - v[1] * by[0];
            };
            add_turn(g.t, by_t);
            for (int k = 0; k < COLUMNS; ++k) add_turn(g.c[k], by_c[k]);
            for (int k = 0; k < 3; ++k) pose[3 + k] = by_t[k] + eye[k];
            for (const V& v : pose) sum += v;
          }
          if (wants(LENS)) {
            for (int k = 0; k < 2; ++k) {
              // Image point and Jacobian are proportional to the focal length.
              V along =
                  (g.point[k] - w.center[k]) * by_point[k] - g.camera.template focal_independent<COLUMNS>(k, by_u, g.c);
              for (int c = 0; c < COLUMNS; ++c) along += by_u[c][k] * g.u[c][k];
              lens[k] = along / w.focal[k];
              lens[2 + k] = by_point[k] + g.camera.template by_center<COLUMNS>(k, by_u, g.c);
            }
            for (const V& v : lens) sum += v;
          }
        }
      }
      // A gradient that is not finite becomes 0, with all others of its Gaussian.
      const VI good = visible & g.good & finite(sum);
      if (wants(POSITIONS)) write<3>(o.positions, k0, count, good, by_position);
      if (wants(OPACITIES)) write<1>(o.opacities, k0, count, good, by_opacity);
      if (wants(HARMONICS)) write_harmonics(s, o.sh, k0, count, good, functions, by_color);
      if (shapes && COLUMNS == 2) write<6>(o.shape, k0, count, good, &by_columns[0][0]);
      if (shapes && COLUMNS == 3) write_ellipsoids(k0, count, good, shape, by_columns);
      if (wants(POSE)) {
        for (int k = 0; k < 6; ++k) add_in_double(pose_sums[k], keep(good, pose[k]));
      }
      if (wants(LENS)) {
        for (int k = 0; k < 4; ++k) add_in_double(lens_sums[k], keep(good, lens[k]));
      }
    });
    for (int k = 0; k < 6; ++k) o.pose[k] = total(pose_sums[k]);
    for (int k = 0; k < 4; ++k) o.intrinsics[k] = total(lens_sums[k]);
  }

  // From the columns R_c s_c of an ellipsoid to its scales and its quaternion, through the normalisation of the latter.
  template <int COLUMNS>
  void write_ellipsoids(std::size_t k0, int count, VI good, const Shape<COLUMNS>& shape,
                        const V by_columns[3][3]) const {
    V by_scale[3], r[3][3], by_q[4];
    for (int c = 0; c < 3; ++c) {
      by_scale[c] = dot(by_columns[c], shape.axes[c]);
      for (int k = 0; k < 3; ++k) r[c][k] = by_columns[c][k] * shape.scale[c];
    }
    const V w = shape.q[0], x = shape.q[1], y = shape.q[2], z = shape.q[3];
    by_q[0] = 2.0f * (z * (r[0][1] - r[1][0]) + y * (r[2][0] - r[0][2]) + x * (r[1][2] - r[2][1]));
    by_q[1] = 2.0f * (y * (r[1][0] + r[0][1]) + z * (r[2][0] + r[0][2]) - 2.0f * x * (r[1][1] + r[2][2]) +
                      w * (r[1][2] - r[2][1]));
    by_q[2] = 2.0f * (x * (r[1][0] + r[0][1]) + z * (r[2][1] + r[1][2]) - 2.0f * y * (r[0][0] + r[2][2]) +
                      w * (r[2][0] - r[0][2]));
    by_q[3] = 2.0f * (x * (r[2][0] + r[0][2]) + y * (r[2][1] + r[1][2]) - 2.0f * z * (r[0][0] + r[1][1]) +
                      w * (r[0][1] - r[1][0]));
    const V along = by_q[0] * w + by_q[1] * x + by_q[2] * y + by_q[3] * z;
    for (int k = 0; k < 4; ++k) by_q[k] = (by_q[k] - along * shape.q[k]) * shape.inverse_length;
    good &= finite(by_q[0] + by_q[1] + by_q[2] + by_q[3] + by_scale[0] + by_scale[1] + by_scale[2]);
    write<4>(o.shape, k0, count, good, by_q);
    write<3>(o.scales, k0, count, good, by_scale);
  }
};

}  // namespace

void chain(const Scene& scene, const ChainChunk& chunk) {
  const ChainKernel f{scene, chunk};
  for_scene(scene, f);
}

}  // namespace RESPIRE_ISA
}  // namespace respire
