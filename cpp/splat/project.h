#pragma once
// Projection of LANES Gaussians at once, after EWA splatting (Zwicker et al. 2001) as 3DGS does it, for values (V)
// and for values with a derivative (Dual). The plain twin, src/splat/plain/project.rs, also explains the symbols:
//
//   t = R (p - eye),  c_k = R m_k,  u_k = J c_k
//   covariance on screen = sum_k u_k u_k^T + dilation I,  conic = its inverse
#include "cpp/splat/camera.h"
#include "cpp/splat/color.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

constexpr float LOG2_E = 1.4426950408889634f;
constexpr float REACH = 7.994353436858858f;  // log2(255): how far an alpha of 1/255 lies below 1, in powers of 2

// One component of a vector in camera axes.
template <class N>
inline N rotated_component(const View& w, const N* v, int k) {
  return w.rotation[3 * k] * v[0] + w.rotation[3 * k + 1] * v[1] + w.rotation[3 * k + 2] * v[2];
}

// From world to camera axes, and back.
template <class N>
inline void rotate(const View& w, const N* v, N* out) {
  for (int k = 0; k < 3; ++k) out[k] = rotated_component(w, v, k);
}

template <class N>
inline void rotate_back(const View& w, const N* v, N* out) {
  for (int k = 0; k < 3; ++k) out[k] = w.rotation[k] * v[0] + w.rotation[3 + k] * v[1] + w.rotation[6 + k] * v[2];
}

// Divides quaternions by their length; returns 1 / length.
inline V normalize(V* q) {
  V squares = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  V scale = broadcast(1.0f);
  // Squares beyond single precision: of multiples by a power of two, which is exact.
  const VI small = (VI)(squares < broadcast(1e-30f)), large = (VI)(squares > broadcast(1e30f));
  if (any_of(small | large)) {
    scale = select(small, broadcast(0x1p100f), select(large, broadcast(0x1p-70f), scale));
    for (int k = 0; k < 4; ++k) q[k] *= scale;
    squares = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  }
  const V inverse = 1.0f / square_root(squares);
  for (int k = 0; k < 4; ++k) q[k] *= inverse;
  return inverse * scale;
}

// Columns of the rotation matrix of unit quaternions (w, x, y, z).
inline void rotation_columns(const V* q, V r[3][3]) {
  const V w = q[0], x = q[1], y = q[2], z = q[3];
  r[0][0] = 1.0f - 2.0f * (y * y + z * z), r[0][1] = 2.0f * (x * y + w * z), r[0][2] = 2.0f * (x * z - w * y);
  r[1][0] = 2.0f * (x * y - w * z), r[1][1] = 1.0f - 2.0f * (x * x + z * z), r[1][2] = 2.0f * (y * z + w * x);
  r[2][0] = 2.0f * (x * z + w * y), r[2][1] = 2.0f * (y * z - w * x), r[2][2] = 1.0f - 2.0f * (x * x + y * y);
}

// The square root of the covariance of LANES Gaussians, column by column (world axes); COLUMNS is 2 for discs, 3 for
// ellipsoids, whose rotation, scales and quaternions are kept for the backward pass.
template <int COLUMNS>
struct Shape {
  V m[3][3], axes[3][3], scale[3], q[4], inverse_length;
  void load(const Scene& s, const std::uint32_t* index) {
    if (COLUMNS == 2) {
      gather<6>(s.shape, index, &m[0][0]);
    } else {
      gather<4>(s.shape, index, q);
      gather<3>(s.scales, index, scale);
      inverse_length = normalize(q);
      rotation_columns(q, axes);
      for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 3; ++k) m[c][k] = axes[c][k] * scale[c];
    }
  }
};

// Unit vector along `offset`, and its length.
template <class N>
inline void normalize_vector(const N* offset, N* direction, N& distance) {
  distance = square_root(offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]);
  const N by_distance = reciprocal_of(distance);
  for (int k = 0; k < 3; ++k) direction[k] = offset[k] * by_distance;
}

// Everything about a splat but its colour.
template <class N, int COLUMNS, template <class> class Camera>
struct Geometry {
  N t[3], c[COLUMNS][3], u[COLUMNS][2];  // centre and columns in camera axes, columns on screen
  Camera<N> camera;
  N point[2], covariance[3], conic[3], inverse_determinant, plain_determinant;  // the last one before dilation
  N direction[3], distance;
  VI good;

  // Sets t and c, without a derivative, from the centre in camera axes and the columns of a shape in world axes.
  void set_constant(const View& w, const V* center, const V (*columns)[3]) {
    for (int k = 0; k < 3; ++k) constant(center[k], &t[k]);
    for (int i = 0; i < COLUMNS; ++i)
      for (int k = 0; k < 3; ++k) constant(rotated_component(w, columns[i], k), &c[i][k]);
  }

