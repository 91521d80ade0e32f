#include "cpp/trace/wall_material.h"

#include "cpp/common/float_mode.h"
#include "cpp/common/isa.h"
#include "cpp/common/require.h"

namespace respire {

WallMaterial::WallMaterial(const MaterialSettings& settings, const TracedMesh& rest,
                           rust::Slice<const RestVertex> vertices)
    : settings_(settings),
      albedo_(load(settings.albedo.data())),
      extinction_(load(settings.extinction.data())),
      scattering_(load(settings.scattering.data())),
      lamp_side_{from_lamp_side(albedo_.x), from_lamp_side(albedo_.y), from_lamp_side(albedo_.z)},
      look_{settings.vessels,         settings.blotches, settings.relief, settings.film,        settings.rings,
            settings.ring_spacing_mm, settings.folds,    settings.spurs,  settings.anthracosis, settings.seed},
      noise_(noise_kernel(widest_isa())) {
  require(vertices.size() == rest.vertex_count(), "one record of the rest shape per vertex");
  for (const RestVertex& vertex : vertices) {
    generations_.push_back(vertex.generation);
    axial_mm_.push_back(vertex.axial_mm);
    section_mm_.insert(section_mm_.end(), vertex.section_mm.begin(), vertex.section_mm.end());
    ridge_.push_back(vertex.ridge_per_mm);
  }
  if (coated()) {
    coat_ = Coat(settings.alpha_low, settings.alpha_high, settings.ior);
    wide_coat_ = Coat(WIDE_ALPHA, WIDE_ALPHA, settings.ior);
    // Integral of 2 E(cos) cos dcos by the midpoint rule.
    constexpr int STEPS = 64;
    for (int k = 0; k < STEPS; ++k) {
      const float cosine = (static_cast<float>(k) + 0.5f) / STEPS;
      mean_coat_ += coat_.albedo(mean_alpha(), cosine) * cosine * (2.0f / STEPS);
    }
  }
  if (!mucosa()) return;
  FloatMode mode;
  for (std::uint32_t v = 0; v < rest.vertex_count(); ++v) {
    const Vec3 p = rest.position(v);
    rest_.insert(rest_.end(), {p.x, p.y, p.z});
  }
  bend_and_fade_rings(rest);
  lay_folds(rest);
  bake_vertex_albedo(rest);
}

// One noise shifts the rings along the airway, by up to the fraction `SHIFT` of their spacing; another scales their
// height. None of the numbers is a measurement.
void WallMaterial::bend_and_fade_rings(const TracedMesh& rest) {
  constexpr float SHIFT_PERIOD_MM = 9.0f, SHIFT = 0.22f, HEIGHT_PERIOD_MM = 6.0f;
  ring_weight_.assign(rest.vertex_count(), 0.0f);
  for (std::size_t v = 0; v < ring_weight_.size(); ++v) {
    const Vec3 p = load(&rest_[3 * v]);
    axial_mm_[v] +=
        SHIFT * look_.ring_spacing_mm * gradient_noise(noise_, p * (1.0f / SHIFT_PERIOD_MM), look_.seed + 8);
    const float fade = gradient_noise(noise_, p * (1.0f / HEIGHT_PERIOD_MM), look_.seed + 9);
    ring_weight_[v] =
        ring_weight(generations_[v], load(rest.normals() + 3 * v)) * clamp(0.85f + 0.5f * fade, 0.0f, 1.2f);
  }
  if (look_.rings > 0.0f) {
    for (float weight : ring_weight_) ring_height_.push_back(RING_HEIGHT_MM * look_.rings * weight);
  }
}

// Folds run along the airway: their coordinates are the place in the cross-section, and a little of the distance along
// it, so that a fold ends after some periods. None of the numbers is a measurement.
void WallMaterial::lay_folds(const TracedMesh& rest) {
  if (look_.folds <= 0.0f) return;
  constexpr float PERIOD_MM = 2.8f, STRETCH = 9.0f;
  for (std::size_t v = 0; v < generations_.size(); ++v) {
    const Vec3 section = load(&section_mm_[3 * v]);
    const Vec3 along = {0.0f, 0.0f, axial_mm_[v] * (1.0f / STRETCH)};
    fold_height_.push_back(look_.folds * FOLD_HEIGHT_MM * fold_weight(generations_[v], load(rest.normals() + 3 * v)));
    const Vec3 place = (section + along) * (1.0f / PERIOD_MM);
    fold_place_.insert(fold_place_.end(), {place.x, place.y, place.z});
  }
}

// Area-weighted means over the faces around every vertex, each face's colour taken near the vertex.
void WallMaterial::bake_vertex_albedo(const TracedMesh& rest) {
  vertex_albedo_.assign(3 * rest.vertex_count(), 0.0f);
  std::vector<float> weights(rest.vertex_count(), 0.0f);
  for (std::uint32_t f = 0; f < rest.face_count(); ++f) {
    const std::uint32_t* face = rest.corners(f);
    Vec3 corner[3];
    for (int k = 0; k < 3; ++k) corner[k] = load(&rest_[3ull * face[k]]);
    Vec3 normal = cross(corner[1] - corner[0], corner[2] - corner[0]);
    float area = length(normal);
    for (int k = 0; k < 3; ++k) {
      std::uint32_t v = face[k];
      Vec3 p = corner[k] * (2.0f / 3.0f) + (corner[(k + 1) % 3] + corner[(k + 2) % 3]) * (1.0f / 6.0f);
      const RestPoint point = {p,   unit_or_zero(normal), axial_mm_[v], ring_weight_[v], generations_[v], ridge_[v],
                               0.0f};
      const MucosaPoint m = mucosa_at(noise_, look_, albedo_, point, 0.0f);
      store(&vertex_albedo_[3ull * v], load(&vertex_albedo_[3ull * v]) + m.albedo * area);
      weights[v] += area;
    }
  }
  for (std::size_t v = 0; v < weights.size(); ++v) {
    if (weights[v] > 0.0f) store(&vertex_albedo_[3 * v], load(&vertex_albedo_[3 * v]) * (1.0f / weights[v]));
  }
}

}  // namespace respire
