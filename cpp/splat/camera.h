#pragma once
// The cameras of the splat kernels: image points of points in camera axes, the Jacobian J of that map applied to the
// columns of a covariance's square root, and both backward; for values (V) and for values with a derivative (Dual).
// The plain twin is src/splat/plain/lens.rs. A camera N has
//   linearize(w, t, point)             J and the image point at the point t in camera axes, for the calls below
//   apply_jacobian(w, c, u)            u = J c
//   apply_transposed(w, by_u, by_c)    by_c = J^T by_u
//   pullback(w, by_point, by_u, c, by_t)   gradient by t, through the image point and through J (V only)
//   focal_independent(k, by_u, c)      the part of (row k of J) . (its gradient) that does not grow with the focal
//                                      length (V only)
//   by_center(k, by_u, c)              gradient by the principal point through J (V only)
//   exact_point(view, t, point)        the image point in double
#include "cpp/splat/kernel.h"
#include "cpp/splat/lanes.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

// (x, y) = f (t_x, t_y) / t_z + c. The Jacobian is evaluated at x / z and y / z clamped to `low` and
// `high`, as in gsplat: J = f / z (1, -clamp(x / z)) for each row, in the columns of that axis (j0) and of z (j2).
template <class N>
struct Pinhole {
  N t[3], rz, slope[2], clamped[2], j0[2], j2[2];

  void linearize(const View& w, const N* at, N* point) {
    for (int k = 0; k < 3; ++k) t[k] = at[k];
    rz = reciprocal_of(t[2]);
    for (int k = 0; k < 2; ++k) {
      slope[k] = t[k] * rz;
      clamped[k] = clamp(slope[k], w.low[k], w.high[k]);
      point[k] = w.focal[k] * slope[k] + w.center[k];
      j0[k] = w.focal[k] * rz;
      j2[k] = -(j0[k] * clamped[k]);
    }
  }

  void apply_jacobian(const View&, const N* c, N* u) const {
    for (int a = 0; a < 2; ++a) u[a] = j0[a] * c[a] + j2[a] * c[2];
  }

  void apply_transposed(const View&, const N* by_u, N* by_c) const {
    by_c[0] = j0[0] * by_u[0], by_c[1] = j0[1] * by_u[1];
    by_c[2] = j2[0] * by_u[0] + j2[1] * by_u[1];
  }

  template <int COLUMNS>
  void pullback(const View& w, const N* by_point, const N by_u[COLUMNS][2], const N c[COLUMNS][3], N* by_t) const {
    N by_j0[2] = {N{}, N{}}, by_j2[2] = {N{}, N{}};
    for (int k = 0; k < COLUMNS; ++k)
      for (int r = 0; r < 2; ++r) {
        by_j0[r] += by_u[k][r] * c[k][r];
        by_j2[r] += by_u[k][r] * c[k][2];
      }
    by_t[2] = N{};
    for (int r = 0; r < 2; ++r) {
      const float f = w.focal[r];
      const N rz2 = rz * rz;
      by_t[r] = f * rz * by_point[r];
      by_t[2] -= f * t[r] * by_point[r] * rz2;
      // j0 = f / z, j2 = -f u / z with u = clamp(x / z).
      by_t[2] -= rz2 * f * by_j0[r];
      by_t[2] += rz2 * f * clamped[r] * by_j2[r];
      const N along = keep(slope[r] == clamped[r], -f * rz * by_j2[r] * rz);
      by_t[r] += along;
      by_t[2] -= along * slope[r];
    }
  }

  // The gradient by j2 where that is clamped: the bound belongs to the image, so that it is no multiple of 1 / f, and
  // grows by 1 / z with the principal point.
  template <int COLUMNS>
  N by_clamped(int k, const N by_u[COLUMNS][2], const N c[COLUMNS][3]) const {
    N by_j2{};
    for (int column = 0; column < COLUMNS; ++column) by_j2 += by_u[column][k] * c[column][2];
    return keep(slope[k] != clamped[k], by_j2);
  }
  template <int COLUMNS>
  N focal_independent(int k, const N by_u[COLUMNS][2], const N c[COLUMNS][3]) const {
    return j2[k] * by_clamped<COLUMNS>(k, by_u, c);
  }
  template <int COLUMNS>
  N by_center(int k, const N by_u[COLUMNS][2], const N c[COLUMNS][3]) const {
    return rz * by_clamped<COLUMNS>(k, by_u, c);
  }

