#pragma once
// A scatter walk, the random walk of light in the wall: a homogeneous medium with isotropic scattering below the
// surface, its extinction sigma and single-scattering albedo a different for red, green and blue. One free flight from
// x along w:
//   channel c with probability p_c = T_c a_c / sum(T a)           T throughput, of which a_c is what would scatter on
//   distance t = -ln(1 - u) / sigma_c
//   T <- T exp(-sigma t) sigma / sum_c(p_c exp(-sigma_c t) sigma_c)     scattered in the medium (then T <- T a)
//   T <- T exp(-sigma s) / sum_c(p_c exp(-sigma_c s))                   at the surface after s < t
//
// So distances are drawn for one channel, chosen by what each channel would carry on, and weighted by the balance
// heuristic over the three (Wrenninge, Villemin, Hery 2017, "Path traced subsurface scattering using anisotropic phase
// functions and non-exponential free flights"; with three different extinctions a single channel's density gives
// unbounded weights). The single-scattering albedo that makes a half-space of diffuse albedo A is van de Hulst's
// (Multiple Light Scattering, 1980), inverted. Roulette starts where throughput is low: survival = throughput /
// ROULETTE_BELOW, never capped. Left out: anisotropic phase functions (use reduced coefficients), guiding (Dwivedi's
// saves 6 to 13 % here: the red albedo is too close to 1).

#include <cmath>
#include <cstdint>

#include "cpp/trace/sampler.h"
#include "cpp/trace/traced_mesh.h"
#include "cpp/trace/vector.h"

namespace respire {

// Extinction per mm and single-scattering albedo.
struct Medium {
  Vec3 extinction, albedo;
};

// A half-space of the single-scattering albedo `a` sends back the part `rho` of diffuse light:
//   a = 1 - s^2, s = 4.09712 + 4.20863 rho - sqrt(9.59217 + 41.6808 rho + 17.7126 rho^2)
inline float single_scattering_albedo(float rho) {
  const float s = 4.09712f + 4.20863f * rho - std::sqrt(9.59217f + 41.6808f * rho + 17.7126f * rho * rho);
  const float positive = std::max(s, 0.0f);
  return clamp(1.0f - positive * positive, 0.0f, 1.0f);
}

// True diffuse albedo of a half-space with the albedo that this inversion gives: Chandrasekhar's 1 - 2 sqrt(1 - albedo)
// (first moment of H), fitted to 4e-4 of it.
inline float flat_albedo(float rho) { return rho * (1.0f + 0.031f * std::exp(-5.6f * rho)); }

inline Vec3 attenuation(Vec3 extinction, float distance) {
  return {exp_minus(extinction.x * distance), exp_minus(extinction.y * distance), exp_minus(extinction.z * distance)};
}

class ScatterWalk {
 public:
  enum class Step { SCATTERED, SURFACE, ABSORBED };

  // A flight from the surface starts this far below it, in mm, like a ray in the lumen above it.
  static constexpr float START = SURFACE_OFFSET;

  // Inside a mesh; `rays` counts the rays.
  ScatterWalk(const TracedMesh& mesh, const Medium& medium, std::uint64_t& rays)
      : mesh_(&mesh), medium_(medium), rays_(&rays) {}

  // Below a flat surface through `point` with unit `normal` instead of a mesh.
  ScatterWalk(Vec3 point, Vec3 normal, const Medium& medium) : point_(point), normal_(normal), medium_(medium) {}

  // Where a flight goes, and what it carries.
  struct Flight {
    Vec3 point, direction, throughput;
  };

  // One free flight; moves the point and multiplies the throughput, which includes the albedo where the flight ends in
  // a scattering. `hit` is set where it ends at the surface. `near`: where the ray starts. `stratified`: draws numbers
  // stratified over the samples of a pixel or vertex, which pays for the first flights.
  Step fly(Flight& flight, float near, Sampler& sampler, Hit& hit, bool stratified = false) const {
    Draw draw;
    if (!drawn(flight, sampler, stratified, draw)) return Step::ABSORBED;
    const bool surface = reaches(flight.point, flight.direction, near, draw.free, hit);
    return end(flight, draw, surface, hit);
  }

  // Walks from the surface point `flight.point` into the wall along `flight.direction` until the light comes out again.
  // On true, `flight` and `hit` hold the exit and the throughput, which starts at 1.
  bool leave(Flight& flight, Sampler& sampler, Hit& hit) const {
    flight.throughput = {1, 1, 1};
    return leave_after(0, flight, sampler, hit);
  }

  // Whether each of two walks comes out.
  struct Left {
    bool here, there;
  };

  // The same with a second walk from the same point, in the same medium and with the same random numbers, below another
  // surface. Until one of them comes out they are one walk, and cost one. `flight_there` ends as `flight` does.
  Left leave_both(const ScatterWalk& there, Flight& flight, Flight& flight_there, Sampler& sampler, Hit& hit) const {
    flight.throughput = {1, 1, 1};
    for (int step = 0; step < LONGEST; ++step) {
      const bool stratified = step < STRATIFIED_STEPS;
      Draw draw;
      if (!drawn(flight, sampler, stratified, draw)) return {false, false};
      Hit hit_there;
      const bool here_ends = reaches(flight.point, flight.direction, near_of(step), draw.free, hit);
      const bool there_ends = there.reaches(flight.point, flight.direction, near_of(step), draw.free, hit_there);
      if (here_ends || there_ends) {
        flight_there = flight;
        Sampler same = sampler;
        return {leave_with(draw, here_ends, step, flight, sampler, hit),
                there.leave_with(draw, there_ends, step, flight_there, same, hit_there)};
      }
      if (end(flight, draw, false, hit) == Step::ABSORBED || !turns(flight, sampler, stratified)) return {false, false};
    }
    return {false, false};
  }

