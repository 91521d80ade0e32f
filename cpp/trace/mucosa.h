#pragma once
// The look of the airway wall, a pure function of the point on the *rest* shape, so that it moves with the tissue:
// blotchy colour, three generations of vessels, patches of soot, pale ridges, mucus film of varying roughness, fine relief.
// Vessels are the edges of a warped three-dimensional Voronoi diagram cut by the surface (their junctions have three
// arms, as vessels have), each edge with its own calibre, many of them absent. Colours: pale pink to red as the blood
// volume rises; nothing here is a measurement.

#include <cmath>
#include <cstdint>

#include "cpp/trace/noise.h"
#include "cpp/trace/sampler.h"
#include "cpp/trace/vector.h"

namespace respire {

// Strengths; 1 is the usual airway, 0 switches a feature off.
struct MucosaLook {
  float vessels, blotches, relief, film, rings, ring_spacing_mm, folds, spurs, anthracosis;
  std::uint32_t seed;
};

// The wall's appearance at one point. `height_gradient` is that of the relief in rest space, dimensionless.
struct MucosaPoint {
  Vec3 albedo;
  float roughness;  // 0 smooth film .. 1 rough
  Vec3 height_gradient;
  // Mean square slope (per axis) of relief too fine to be seen from there.
  float unseen_slope2;
};

// Gradient noise in about [-1, 1] and its gradient; period of a feature is about 1.
inline float gradient_noise(const NoiseKernel& noise, Vec3 p, std::uint32_t seed, Vec3& gradient) {
  const Noise n = noise.gradient(&p.x, seed);
  gradient = load(n.gradient);
  return n.value;
}

inline float gradient_noise(const NoiseKernel& noise, Vec3 p, std::uint32_t seed) {
  return noise.gradient(&p.x, seed).value;
}

// Distance from `p` to the nearest face of the Voronoi diagram of one jittered point per unit cell, measured along a
// surface of unit normal `normal` through `p`. `steepness` is 1 for a face upright on the surface and 0 for one along
// it, which counts as far away: it would show as a patch, not as a line. `edge_hash` names the two cells that meet
// there, whichever of them holds `p`.
inline float voronoi_edge(const NoiseKernel& noise, Vec3 p, Vec3 normal, std::uint32_t seed, std::uint32_t& edge_hash,
                          float& steepness) {
  const Neighbours next = noise.neighbours(&p.x, seed);
  edge_hash = hash32(next.cell[0] ^ next.cell[1]);
  Vec3 across = load(next.place[1]) - load(next.place[0]);
  float l2 = dot(across, across) + 1e-12f, along = dot(across, normal);
  float in_surface = std::max(1.0f - along * along / l2, 0.0f);
  steepness = in_surface;
  return (next.distance2[1] - next.distance2[0]) / (2.0f * std::sqrt(l2 * in_surface * in_surface) + 1e-6f);
}

// One generation of vessels: spacing, width of the widest, fraction of them that is absent.
struct VesselNet {
  float spacing_mm, width_mm, absent;
  std::uint32_t seed;
};

// Coverage in [0, 1] by a net of vessels. `footprint_mm` is the size of a pixel: thinner vessels fade instead of
// flickering.
inline float vessel_coverage(const NoiseKernel& noise, Vec3 rest_mm, Vec3 normal, const VesselNet& net,
                             float footprint_mm) {
  if (footprint_mm > 0.5f * net.spacing_mm) return 0.0f;
  std::uint32_t edge;
  float steepness;
  float distance =
      voronoi_edge(noise, rest_mm * (1.0f / net.spacing_mm), normal, net.seed, edge, steepness) * net.spacing_mm;
  float u = unit_float(edge);
  if (u < net.absent) return 0.0f;
  float half = 0.5f * net.width_mm * mix(0.35f, 1.0f, (u - net.absent) / (1.0f - net.absent));
  // Vessels lie below a translucent layer: soft borders.
  float soft = 0.7f * half + 0.5f * footprint_mm;
  float coverage = 1.0f - smoothstep(half - 0.6f * soft, half + soft, distance);
  return coverage * std::min(1.0f, half / (0.5f * footprint_mm + 1e-6f)) * smoothstep(0.25f, 0.6f, steepness);
}

// Height of the cartilage rings at full strength; like all numbers of the look, no measurement.
constexpr float RING_HEIGHT_MM = 0.45f;

// Cartilage: full in trachea and main bronchi, gone from generation 4 on.
// The back wall of trachea and main bronchi is a membrane without it: LPS, y to the back, `rest_normal` into the lumen.
inline float ring_weight(float generation, Vec3 rest_normal) {
  const float membrane = smoothstep(0.4f, 0.8f, -rest_normal.y) * (1.0f - smoothstep(1.0f, 2.2f, generation));
  return (1.0f - smoothstep(1.2f, 4.0f, generation)) * (1.0f - membrane);
}

// The cartilage rings' profile over the distance along the airway: pale bulge, flat gap. Value in [0, 1] and slope per
// mm.
inline float ring_profile(float axial_mm, float spacing_mm, float& slope) {
  float turns = axial_mm / spacing_mm;
  turns -= std::floor(turns);
  float c, s;
  cos_sin_turns(turns, c, s);
  slope = s * PI / spacing_mm;
  return 0.5f - 0.5f * c;
}

// Height of the lengthwise folds at full strength, from hollow to crest.
constexpr float FOLD_HEIGHT_MM = 1.2f;

// Folds: on the membranous back wall of trachea and main bronchi, and, lower, all around in small airways.
inline float fold_weight(float generation, Vec3 rest_normal) {
  const float back = smoothstep(0.2f, 0.7f, -rest_normal.y) * (1.0f - smoothstep(1.0f, 2.2f, generation));
  return std::max(back, 0.55f * smoothstep(1.5f, 3.5f, generation));
}

// The folds' profile over the noise n: -sqrt(n^2 + s^2), narrow crests between wide hollows. Its slope, and how near a
// point is to a crest, from 0 to 1.
inline float fold_slope(float value) { return -value / std::sqrt(value * value + 0.01f); }
inline float fold_crest(float value) { return clamp(1.25f - 2.5f * std::sqrt(value * value + 0.01f), 0.0f, 1.0f); }

// A point of the rest shape: where it is, the normal there, the distance along the airway, how much cartilage there is
// (1 in the trachea, 0 in small airways), the generation of the airway, the curvature of a ridge, and how near a point is
// to the crest of a fold (0 to 1).
struct RestPoint {
  Vec3 place_mm, normal;
  float axial_mm, ring_weight, generation, ridge_per_mm, crest;
};

// The look at a point; `base` is the mean albedo, `footprint_mm` the size of a pixel there. Leaves the rings' relief to
// the caller, who knows the axial gradient. Every seed + k gives an independent noise.
inline MucosaPoint mucosa_at(const NoiseKernel& noise, const MucosaLook& look, Vec3 base, const RestPoint& point,
                             float footprint_mm) {
  const Vec3 rest_mm = point.place_mm;
  MucosaPoint out;
  // Two slow noises: patches of colour, and the bending of the vessels.
  Vec3 warp_gradient;
  float coarse = gradient_noise(noise, rest_mm * (1.0f / 7.0f), look.seed + 1, warp_gradient);
  Vec3 fine_gradient;
  float medium = gradient_noise(noise, rest_mm * (1.0f / 2.6f), look.seed + 2, fine_gradient);
  // Gradients bend the Voronoi diagram's straight edges.
  Vec3 warped = rest_mm + warp_gradient * 0.8f + fine_gradient * 0.35f;

  // Blood volume: more is redder and darker.
  float blood = look.blotches * (0.55f * coarse + 0.5f * medium) + 0.03f * std::min(point.generation, 8.0f);
  float vessel = 0.0f;
  if (look.vessels > 0.0f) {
    // Vessels are finer in smaller airways, where the scope is also closer to the wall.
    float calibre = mix(1.0f, 0.5f, clamp(0.25f * point.generation, 0.0f, 1.0f));
    float large =
        vessel_coverage(noise, warped, point.normal, {3.6f, 0.22f * calibre, 0.4f, look.seed + 3}, footprint_mm);
    float small =
        vessel_coverage(noise, warped, point.normal, {1.3f, 0.12f * calibre, 0.3f, look.seed + 4}, footprint_mm);
    float capillaries =
        vessel_coverage(noise, warped, point.normal, {0.62f, 0.06f, 0.15f, look.seed + 11}, footprint_mm);
    vessel = look.vessels * std::max(std::max(large, 0.7f * small), 0.5f * capillaries);
  }
  // Albedo: pale over cartilage, red and dark with blood.
  float slope, ring = ring_profile(point.axial_mm, look.ring_spacing_mm, slope);
  // Mucosa that is drawn over an edge has little blood.
  float edge = look.spurs * smoothstep(0.08f, 0.3f, point.ridge_per_mm);
  float pale = look.rings * point.ring_weight * ring * 0.9f + 0.8f * edge + 0.9f * point.crest;
  float depth = clamp(1.0f + 0.75f * blood - 0.8f * pale, 0.25f, 2.5f);
  // Beer-Lambert-like: albedo falls with blood, in green and blue three times as fast as in red.
  auto fade = [](float rate) { return 1.0f / (1.0f + rate); };
  float red = fade(0.16f * depth) * 1.16f, green = fade(0.5f * depth) * 1.5f, blue = fade(0.46f * depth) * 1.46f;
  out.albedo = base * Vec3{red, green, blue};
  out.albedo = out.albedo * Vec3{1.0f - 0.14f * std::min(vessel, 1.3f), 1.0f - 0.38f * std::min(vessel, 1.3f),
                                 1.0f - 0.34f * std::min(vessel, 1.3f)};
  if (look.anthracosis > 0.0f) {
    // Soot below the mucosa: patches of some millimetres with ragged borders, black to slate.
    float patch = gradient_noise(noise, rest_mm * (1.0f / 6.0f), look.seed + 12) +
                  0.4f * gradient_noise(noise, rest_mm * (1.0f / 1.1f), look.seed + 13);
    float soot = std::min(look.anthracosis * smoothstep(0.1f, 0.8f, patch), 1.0f);
    out.albedo = out.albedo * Vec3{1.0f - 0.68f * soot, 1.0f - 0.62f * soot, 1.0f - 0.56f * soot};
  }
  out.albedo = {clamp(out.albedo.x, 0.02f, 0.95f), clamp(out.albedo.y, 0.02f, 0.95f),
                clamp(out.albedo.z, 0.02f, 0.95f)};

  // Film and fine relief; what is finer than a pixel fades.
  Vec3 g1, g2;
  float wet = gradient_noise(noise, rest_mm * (1.0f / 3.7f), look.seed + 5);
  out.roughness = clamp(0.4f + look.film * 0.9f * wet, 0.0f, 1.0f);
  gradient_noise(noise, rest_mm * (1.0f / 1.3f), look.seed + 6, g1);
  gradient_noise(noise, rest_mm * (1.0f / 0.55f), look.seed + 7, g2);
  float fade1 = clamp(1.5f - footprint_mm / 0.65f, 0.0f, 1.0f), fade2 = clamp(1.5f - footprint_mm / 0.27f, 0.0f, 1.0f);
  // Amplitude over period: slopes of about 0.1.
  out.height_gradient = g1 * (look.relief * fade1 * 0.10f) + g2 * (look.relief * fade2 * 0.06f);
  // The noise's gradient has a mean square of about 1 per axis.
  const float lost1 = look.relief * (1.0f - fade1) * 0.10f, lost2 = look.relief * (1.0f - fade2) * 0.06f;
  out.unseen_slope2 = lost1 * lost1 + lost2 * lost2;
  return out;
}

}  // namespace respire