  static void exact_point(const ExactView& view, const VD* t, VD* point) {
    for (int k = 0; k < 2; ++k) point[k] = view.focal[k] * (t[k] / t[2]) + view.center[k];
  }
};

// a(v) = atan(r) / r with v = r^2, F = (a - 1 / (1 + v)) / v = -2 a', and F'. Near the axis the closed forms of F and
// F' are differences of nearly equal numbers; there series take their place.
struct Arc {
  V a, f, slope;  // a, F, F'
  explicit Arc(V v) {
    // The angle halved twice: tan(x / 2) = tan x / (1 + sqrt(1 + tan^2 x)).
    const V once = 1.0f / (1.0f + square_root(1.0f + v)), half = v * once * once;
    const V twice = 1.0f / (1.0f + square_root(1.0f + half)), y = half * twice * twice;
    // atan(r) / r of a quarter of the angle: a polynomial in its square (least maximum error).
    constexpr float ARC[] = {0.105698288f, -0.142395327f, 0.19998183f, -0.333333069f, 0.999999999f};
    V p = broadcast(-0.0602630523f);
    for (float k : ARC) p = fma(p, y, broadcast(k));
    a = 4.0f * once * twice * p;
    const V over = 1.0f / (1.0f + v), by_v = 1.0f / v;
    // F = sum_m (2 m + 2) / (2 m + 3) (-v)^m; below 0.15 eleven terms are exact to single precision.
    const VI small = v < 0.15f;
    V series = broadcast(22.0f / 23.0f), derivative = broadcast(10.0f * 22.0f / 23.0f);
    for (int m = 9; m >= 0; --m) {
      const float k = (2.0f * static_cast<float>(m) + 2.0f) / (2.0f * static_cast<float>(m) + 3.0f);
      series = fnma(series, v, broadcast(k));
      if (m > 0) derivative = fnma(derivative, v, broadcast(static_cast<float>(m) * k));
    }
    f = select(small, series, (a - over) * by_v);
    slope = select(small, -derivative, (over * over - 1.5f * f) * by_v);
  }
};

inline void arc(V v, V& a, V& f) {
  const Arc arc(v);
  a = arc.a, f = arc.f;
}
inline void arc(Dual v, Dual& a, Dual& f) {
  const Arc arc(v.v);
  a = {arc.a, -0.5f * arc.f * v.d}, f = {arc.f, arc.slope * v.d};
}

// c0 + c1 x + .. + c4 x^4.
template <class N>
inline N polynomial(N x, float c0, float c1, float c2, float c3, float c4) {
  return (((c4 * x + c3) * x + c2) * x + c1) * x + c0;
}

// OpenCV's fisheye model: the image point is f (x, y) s + c with s = theta_d / r, theta_d = theta D(theta^2) and
// D = 1 + k1 theta^2 + .. + k4 theta^8. With v = r^2 / z^2 and S(v) = a(v) D(v a^2): s = S / z, ds/d(x, y) = q (x, y)
// with q = 2 S' / z^3, ds/dz = -w with w = (S + 2 v S') / z^2. No clamp: the model itself bounds the angle.
template <class N>
struct Fisheye {
  N t[3], rz, v, a, f, over, s, q, w, first;  // first: S'

  void linearize(const View& view, const N* at, N* point) {
    for (int k = 0; k < 3; ++k) t[k] = at[k];
    // v, a, F.
    rz = reciprocal_of(t[2]);
    v = (t[0] * t[0] + t[1] * t[1]) * (rz * rz);
    arc(v, a, f);
    over = reciprocal_of(v + 1.0f);
    // S and S' through D and its derivative by the square of the angle.
    const float* k = view.lens;
    const N angle2 = v * (a * a);
    const N d = polynomial(angle2, 1, k[0], k[1], k[2], k[3]),
            d1 = polynomial(angle2, k[0], 2 * k[1], 3 * k[2], 4 * k[3], 0);
    const N curve = a * d;
    first = a * a * d1 * over - 0.5f * (f * d);
    s = curve * rz;
    q = 2.0f * (first * rz) * (rz * rz);
    w = (curve + 2.0f * (v * first)) * (rz * rz);
    for (int i = 0; i < 2; ++i) point[i] = view.focal[i] * (t[i] * s) + view.center[i];
  }

