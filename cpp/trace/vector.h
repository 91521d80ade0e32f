#pragma once
// Three floats, and the few mathematical functions and sampled directions of the hot path. sqrt is exact by IEEE 754;
// sine and cosine are our own polynomials, because a C library may round differently on another processor.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

namespace respire {

constexpr float PI = 3.14159265358979f;

struct Vec3 {
  float x, y, z;
};

inline Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec3 operator*(Vec3 a, Vec3 b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
inline Vec3 operator*(Vec3 a, float s) { return {a.x * s, a.y * s, a.z * s}; }
inline Vec3 operator-(Vec3 a) { return {-a.x, -a.y, -a.z}; }
inline Vec3& operator+=(Vec3& a, Vec3 b) { return a = a + b; }
inline float dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 cross(Vec3 a, Vec3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline float length(Vec3 a) { return std::sqrt(dot(a, a)); }
inline Vec3 normalize(Vec3 a) { return a * (1.0f / length(a)); }
inline Vec3 unit_or_zero(Vec3 a) {
  float l2 = dot(a, a);
  return l2 > 0.0f ? a * (1.0f / std::sqrt(l2)) : Vec3{0.0f, 0.0f, 0.0f};
}
// The normal of a face without area, which no light reaches or leaves, is any.
inline Vec3 unit_normal(Vec3 a) {
  float l2 = dot(a, a);
  return l2 > 0.0f ? a * (1.0f / std::sqrt(l2)) : Vec3{0.0f, 0.0f, 1.0f};
}
inline float max_component(Vec3 a) { return std::max(a.x, std::max(a.y, a.z)); }
inline Vec3 load(const float* p) { return {p[0], p[1], p[2]}; }
inline void store(float* p, Vec3 a) { p[0] = a.x, p[1] = a.y, p[2] = a.z; }
// Component by component; 0 where `b` is not positive.
inline Vec3 quotient(Vec3 a, Vec3 b) {
  return {b.x > 0 ? a.x / b.x : 0.0f, b.y > 0 ? a.y / b.y : 0.0f, b.z > 0 ? a.z / b.z : 0.0f};
}
inline float clamp(float v, float low, float high) { return std::min(std::max(v, low), high); }
inline float mix(float a, float b, float t) { return a + (b - a) * t; }

// 0 below `low`, 1 above `high`, smooth between.
inline float smoothstep(float low, float high, float v) {
  float t = clamp((v - low) / (high - low), 0.0f, 1.0f);
  return t * t * (3.0f - 2.0f * t);
}

// The x in [0, 1] at which x^2 (3 - 2 x) is `v`, to 1e-6: Newton's steps from a start that is right at both ends.
inline float inverse_smoothstep(float v) {
  const float low = std::min(v, 1.0f - v);
  // Near 0 the polynomial is 3 x^2.
  float x = std::sqrt(low * (1.0f / 3.0f)) * (1.0f + 0.45f * low);
  for (int step = 0; step < 3; ++step) {
    const float slope = 6.0f * x * (1.0f - x);
    if (slope > 1e-6f) x -= (x * x * (3.0f - 2.0f * x) - low) / slope;
  }
  x = clamp(x, 0.0f, 0.5f);
  return v <= 0.5f ? x : 1.0f - x;
}

// Cosine and sine of 2 pi `turns`, `turns` in [0, 1]; error below 3e-7.
inline void cos_sin_turns(float turns, float& cosine, float& sine) {
  float quarter = turns * 4.0f;
  int q = static_cast<int>(quarter + 0.5f);
  float r = (quarter - static_cast<float>(q)) * (0.5f * PI);
  float r2 = r * r;
  float s = r * (1.0f + r2 * (-1.6666667e-1f + r2 * (8.3333333e-3f + r2 * -1.9515296e-4f)));
  float c = 1.0f + r2 * (-0.5f + r2 * (4.1666668e-2f + r2 * (-1.3888397e-3f + r2 * 2.4433157e-5f)));
  switch (q & 3) {
    case 0: cosine = c, sine = s; break;
    case 1: cosine = -s, sine = c; break;
    case 2: cosine = -c, sine = -s; break;
    default: cosine = s, sine = -c;
  }
}

// -ln(x) for normal x in (0, 1]; error below 3e-7 of the value and 1e-7 absolute.
inline float minus_log(float x) {
  std::uint32_t bits;
  std::memcpy(&bits, &x, sizeof bits);
  // Mantissa in [sqrt(1/2), sqrt(2)).
  const std::uint32_t shifted = bits - 0x3f3504f3u;
  const int exponent = static_cast<int>(shifted) >> 23;
  bits = (shifted & 0x007fffffu) + 0x3f3504f3u;
  float m;
  std::memcpy(&m, &bits, sizeof m);
  const float s = (m - 1.0f) / (m + 1.0f), s2 = s * s;
  const float log_m = 2.0f * s * (1.0f + s2 * (0.33333333f + s2 * (0.2f + s2 * (0.14285714f + s2 * 0.11111111f))));
  return -(static_cast<float>(exponent) * 0.69314718f + log_m);
}

// exp(-x) for x >= 0; relative error below 4e-7; 0 where it would be below 1e-37.
inline float exp_minus(float x) {
  if (x > 85.0f) return 0.0f;
  const float y = x * 1.44269504f;
  const int whole = static_cast<int>(y + 0.5f);
  // The product of `whole` with the first part of ln 2 is exact.
  const float r = (static_cast<float>(whole) * 0.693359375f - x) - static_cast<float>(whole) * 2.12194440e-4f;
  const float e =
      1.0f + r * (1.0f + r * (0.5f + r * (0.16666667f + r * (0.041666667f + r * (0.0083333333f + r * 0.0013888889f)))));
  const std::uint32_t bits = static_cast<std::uint32_t>(127 - whole) << 23;
  float scale;
  std::memcpy(&scale, &bits, sizeof scale);
  return e * scale;
}

// A direction of the upper half-space from two uniform numbers, density cos / pi (Malley's method).
inline Vec3 cosine_direction(float u, float v) {
  float c, s;
  cos_sin_turns(v, c, s);
  const float r = std::sqrt(u);
  return {r * c, r * s, std::sqrt(1.0f - u)};
}

// A direction of the whole sphere from two uniform numbers, density 1 / (4 pi).
inline Vec3 isotropic_direction(float u, float v) {
  float c, s;
  cos_sin_turns(v, c, s);
  const float z = 1.0f - 2.0f * u, r = std::sqrt(std::max(0.0f, 1.0f - z * z));
  return {r * c, r * s, z};
}

// Two tangents that make a right-handed frame with the unit vector `n` (Duff et al., JCGT 2017).
struct TangentFrame {
  Vec3 t, b, n;
  explicit TangentFrame(Vec3 normal) : n(normal) {
    float sign = std::copysign(1.0f, n.z), a = -1.0f / (sign + n.z), c = n.x * n.y * a;
    t = {1.0f + sign * n.x * n.x * a, sign * c, -sign * n.x};
    b = {c, sign + n.y * n.y * a, -n.y};
  }
  Vec3 world(Vec3 local) const { return t * local.x + b * local.y + n * local.z; }
  Vec3 local(Vec3 world) const { return {dot(world, t), dot(world, b), dot(world, n)}; }
};

}  // namespace respire
