#pragma once
// The lamp: a point of intensity I with inverse-square falloff and a profile around the camera's axis,
//   E = I max(cos_axis, 0)^m cos / r^2,
// and the part of its light that a path's vertex reflects. With the lamp at the camera, a point that the camera sees
// needs no shadow ray: its direct light is a closed form.

#include "cpp/trace/surface.h"

namespace respire {

class Lamp {
 public:
  explicit Lamp(const FrameSettings& frame)
      : position_(load(frame.light.data())),
        intensity_(load(frame.intensity.data())),
        axis_{frame.rotation[2], frame.rotation[5], frame.rotation[8]},
        exponent_(frame.emission_exponent) {}

  Vec3 position() const { return position_; }
  Vec3 intensity() const { return intensity_; }

  // Fraction of the intensity that goes to a point from which the lamp lies in the unit direction `towards_lamp`.
  float emission(Vec3 towards_lamp) const {
    if (exponent_ == 0.0f) return 1.0f;
    const float cosine = clamp(-dot(towards_lamp, axis_), 0.0f, 1.0f);
    return exponent_ == 1.0f ? cosine : std::pow(cosine, exponent_);
  }

  // Squared distance from a point to the lamp, and the direction.
  float direction_from(Vec3 point, Vec3& direction) const {
    const Vec3 way = position_ - point;
    const float r2 = squared(way);
    direction = way * (1.0f / std::sqrt(r2));
    return r2;
  }

  // Squared length of `way` as the falloff uses it.
  static float squared(Vec3 way) { return std::max(dot(way, way), NEAREST2); }

  // Irradiance, and the direction to the lamp. `shadows` casts the shadow ray; null: nothing can be in between.
  Vec3 irradiance(const Surface& s, RayCaster* shadows, Vec3& direction) const {
    const float r2 = direction_from(s.point, direction);
    const float cosine = dot(s.shading, direction);
    if (cosine <= 0.0f || dot(s.geometric, direction) <= 0.0f) return {0, 0, 0};
    const Vec3 origin = s.point + s.geometric * SURFACE_OFFSET;
    const float length = std::sqrt(r2) * (1.0f - 1e-5f) - SURFACE_OFFSET;
    if (shadows && shadows->occluded(origin, direction, length)) return {0, 0, 0};
    return intensity_ * (emission(direction) * cosine / r2);
  }

  Vec3 irradiance(const Surface& s, RayCaster* shadows) const {
    Vec3 unused;
    return irradiance(s, shadows, unused);
  }

  // Irradiance without shadows and without fine relief.
  Vec3 unshadowed(const Surface& s) const {
    Vec3 direction;
    const float r2 = direction_from(s.point, direction);
    const float cosine = dot(s.smooth, direction);
    if (cosine <= 0.0f || dot(s.geometric, direction) <= 0.0f) return {0, 0, 0};
    return intensity_ * (emission(direction) * cosine / r2);
  }

  // Radiance towards `o` by the lamp itself, from a base of albedo `rho` under the material's coat (`coat.h`).
  Vec3 direct_light(const WallMaterial& material, const Surface& s, const TangentFrame& frame, Vec3 o, Vec3 rho,
                    RayCaster* shadows) const {
    Vec3 direction;
    const Vec3 received = irradiance(s, shadows, direction);
    if (!(received.x + received.y + received.z > 0.0f)) return {0, 0, 0};
    if (!material.coated()) return received * rho * (1.0f / PI);
    const float e = material.coat().albedo(s.alpha, o.z);
    const float mirrored = material.coat().value(o, frame.local(direction), s.alpha);
    return received * (rho * ((1.0f - e) / PI) + Vec3{mirrored, mirrored, mirrored});
  }

 private:
  // Least squared distance of the falloff, in mm^2 (a hundredth of a millimetre): keeps it finite at the lamp.
  static constexpr float NEAREST2 = 1e-4f;

  Vec3 position_, intensity_, axis_;
  float exponent_;
};

}  // namespace respire