  void apply_jacobian(const View& view, const N* c, N* u) const {
    const N along = q * (t[0] * c[0] + t[1] * c[1]) - w * c[2];
    for (int i = 0; i < 2; ++i) u[i] = view.focal[i] * (s * c[i] + t[i] * along);
  }

  void apply_transposed(const View& view, const N* by_u, N* by_c) const {
    const N e[2] = {view.focal[0] * by_u[0], view.focal[1] * by_u[1]}, along = e[0] * t[0] + e[1] * t[1];
    for (int i = 0; i < 2; ++i) by_c[i] = e[i] * s + t[i] * (q * along);
    by_c[2] = -w * along;
  }

  template <int COLUMNS>
  void pullback(const View& view, const N* by_point, const N by_u[COLUMNS][2], const N c[COLUMNS][3], N* by_t) const {
    // By s, q, w, and by t where it stands beside them.
    N by_s = N{}, by_q = N{}, by_w = N{};
    for (int i = 0; i < 2; ++i) {
      const N e = view.focal[i] * by_point[i];
      by_s += e * t[i];
      by_t[i] = e * s;
    }
    for (int k = 0; k < COLUMNS; ++k) {
      const N e[2] = {view.focal[0] * by_u[k][0], view.focal[1] * by_u[k][1]};
      const N across = e[0] * t[0] + e[1] * t[1], along = t[0] * c[k][0] + t[1] * c[k][1];
      by_s += e[0] * c[k][0] + e[1] * c[k][1];
      by_q += across * along;
      by_w -= across * c[k][2];
      for (int i = 0; i < 2; ++i) by_t[i] += e[i] * (q * along - w * c[k][2]) + across * q * c[k][i];
    }
    const float* k = view.lens;
    const N angle2 = v * (a * a);
    const N d = polynomial(angle2, 1, k[0], k[1], k[2], k[3]),
            d1 = polynomial(angle2, k[0], 2 * k[1], 3 * k[2], 4 * k[3], 0);
    // Through them by r^2 = t_x^2 + t_y^2 and by t_z, which takes S''.
    const N d2 = polynomial(angle2, 2 * k[1], 6 * k[2], 12 * k[3], 0, 0);
    const N second = a * over * (a * over * (a * d2 - d1) - 1.5f * f * d1) - 0.5f * Arc(v).slope * d;
    const N rz2 = rz * rz, turning = (4.0f * (v * second) + 6.0f * first) * (rz2 * rz2);
    const N by_r2 = q * by_s + 4.0f * (second * rz) * (rz2 * rz2) * by_q + turning * by_w;
    by_t[0] += t[0] * by_r2, by_t[1] += t[1] * by_r2;
    by_t[2] =
        -w * by_s - turning * by_q - (2.0f * s * rz2 + v * (10.0f * first + 4.0f * (v * second)) * (rz * rz2)) * by_w;
  }

  template <int COLUMNS>
  N focal_independent(int, const N[COLUMNS][2], const N[COLUMNS][3]) const {
    return N{};
  }
  template <int COLUMNS>
  N by_center(int, const N[COLUMNS][2], const N[COLUMNS][3]) const {
    return N{};
  }

  static void exact_point(const ExactView& view, const VD* t, VD* point) {
    const double* const k = view.lens;
    const VD r2 = t[0] * t[0] + t[1] * t[1];
    // As in `Arc`, with the angle halved three times.
    const VD once = 1.0 / (t[2] + square_root(r2 + t[2] * t[2])), half = r2 * once * once;
    const VD twice = 1.0 / (1.0 + square_root(1.0 + half)), quarter = half * twice * twice;
    const VD thrice = 1.0 / (1.0 + square_root(1.0 + quarter)), y = quarter * thrice * thrice;
    constexpr double ARC[] = {0.0763866863087169712, -0.0908913717269654271, 0.111110784963278976,
                              -0.142857139587397062, 0.199999999983872751,   -0.333333333333302991,
                              0.999999999999999991};
    VD p = VD{} - 0.0580909140881853938;
    for (double c : ARC) p = p * y + c;
    const VD a = 8.0 * once * twice * thrice * p, angle2 = r2 * a * a;
    const VD s = a * (1.0 + angle2 * (k[0] + angle2 * (k[1] + angle2 * (k[2] + angle2 * k[3]))));
    for (int i = 0; i < 2; ++i) point[i] = view.focal[i] * (t[i] * s) + view.center[i];
  }
};

}  // namespace
}  // namespace RESPIRE_ISA
}  // namespace respire
