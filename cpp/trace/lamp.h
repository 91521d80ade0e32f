#pragma once
// The lamp: a point with inverse-square falloff and a profile around the camera's axis, and what a vertex of a path sends on of
// its light. Where the lamp sits at the camera and the camera sees a point, this is a closed form without a shadow ray.

#include "cpp/trace/surface.h"

namespace respire {

class LitWall : public Wall {
 public:
  LitWall(const Tracer& tracer, const FrameSettings& frame)
      : Wall(tracer, frame),
        light_{frame.light[0], frame.light[1], frame.light[2]},
        intensity_{frame.intensity[0], frame.intensity[1], frame.intensity[2]},
        light_axis_{frame.rotation[2], frame.rotation[5], frame.rotation[8]} {}

 protected:
  // Closer than this to the light nothing is lit more brightly, in mm^2.
  static constexpr float kNearest2 = 1e-4f;

  // The light's profile: the part of its intensity in a direction of this cosine to its axis (the camera's).
  float emission(float cosine) const {
    if (frame_.emission_exponent == 0.0f) return 1.0f;
    cosine = clamp(cosine, 0.0f, 1.0f);
    return frame_.emission_exponent == 1.0f ? cosine : std::pow(cosine, frame_.emission_exponent);
  }

  // Irradiance of the lamp, and where it is.
  Vec3 irradiance(const Surface& s, bool shadows, Vec3& direction) {
    const Vec3 to_light = light_ - s.point;
    const float r2 = std::max(dot(to_light, to_light), kNearest2), r = std::sqrt(r2);
    direction = to_light * (1.0f / r);
    const float cosine = dot(s.shading, direction);
    if (cosine <= 0.0f || dot(s.geometric, direction) <= 0.0f) return {0, 0, 0};
    if (shadows && occluded(s.point + s.geometric * kOffset, direction, r * (1.0f - 1e-5f) - kOffset)) return {0, 0, 0};
    return intensity_ * (emission(-dot(direction, light_axis_)) * cosine / r2);
  }

  Vec3 irradiance(const Surface& s, bool shadows) {
    Vec3 unused;
    return irradiance(s, shadows, unused);
  }

  // Irradiance of the lamp as it would be if nothing stood in its way, fine relief left out.
  Vec3 unshadowed(const Surface& s) const {
    const Vec3 to_light = light_ - s.point;
    const float r2 = std::max(dot(to_light, to_light), kNearest2);
    const Vec3 direction = to_light * (1.0f / std::sqrt(r2));
    const float cosine = dot(s.smooth, direction);
    if (cosine <= 0.0f || dot(s.geometric, direction) <= 0.0f) return {0, 0, 0};
    return intensity_ * (emission(-dot(direction, light_axis_)) * cosine / r2);
  }

  // Radiance towards `o` by the lamp itself, from a base of albedo `rho`.
  Vec3 direct_light(const Surface& s, const Frame& frame, Vec3 o, bool shadows, Vec3 rho) {
    Vec3 direction;
    const Vec3 received = irradiance(s, shadows, direction);
    if (!(received.x + received.y + received.z > 0.0f)) return {0, 0, 0};
    if (!tracer_.coated_) return received * rho * (1.0f / kPi);
    const float e = tracer_.coat_.albedo(s.alpha, o.z);
    const float mirrored = tracer_.coat_.value(o, frame.local(direction), s.alpha);
    return received * (rho * ((1.0f - e) / kPi) + Vec3{mirrored, mirrored, mirrored});
  }

  Vec3 light_, intensity_, light_axis_;
};

}  // namespace respire