  // Roulette: survives with the probability throughput / ROULETTE_BELOW.
  static bool survives(Vec3& throughput, Sampler& sampler) {
    const float survival = max_component(throughput) * (1.0f / ROULETTE_BELOW);
    if (survival >= 1.0f) return true;
    if (sampler.random() >= survival) return false;
    throughput = throughput * (1.0f / survival);
    return true;
  }

  // Whether the surface lies between `near` and `far` along the ray; where the first such point is.
  bool reaches(Vec3 from, Vec3 direction, float near, float far, Hit& hit) const {
    if (!mesh_) {
      const float rise = dot(direction, normal_);
      hit.t = rise > 0.0f ? dot(point_ - from, normal_) / rise : far;
      return rise > 0.0f && hit.t >= near && hit.t < far;
    }
    ++*rays_;
    return first_hit(*mesh_, mesh_->fast(), ray_of(from, direction, near, far), hit);
  }

 private:
  // What is drawn for a flight: the probabilities of the channels, and how far it goes where no surface cuts it off.
  struct Draw {
    Vec3 choice;
    float free;
  };

  // False where no light would be scattered on.
  bool drawn(const Flight& flight, Sampler& sampler, bool stratified, Draw& draw) const {
    // Choose the channel: p_c = T_c a_c / sum(T a).
    const Vec3 carried = flight.throughput * medium_.albedo;
    const float sum = carried.x + carried.y + carried.z;
    if (!(sum > 0.0f)) return false;
    const Vec3 choice = carried * (1.0f / sum);
    float which, distance;
    if (stratified)
      sampler.next2(distance, which);
    else
      which = sampler.random(), distance = sampler.random();
    // No branch, which random numbers would mislead.
    const float extinctions[3] = {medium_.extinction.x, medium_.extinction.y, medium_.extinction.z};
    const int channel = !(which < choice.x) + !(which < choice.x + choice.y);
    // The distance t = -ln(1 - u) / sigma_c.
    draw = {choice, minus_log(1.0f - distance) / extinctions[channel]};
    return true;
  }

  // Ends a flight, at `hit` where it reaches the surface.
  Step end(Flight& flight, const Draw& draw, bool surface, const Hit& hit) const {
    const float length = surface ? hit.t : draw.free;
    // Multiply T by the value over the balance heuristic's density.
    Vec3 value = attenuation(medium_.extinction, length);
    if (!surface) value = value * medium_.extinction;
    const float density = dot(draw.choice, value);
    if (!(density > 0.0f)) return Step::ABSORBED;
    flight.throughput = flight.throughput * value * (1.0f / density);
    flight.point += flight.direction * length;
    if (surface) return Step::SURFACE;
    flight.throughput = flight.throughput * medium_.albedo;
    return Step::SCATTERED;
  }

  // Whether the light goes on after a scattering, and where to.
  [[gnu::always_inline]] static bool turns(Flight& flight, Sampler& sampler, bool stratified) {
    if (!survives(flight.throughput, sampler)) return false;
    float u, v;
    if (stratified)
      sampler.next2(u, v);
    else
      u = sampler.random(), v = sampler.random();
    flight.direction = isotropic_direction(u, v);
    return true;
  }

  // `leave` from flight number `step` on.
  bool leave_after(int step, Flight& flight, Sampler& sampler, Hit& hit) const {
    for (; step < LONGEST; ++step) {
      const bool stratified = step < STRATIFIED_STEPS;
      const Step outcome = fly(flight, near_of(step), sampler, hit, stratified);
      if (outcome == Step::SURFACE) return true;
      if (outcome == Step::ABSORBED || !turns(flight, sampler, stratified)) return false;
    }
    return false;
  }

  // `leave` from the end of flight number `step` on.
  bool leave_with(const Draw& draw, bool surface, int step, Flight& flight, Sampler& sampler, Hit& hit) const {
    const Step outcome = end(flight, draw, surface, hit);
    if (outcome == Step::SURFACE) return true;
    if (outcome == Step::ABSORBED || !turns(flight, sampler, step < STRATIFIED_STEPS)) return false;
    return leave_after(step + 1, flight, sampler, hit);
  }

  // Where the ray of a flight starts.
  static float near_of(int step) { return step == 0 ? START : 0.0f; }

  // Throughput below which roulette starts.
  static constexpr float ROULETTE_BELOW = 0.5f;
  // The first flights, for which stratification pays; later ones use plain random numbers.
  static constexpr int STRATIFIED_STEPS = 2;
  // Flights of the longest walk: ends walks in perfectly white, closed walls.
  static constexpr int LONGEST = 1 << 16;

  const TracedMesh* mesh_ = nullptr;
  Vec3 point_{}, normal_{};
  const Medium& medium_;
  std::uint64_t* rays_ = nullptr;
};

}  // namespace respire
