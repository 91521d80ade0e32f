#pragma once
// GGX dielectric coat over a Lambert base:
//   f = F(wi.h) D(h) / (4 cos_i cos_o (1 + Lambda(wi) + Lambda(wo))) + (1 - E(cos_o)) rho / pi
// with height-correlated Smith shadowing (Heitz, JCGT 2014), exact dielectric Fresnel, and E the directional albedo of
// the first term, tabulated over roughness and cosine. o is the viewing side of the path, i the side of the light. Left
// out: the colour that light takes on inside the base under the interface, and its internal reflection. All directions
// are in the local frame of the shading normal (z up).

#include <cmath>

#include "cpp/trace/vector.h"

namespace respire {

// Unpolarised Fresnel reflectance of a dielectric of relative index `ior`, `c` cosine on the outer side.
inline float fresnel(float c, float ior) {
  float g2 = ior * ior - 1.0f + c * c;
  if (g2 <= 0.0f) return 1.0f;
  float g = std::sqrt(g2), a = (g - c) / (g + c), b = (c * (g + c) - 1.0f) / (c * (g - c) + 1.0f);
  return 0.5f * a * a * (1.0f + b * b);
}

// Smith's Lambda of GGX: (sqrt(1 + alpha^2 tan^2) - 1) / 2.
inline float smith_lambda(float cosine, float alpha) {
  float c2 = cosine * cosine;
  return 0.5f * (std::sqrt(1.0f + alpha * alpha * (1.0f - c2) / c2) - 1.0f);
}

// GGX distribution of microfacet normals: D = alpha^2 / (pi (cos_h^2 (alpha^2 - 1) + 1)^2).
inline float ggx(float cosine_h, float alpha) {
  float a2 = alpha * alpha, d = cosine_h * cosine_h * (a2 - 1.0f) + 1.0f;
  return a2 / (PI * d * d);
}

// Weight of the direction `i` into which the sampled visible normal h mirrors `o`: f cos_i / density = F G2 / G1, or
//   F(o.h) (1 + Lambda(o)) / (1 + Lambda(o) + Lambda(i)).
inline float mirror_weight(Vec3 o, Vec3 h, Vec3 i, float alpha, float ior) {
  const float lo = smith_lambda(o.z, alpha), li = smith_lambda(i.z, alpha);
  return fresnel(dot(o, h), ior) * (1.0f + lo) / (1.0f + lo + li);
}

// `o` mirrored about `h`.
inline Vec3 mirror(Vec3 o, Vec3 h) { return h * (2.0f * dot(o, h)) - o; }

// Samples a microfacet normal visible from `o` (Heitz, JCGT 2018).
inline Vec3 visible_normal(Vec3 o, float alpha, float u, float v) {
  // Stretch `o` to the hemisphere (roughness 1), and build two tangents there.
  Vec3 s = normalize({alpha * o.x, alpha * o.y, o.z});
  float plane2 = s.x * s.x + s.y * s.y;
  Vec3 t1 = plane2 > 1e-12f ? Vec3{-s.y, s.x, 0.0f} * (1.0f / std::sqrt(plane2)) : Vec3{1.0f, 0.0f, 0.0f};
  Vec3 t2 = cross(s, t1);
  // Sample the projected area: a disc with one half squeezed, as seen from `s`.
  float r = std::sqrt(u), a, b;
  cos_sin_turns(v, a, b);
  a *= r, b *= r;
  float side = 0.5f * (1.0f + s.z);
  b = (1.0f - side) * std::sqrt(std::max(0.0f, 1.0f - a * a)) + side * b;
  // Lift the sample onto the hemisphere and undo the stretch.
  Vec3 n = t1 * a + t2 * b + s * std::sqrt(std::max(0.0f, 1.0f - a * a - b * b));
  return normalize({alpha * n.x, alpha * n.y, std::max(1e-6f, n.z)});
}

class Coat {
 public:
  Coat() = default;
  // Table for roughnesses in [alpha_low, alpha_high] (one row where they are equal).
  Coat(float alpha_low, float alpha_high, float ior);

  float ior() const { return ior_; }

  // Directional albedo of the coat seen under the cosine `cosine_o`; where that is no number, under a grazing one.
  float albedo(float alpha, float cosine_o) const {
    float column = (cosine_o > 0.0f ? std::min(cosine_o, 1.0f) : 0.0f) * (COSINES - 1);
    int c = std::min(static_cast<int>(column), COSINES - 2);
    float t = column - static_cast<float>(c);
    if (rows_ == 1) return mix(table_[c], table_[c + 1], t);
    float row = clamp((alpha - alpha_low_) * rows_per_alpha_, 0.0f, static_cast<float>(rows_ - 1));
    int r = std::min(static_cast<int>(row), rows_ - 2);
    const float* p = &table_[static_cast<std::size_t>(r) * COSINES + c];
    return mix(mix(p[0], p[1], t), mix(p[COSINES], p[COSINES + 1], t), row - static_cast<float>(r));
  }

  // The first term of f.
  float value(Vec3 o, Vec3 i, float alpha) const {
    if (o.z <= 0.0f || i.z <= 0.0f) return 0.0f;
    Vec3 h = normalize(o + i);
    return fresnel(dot(i, h), ior_) * ggx(h.z, alpha) /
           (4.0f * o.z * i.z * (1.0f + smith_lambda(o.z, alpha) + smith_lambda(i.z, alpha)));
  }

  // Density of `i` when a visible normal is sampled and `o` mirrored about it.
  static float density(Vec3 o, Vec3 i, float alpha) {
    if (o.z <= 0.0f || i.z <= 0.0f) return 0.0f;
    Vec3 h = normalize(o + i);
    return ggx(h.z, alpha) / (4.0f * o.z * (1.0f + smith_lambda(o.z, alpha)));
  }

 private:
  // Columns of the table, evenly spaced in the cosine; rows, evenly spaced in roughness, where it varies.
  static constexpr int COSINES = 129;
  static constexpr int ROUGHNESSES = 8;
  int rows_ = 0;
  float alpha_low_ = 0, rows_per_alpha_ = 0, ior_ = 1;
  const float* table_ = nullptr;
};

}  // namespace respire