  // Computes the rest from t, c and the vector from the eye (world axes).
  void complete(const View& w, const N* offset) {
    camera.linearize(w, t, point);
    for (int k = 0; k < COLUMNS; ++k) camera.apply_jacobian(w, c[k], u[k]);
    // Covariance before dilation: xx, xy, yy.
    N plain[3];
    for (int k = 0; k < 3; ++k) {
      const int a = k / 2, b = (k + 1) / 2;
      plain[k] = u[0][a] * u[0][b] + u[1][a] * u[1][b];
      if (COLUMNS == 3) plain[k] = plain[k] + u[COLUMNS - 1][a] * u[COLUMNS - 1][b];
    }
    const float d = w.dilation;
    // Cauchy and Binet: the determinant as a sum of squares, so that thin splats keep their digits.
    N cross = u[0][0] * u[1][1] - u[0][1] * u[1][0];
    plain_determinant = cross * cross;
    N determinant = cross * cross + d * (plain[0] + plain[2]) + d * d;
    for (int k = 0; k < COLUMNS - 1 && COLUMNS == 3; ++k) {
      cross = u[k][0] * u[COLUMNS - 1][1] - u[k][1] * u[COLUMNS - 1][0];
      plain_determinant = plain_determinant + cross * cross;
      determinant = determinant + cross * cross;
    }
    covariance[0] = plain[0] + d, covariance[1] = plain[1], covariance[2] = plain[2] + d;
    inverse_determinant = reciprocal_of(determinant);
    conic[0] = covariance[2] * inverse_determinant;
    conic[1] = -(covariance[1] * inverse_determinant);
    conic[2] = covariance[0] * inverse_determinant;
    normalize_vector(offset, direction, distance);
    const V sum = value(conic[0]) + value(conic[1]) + value(conic[2]) + value(point[0]) + value(point[1]) +
                  value(covariance[0]) + value(covariance[2]) + value(direction[0]) + value(direction[1]) +
                  value(direction[2]) + value(inverse_determinant);
    good = finite(sum) & (value(determinant) > 0.0f);
  }
};

// LANES Gaussians of a chunk, from its number k0 on; at the end of a chunk there are only `count`, and `index`
// repeats the last one beyond that.
struct LaneGroup {
  std::size_t k0;
  int count;
  std::uint32_t from;
  bool contiguous;             // LANES of them, one after the other in memory, from number `from` on
  std::uint32_t index[LANES];  // after fill_index: most groups out of sight never need it

  LaneGroup(const Scene& s, std::size_t first, std::size_t k0, std::size_t all)
      : k0(k0),
        count(all - k0 < LANES ? static_cast<int>(all - k0) : LANES),
        from(static_cast<std::uint32_t>(first + k0)),
        contiguous(!s.active && count == LANES) {}

  void fill_index(const Scene& s) {
    for (int l = 0; l < LANES; ++l) {
      const std::uint32_t j = from + static_cast<std::uint32_t>(l < count ? l : count - 1);
      index[l] = s.active ? s.active[j] : j;
    }
  }
};

// Values of a group from a table of one or of three numbers per Gaussian.
inline V load_scalars(const float* base, const LaneGroup& group) {
  if (group.contiguous) return load(base + group.from);
  V out[1];
  gather<1>(base, group.index, out);
  return out[0];
}
inline void load_vectors(const float* base, const LaneGroup& group, V* out) {
  if (group.contiguous) {
    load_triples(base + 3 * static_cast<std::size_t>(group.from), out);
  } else {
    gather<3>(base, group.index, out);
  }
}

// Prefetches `each` numbers of each of the LANES Gaussians that begin LANES after number `from`, even beyond the end of
// the table, where a prefetch does nothing. Always inlined, because GCC 12 takes a function that only prefetches for
// one without effects, and drops its calls.
template <int FOR_WRITING = 0>
[[gnu::always_inline]] inline void prefetch_after(const float* base, std::size_t from, int each) {
  for (int i = 0; i < each * LANES; i += 16) {
    __builtin_prefetch(base + static_cast<std::size_t>(each) * (from + LANES) + i, FOR_WRITING);
  }
}
// Prefetches all parameters of the group after a contiguous one.
template <int COLUMNS>
[[gnu::always_inline]] inline void prefetch_next_group(const Scene& s, const LaneGroup& group) {
  if (!group.contiguous) return;
  prefetch_after(s.positions, group.from, 3);
  prefetch_after(s.shape, group.from, COLUMNS == 2 ? 6 : 4);
  if (COLUMNS == 3) prefetch_after(s.scales, group.from, 3);
  prefetch_after(s.opacities, group.from, 1);
  prefetch_after(s.sh, group.from, harmonics_of(s));
}

// Calls f(group) for all groups of the Gaussians number first..first + count.
template <class F>
inline void for_groups(const Scene& s, std::size_t first, std::size_t count, F f) {
  for (std::size_t k0 = 0; k0 < count; k0 += LANES) {
    LaneGroup group(s, first, k0, count);
    group.fill_index(s);
    f(group);
  }
}

// Centres of a group, and the vectors to these from the eye (world axes).
inline void load_centers(const Scene& s, const LaneGroup& group, V* position, V* offset) {
  load_vectors(s.positions, group, position);
  for (int k = 0; k < 3; ++k) offset[k] = position[k] - s.view.eye[k];
}

// Calls f.run<COLUMNS, Camera>() for the shape (2 columns: discs, 3: ellipsoids) and the camera of the scene.
template <class F>
inline void for_scene(const Scene& s, F& f) {
  if (s.view.fisheye) return s.scales ? f.template run<3, Fisheye>() : f.template run<2, Fisheye>();
  s.scales ? f.template run<3, Pinhole>() : f.template run<2, Pinhole>();
}

}  // namespace
}  // namespace RESPIRE_ISA
}  // namespace respire
