#pragma once
// What the wall is made of: the case's settings, the tables that follow from them, and the part of the look that is
// fixed at the rest shape's vertices (`cpp/trace/mucosa.h` has the look itself).
//
// Later bounces use the mean colour around each vertex: the next scattering blurs their light anyway. Rings of real
// airways are neither evenly spaced nor of one height: slow noise bends and fades them.

#include <vector>

#include "cpp/trace/coat.h"
#include "cpp/trace/mucosa.h"
#include "cpp/trace/sampler.h"
#include "cpp/trace/scatter_walk.h"
#include "cpp/trace/traced_mesh.h"
#include "cpp/trace/vector.h"
#include "respire-bench/src/ffi/trace/tracer.rs.h"
#include "rust/cxx.h"

namespace respire {

// Roughness of the coat's lobe between walls: a narrow one would be all noise with few rays per face, a wide one sends
// light back that a coat sends on (0.3: films up to .4 % too bright, 0.2: half of that).
constexpr float WIDE_ALPHA = 0.2f;

// Assumed share of the indirect light that reaches the coat from about the lamp's direction; the rest is taken as uniform
// over all directions. Light keeps its side for a bounce, and of all bounces between walls of albedo a the first is the
// share 1 - a. A constant would send the light of bright walls away down the airway: at .97 a tenth of it was lost.
inline float from_lamp_side(float albedo) {
  constexpr float DARK = 0.65f, OF_DARK = 0.5f;
  return albedo <= DARK ? OF_DARK : OF_DARK * (1.0f - albedo) / (1.0f - DARK);
}

class WallMaterial {
 public:
  // `rest`: the mesh as it is at rest; one record per vertex.
  WallMaterial(const MaterialSettings& settings, const TracedMesh& rest, rust::Slice<const RestVertex> vertices);

  bool mucosa() const { return settings_.mucosa; }
  bool coated() const { return settings_.coated; }
  SubsurfaceKind subsurface() const { return settings_.subsurface; }
  // Light scatters in the wall at every vertex of a path instead of the first alone.
  bool scatters_at_every_vertex() const { return settings_.walk_at_every_vertex; }
  // A flat wall of this medium sends back what `flat_albedo` says.
  bool has_flat_albedo() const { return !settings_.fixed_scattering && settings_.refracted_entry == 0.0f; }

  const Coat& coat() const { return coat_; }
  // The coat for light between walls (WIDE_ALPHA).
  const Coat& wide_coat() const { return wide_coat_; }
  // Fraction of uniform light that the coat reflects.
  float mean_coat() const { return mean_coat_; }
  // `from_lamp_side` of each channel.
  Vec3 lamp_side() const { return lamp_side_; }
  // Mean roughness, for light between walls.
  float mean_alpha() const { return 0.5f * (settings_.alpha_low + settings_.alpha_high); }
  // Roughness for `film` from 0 (smooth film) to 1 (rough).
  float alpha(float film) const { return mix(settings_.alpha_low, settings_.alpha_high, film); }

  // Mean albedo at a point of a face, for later vertices of a path.
  Vec3 mean_albedo(const std::uint32_t* corners, float u, float v) const {
    return mucosa() ? interpolate(vertex_albedo_.data(), corners, u, v) : albedo_;
  }
  float later_alpha() const { return mucosa() ? mean_alpha() : settings_.alpha_low; }

  // The look at a point of a face from a distance at which a pixel spans `footprint_mm`; `edge1` and `edge2`: the
  // face's edges at rest, from its first corner.
  MucosaPoint look_at(const std::uint32_t* corners, float u, float v, float footprint_mm, Vec3& edge1,
                      Vec3& edge2) const {
    const float w[3] = {1.0f - u - v, u, v};
    auto scalar = [&](const std::vector<float>& values) {
      return w[0] * values[corners[0]] + w[1] * values[corners[1]] + w[2] * values[corners[2]];
    };
    const Vec3 rest0 = load(&rest_[3ull * corners[0]]);
    edge1 = load(&rest_[3ull * corners[1]]) - rest0, edge2 = load(&rest_[3ull * corners[2]]) - rest0;
    const RestPoint point = {rest0 + edge1 * u + edge2 * v,
                             unit_or_zero(cross(edge1, edge2)),
                             scalar(axial_mm_),
                             scalar(ring_weight_),
                             scalar(generations_),
                             scalar(ridge_),
                             crest_at(corners, u, v)};
    return mucosa_at(noise_, look_, albedo_, point, footprint_mm);
  }

  // Rings or folds: relief that is as wide as several faces, and bends the normal of every vertex of a path.
  bool has_coarse_relief() const { return !ring_height_.empty() || !fold_height_.empty(); }

  // How much something rises along two edges of a face, from its first corner.
  struct Rise {
    float first, second;
  };

