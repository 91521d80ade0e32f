#pragma once
// The colour of LANES Gaussians towards a direction, by real spherical harmonics. Nothing here knows of shapes and
// cameras: the kernels, which are compiled for each of them, call one function for all four degrees, and so take a third
// of the time to compile.
#include "cpp/splat/kernel.h"
#include "cpp/splat/lanes.h"

namespace respire {
namespace RESPIRE_ISA {
namespace {

// Real spherical harmonics up to degree 3 with the signs and constants of 3DGS; src/splat/number/sh.rs is the twin.
constexpr float C0 = 0.28209479177387814f, C1 = 0.4886025119029199f;
constexpr float C2[5] = {1.0925484305920792f, -1.0925484305920792f, 0.31539156525252005f, -1.0925484305920792f,
                         0.5462742152960396f};
constexpr float C3[7] = {-0.5900435899266435f, 2.890611442640554f, -0.4570457994644658f, 0.3731763325901154f,
                         -0.4570457994644658f, 1.445305721320277f, -0.5900435899266435f};

// The first COUNT functions towards the unit vector `v`.
template <class N, int COUNT>
inline void basis(const N* v, N* out) {
  const N x = v[0], y = v[1], z = v[2];
  constant(broadcast(C0), &out[0]);
  if constexpr (COUNT >= 4) out[1] = -(C1 * y), out[2] = C1 * z, out[3] = -(C1 * x);
  if constexpr (COUNT >= 9) {
    out[4] = C2[0] * (x * y), out[5] = C2[1] * (y * z), out[6] = C2[2] * (2.0f * (z * z) - x * x - y * y);
    out[7] = C2[3] * (x * z), out[8] = C2[4] * (x * x - y * y);
  }
  if constexpr (COUNT >= 16) {
    const N xx = x * x, yy = y * y, zz = z * z;
    out[9] = C3[0] * (y * (3.0f * xx - yy)), out[10] = C3[1] * (x * y * z);
    out[11] = C3[2] * (y * (4.0f * zz - xx - yy)), out[12] = C3[3] * (z * (2.0f * zz - 3.0f * xx - 3.0f * yy));
    out[13] = C3[4] * (x * (4.0f * zz - xx - yy)), out[14] = C3[5] * (z * (xx - yy));
    out[15] = C3[6] * (x * (xx - 3.0f * yy));
  }
}

// How many coefficients a Gaussian has.
inline int harmonics_of(const Scene& s) { return 3 * static_cast<int>((s.sh_degree + 1) * (s.sh_degree + 1)); }

template <int D>
struct Degree {
  static constexpr int BASIS = (D + 1) * (D + 1), SH = 3 * BASIS;
};

// Calls f(Degree<D>()) for the degree of the scene.
template <class F>
inline void for_degree(const Scene& s, F f) {
  switch (s.sh_degree) {
    case 0: return f(Degree<0>());
    case 1: return f(Degree<1>());
    case 2: return f(Degree<2>());
    default: return f(Degree<3>());
  }
}

// 0.5 + sum_i b_i sh_i, before the clamp at 0; `sh` has three vectors for each of COUNT functions b.
template <class N, int COUNT>
inline void sum_color(const N* b, const V* sh, N* color) {
  for (int k = 0; k < 3; ++k) {
    constant(broadcast(0.5f), &color[k]);
    for (int i = 0; i < COUNT; ++i) color[k] = color[k] + b[i] * sh[3 * i + k];
  }
}

// Colours towards `direction` before the clamp at 0.
template <class N>
[[gnu::noinline]] void color_towards(const Scene& s, const std::uint32_t* index, const N* direction, N* color) {
  for_degree(s, [&](auto degree) {
    V sh[degree.SH];
    N b[degree.BASIS];
    gather<degree.SH>(s.sh, index, sh);
    basis<N, degree.BASIS>(direction, b);
    sum_color<N, degree.BASIS>(b, sh, color);
  });
}

}  // namespace
}  // namespace RESPIRE_ISA
}  // namespace respire
