#pragma once
// Projection of LANES Gaussians at once, after EWA splatting (Zwicker et al. 2001) as 3DGS does it, for values (V)
// and for values with a derivative (Dual). The plain twin, src/splat/plain/project.rs, also explains the symbols:
//
//   t = R (p - eye),  c_k = R m_k,  u_k = J c_k
//   covariance on screen = sum_k u_k u_k^T + dilation I,  conic = its inverse
#include "cpp/splat/camera.h"

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
  const V inverse = 1.0f / square_root(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (int k = 0; k < 4; ++k) q[k] *= inverse;
  return inverse;
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

// Real spherical harmonics up to degree 3 with the signs and constants of 3DGS; src/splat/number/sh.rs is the twin.
constexpr float C0 = 0.28209479177387814f, C1 = 0.4886025119029199f;
constexpr float C2[5] = {1.0925484305920792f, -1.0925484305920792f, 0.31539156525252005f, -1.0925484305920792f,
                         0.5462742152960396f};
constexpr float C3[7] = {-0.5900435899266435f, 2.890611442640554f, -0.4570457994644658f, 0.3731763325901154f,
                         -0.4570457994644658f, 1.445305721320277f, -0.5900435899266435f};

template <class N, int DEGREE>
inline void basis(const N* v, N* out) {
  const N x = v[0], y = v[1], z = v[2];
  constant(broadcast(C0), &out[0]);
  if constexpr (DEGREE >= 1) out[1] = -(C1 * y), out[2] = C1 * z, out[3] = -(C1 * x);
  if constexpr (DEGREE >= 2) {
    out[4] = C2[0] * (x * y), out[5] = C2[1] * (y * z), out[6] = C2[2] * (2.0f * (z * z) - x * x - y * y);
    out[7] = C2[3] * (x * z), out[8] = C2[4] * (x * x - y * y);
  }
  if constexpr (DEGREE >= 3) {
    const N xx = x * x, yy = y * y, zz = z * z;
    out[9] = C3[0] * (y * (3.0f * xx - yy)), out[10] = C3[1] * (x * y * z);
    out[11] = C3[2] * (y * (4.0f * zz - xx - yy)), out[12] = C3[3] * (z * (2.0f * zz - 3.0f * xx - 3.0f * yy));
    out[13] = C3[4] * (x * (4.0f * zz - xx - yy)), out[14] = C3[5] * (z * (xx - yy));
    out[15] = C3[6] * (x * (xx - 3.0f * yy));
  }
}

// Colour towards `direction` before the clamp at 0: 0.5 + sum_i b_i(direction) sh_i; `sh` has 3 (DEGREE + 1)^2 vectors.
template <class N, int DEGREE>
inline void evaluate_color(const N* direction, const V* sh, N* color) {
  constexpr int COUNT = (DEGREE + 1) * (DEGREE + 1);
  N b[COUNT];
  basis<N, DEGREE>(direction, b);
  for (int k = 0; k < 3; ++k) {
    constant(broadcast(0.5f), &color[k]);
    for (int i = 0; i < COUNT; ++i) color[k] = color[k] + b[i] * sh[3 * i + k];
  }
}

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

// Prefetches N numbers of each of the LANES Gaussians that begin LANES after number `from`, even beyond the end of
// the table, where a prefetch does nothing. Always inlined, because GCC 12 takes a function that only prefetches for
// one without effects, and drops its calls.
template <int N, int FOR_WRITING = 0>
[[gnu::always_inline]] inline void prefetch_after(const float* base, std::size_t from) {
  for (int i = 0; i < N * LANES; i += 16) __builtin_prefetch(base + N * (from + LANES) + i, FOR_WRITING);
}
// Prefetches all parameters of the group after a contiguous one.
template <int SH, int COLUMNS>
[[gnu::always_inline]] inline void prefetch_next_group(const Scene& s, const LaneGroup& group) {
  if (!group.contiguous) return;
  prefetch_after<3>(s.positions, group.from);
  prefetch_after<COLUMNS == 2 ? 6 : 4>(s.shape, group.from);
  if (COLUMNS == 3) prefetch_after<3>(s.scales, group.from);
  prefetch_after<1>(s.opacities, group.from);
  prefetch_after<SH>(s.sh, group.from);
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

template <template <class> class Camera, class F>
inline void for_shapes(const Scene& s, F& f) {
  switch (s.sh_degree * 2 + (s.scales != nullptr)) {
    case 0: return f.template run<0, 2, Camera>();
    case 1: return f.template run<0, 3, Camera>();
    case 2: return f.template run<1, 2, Camera>();
    case 3: return f.template run<1, 3, Camera>();
    case 4: return f.template run<2, 2, Camera>();
    case 5: return f.template run<2, 3, Camera>();
    case 6: return f.template run<3, 2, Camera>();
    default: return f.template run<3, 3, Camera>();
  }
}

// Calls f.run<DEGREE, COLUMNS, Camera>() for the degree, the shape (2 columns: discs, 3: ellipsoids) and the camera
// of the scene.
template <class F>
inline void for_scene(const Scene& s, F& f) {
  if (s.view.fisheye) return for_shapes<Fisheye>(s, f);
  for_shapes<Pinhole>(s, f);
}

}  // namespace
}  // namespace RESPIRE_ISA
}  // namespace respire