  // The relief of cartilage rings and lengthwise folds.
  Rise coarse_rise(const std::uint32_t* corners, float w1, float w2) const {
    const Rise rings = ring_rise(corners, w1, w2), folds = fold_rise(corners, w1, w2);
    return {rings.first + folds.first, rings.second + folds.second};
  }

  // The wall below a point of diffuse albedo `albedo`.
  Medium medium(Vec3 albedo) const {
    if (settings_.fixed_scattering) return {extinction_, scattering_};
    return {
        extinction_,
        {single_scattering_albedo(albedo.x), single_scattering_albedo(albedo.y), single_scattering_albedo(albedo.z)}};
  }

  // Direction (local, downwards) in which light that leaves towards `o` travelled below the surface: by the cosine law,
  // or, for the part `refracted_entry` of the walks, refracted through a microfacet of roughness 1. False where there
  // is none.
  bool entry_direction(Vec3 o, Sampler& sampler, Vec3& local) const {
    float u, v;
    sampler.next2(u, v);
    if (settings_.refracted_entry > 0.0f && sampler.random() < settings_.refracted_entry) {
      const Vec3 h = visible_normal(o, 1.0f, u, v);
      const float eta = 1.0f / settings_.ior, cosine = dot(o, h);
      local = h * (eta * cosine - std::sqrt(std::max(0.0f, 1.0f - eta * eta * (1.0f - cosine * cosine)))) - o * eta;
      return local.z < 0.0f;
    }
    local = -cosine_direction(u, v);
    return true;
  }

 private:
  Rise ring_rise(const std::uint32_t* corners, float w1, float w2) const {
    if (ring_height_.empty()) return {0.0f, 0.0f};
    const float w0 = 1.0f - w1 - w2;
    const float height = w0 * ring_height_[corners[0]] + w1 * ring_height_[corners[1]] + w2 * ring_height_[corners[2]];
    if (height <= 0.0f) return {0.0f, 0.0f};
    const float a0 = axial_mm_[corners[0]], a1 = axial_mm_[corners[1]], a2 = axial_mm_[corners[2]];
    float slope;
    ring_profile(w0 * a0 + w1 * a1 + w2 * a2, look_.ring_spacing_mm, slope);
    return {height * slope * (a1 - a0), height * slope * (a2 - a0)};
  }

  // How near a point is to the crest of a fold, weighted by how much folding there is.
  float crest_at(const std::uint32_t* corners, float w1, float w2) const {
    if (fold_height_.empty()) return 0.0f;
    const float w0 = 1.0f - w1 - w2;
    const float weight =
        (w0 * fold_height_[corners[0]] + w1 * fold_height_[corners[1]] + w2 * fold_height_[corners[2]]) /
        FOLD_HEIGHT_MM;
    if (weight <= 0.0f) return 0.0f;
    const Vec3 q = load(&fold_place_[3ull * corners[0]]) * w0 + load(&fold_place_[3ull * corners[1]]) * w1 +
                   load(&fold_place_[3ull * corners[2]]) * w2;
    return weight * fold_crest(gradient_noise(noise_, q, look_.seed + 10));
  }

  // Slopes of h = height fold_profile(noise(q)), q the folds' coordinates, linear on a face.
  Rise fold_rise(const std::uint32_t* corners, float w1, float w2) const {
    if (fold_height_.empty()) return {0.0f, 0.0f};
    const float w0 = 1.0f - w1 - w2;
    const float height = w0 * fold_height_[corners[0]] + w1 * fold_height_[corners[1]] + w2 * fold_height_[corners[2]];
    if (height <= 0.0f) return {0.0f, 0.0f};
    const Vec3 q0 = load(&fold_place_[3ull * corners[0]]);
    const Vec3 first = load(&fold_place_[3ull * corners[1]]) - q0, second = load(&fold_place_[3ull * corners[2]]) - q0;
    Vec3 gradient;
    const float value = gradient_noise(noise_, q0 + first * w1 + second * w2, look_.seed + 10, gradient);
    const float slope = height * fold_slope(value);
    return {slope * dot(gradient, first), slope * dot(gradient, second)};
  }

  void bend_and_fade_rings(const TracedMesh& rest);
  void lay_folds(const TracedMesh& rest);
  void bake_vertex_albedo(const TracedMesh& rest);

  MaterialSettings settings_;
  Vec3 albedo_, extinction_, scattering_, lamp_side_;
  MucosaLook look_;
  NoiseKernel noise_;
  Coat coat_, wide_coat_;
  float mean_coat_ = 0.0f;
  // Of the rest shape, per vertex.
  std::vector<float> rest_, generations_, axial_mm_, section_mm_, ridge_, vertex_albedo_;
  // How much cartilage there is at a vertex, and the rings' height in mm (empty without rings).
  std::vector<float> ring_weight_, ring_height_;
  // The folds' height in mm and their coordinates (xyz) per vertex (empty without folds).
  std::vector<float> fold_height_, fold_place_;
};

}  // namespace respire
