#pragma once
// Random walk of light in the wall: a homogeneous medium with isotropic scattering below the surface, its extinction
// and single-scattering albedo different for red, green and blue.
//
// Distances are drawn for one channel, chosen by what each channel would carry on, and weighted by the balance
// heuristic over the three (Wrenninge, Villemin, Hery 2017, "Path traced subsurface scattering using anisotropic phase
// functions and non-exponential free flights"; with three different extinctions a single channel's density gives
// unbounded weights). The single-scattering albedo that makes a half-space of diffuse albedo A is van de Hulst's
// (Multiple Light Scattering, 1980), inverted. Roulette starts where throughput is low: survival = throughput /
// kRouletteBelow, never capped. Left out: anisotropic phase functions (use reduced coefficients), guiding (Dwivedi's
// saves 6 to 13 % here: the red albedo is too close to 1).

#include <embree4/rtcore.h>

#include <cmath>
#include <cstdint>

#include "cpp/trace/sampler.h"
#include "cpp/trace/vector.h"

namespace respire {

struct Hit {
  float t, u, v;
  std::uint32_t face;
  Vec3 geometric;  // not normalised
};

// Extinction per mm and single-scattering albedo.
struct Medium {
  Vec3 extinction, albedo;
};

// A half-space of this single-scattering albedo sends back the part `rho` of diffuse light.
inline float single_scattering_albedo(float rho) {
  const float s = 4.09712f + 4.20863f * rho - std::sqrt(9.59217f + 41.6808f * rho + 17.7126f * rho * rho);
  const float positive = std::max(s, 0.0f);
  return clamp(1.0f - positive * positive, 0.0f, 1.0f);
}

// What a half-space with the albedo that this inversion gives really sends back of diffuse light: Chandrasekhar's
// 1 - 2 sqrt(1 - albedo) (first moment of H), to 4e-4 of it by this fit.
inline float flat_albedo(float rho) { return rho * (1.0f + 0.031f * std::exp(-5.6f * rho)); }

inline Vec3 attenuation(Vec3 extinction, float distance) {
  return {exp_minus(extinction.x * distance), exp_minus(extinction.y * distance), exp_minus(extinction.z * distance)};
}

inline Vec3 isotropic_direction(float u, float v) {
  float c, s;
  cos_sin_turns(v, c, s);
  const float z = 1.0f - 2.0f * u, r = std::sqrt(std::max(0.0f, 1.0f - z * z));
  return {r * c, r * s, z};
}

class RandomWalk {
 public:
  enum class Step { kScattered, kSurface, kAbsorbed };

  RandomWalk(RTCScene scene, const Medium& medium, std::uint64_t& rays) : scene_(scene), medium_(medium), rays_(&rays) {}

  // Below a flat surface through `point` with unit `normal` instead of a mesh.
  RandomWalk(Vec3 point, Vec3 normal, const Medium& medium) : point_(point), normal_(normal), medium_(medium) {}

  // One free flight from `point` along `direction`; moves the point and multiplies `throughput`, which includes the
  // albedo where it ends in a scattering. `hit` is set where it ends at the surface. `near`: where the ray starts.
  // `stratified`: over the samples of a pixel or vertex, which pays for the first flights.
  Step flight(Vec3& point, Vec3 direction, float near, Vec3& throughput, Sampler& sampler, Hit& hit, bool stratified = false) const {
    const Vec3 carried = throughput * medium_.albedo;
    const float sum = carried.x + carried.y + carried.z;
    if (!(sum > 0.0f)) return Step::kAbsorbed;
    const Vec3 choice = carried * (1.0f / sum);
    float which, distance;
    if (stratified)
      sampler.next2(distance, which);
    else
      which = sampler.random(), distance = sampler.random();
    const float extinction = which < choice.x                ? medium_.extinction.x
                             : which < choice.x + choice.y ? medium_.extinction.y
                                                           : medium_.extinction.z;
    const float free = minus_log(1.0f - distance) / extinction;
    const bool surface = reaches(point, direction, near, free, hit);
    const float length = surface ? hit.t : free;
    Vec3 value = attenuation(medium_.extinction, length);
    if (!surface) value = value * medium_.extinction;
    const float density = dot(choice, value);
    if (!(density > 0.0f)) return Step::kAbsorbed;
    throughput = throughput * value * (1.0f / density);
    point += direction * length;
    if (surface) return Step::kSurface;
    throughput = throughput * medium_.albedo;
    return Step::kScattered;
  }

  // Walks from the surface point `point` into the wall along `direction` until it comes out again: on true `point`,
  // `direction` and `hit` say where, and `throughput` what is left.
  bool leave(Vec3& point, Vec3& direction, Sampler& sampler, Vec3& throughput, Hit& hit) const {
    throughput = {1, 1, 1};
    float near = kStart;
    for (int step = 0; step < kLongest; ++step) {
      const bool stratified = step < kStratifiedSteps;
      const Step outcome = flight(point, direction, near, throughput, sampler, hit, stratified);
      if (outcome == Step::kSurface) return true;
      if (outcome == Step::kAbsorbed || !survives(throughput, sampler)) return false;
      float u, v;
      if (stratified)
        sampler.next2(u, v);
      else
        u = sampler.random(), v = sampler.random();
      direction = isotropic_direction(u, v);
      near = 0.0f;
    }
    return false;
  }

  // Roulette.
  static bool survives(Vec3& throughput, Sampler& sampler) {
    const float survival = max_component(throughput) * (1.0f / kRouletteBelow);
    if (survival >= 1.0f) return true;
    if (sampler.random() >= survival) return false;
    throughput = throughput * (1.0f / survival);
    return true;
  }

  // A flight from the surface starts this far below it, in mm.
  static constexpr float kStart = 2e-4f;

 private:
  static constexpr float kRouletteBelow = 0.5f;
  static constexpr int kStratifiedSteps = 2;
  // Ends walks in perfectly white, closed walls.
  static constexpr int kLongest = 1 << 16;

 public:
  // Whether the surface lies between `near` and `far` along the ray; where the first such point is.
  bool reaches(Vec3 from, Vec3 direction, float near, float far, Hit& hit) const {
    if (!scene_) {
      const float rise = dot(direction, normal_);
      hit.t = rise > 0.0f ? dot(point_ - from, normal_) / rise : far;
      return rise > 0.0f && hit.t >= near && hit.t < far;
    }
    RTCRayHit r;
    r.ray.org_x = from.x, r.ray.org_y = from.y, r.ray.org_z = from.z;
    r.ray.dir_x = direction.x, r.ray.dir_y = direction.y, r.ray.dir_z = direction.z;
    r.ray.tnear = near, r.ray.tfar = far, r.ray.time = 0, r.ray.mask = ~0u, r.ray.id = 0, r.ray.flags = 0;
    r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    ++*rays_;
    rtcIntersect1(scene_, &r);
    if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;
    hit = {r.ray.tfar, r.hit.u, r.hit.v, r.hit.primID, {r.hit.Ng_x, r.hit.Ng_y, r.hit.Ng_z}};
    return true;
  }

 private:
  RTCScene scene_ = nullptr;
  Vec3 point_{}, normal_{};
  const Medium& medium_;
  std::uint64_t* rays_ = nullptr;
};

}  // namespace respire
