#pragma once
// Light at vertices: what `src/render/vertex_light.rs` asks of faces and vertices, and camera samples that use its answer.

#include "cpp/path.h"

namespace respire {

// Per vertex: light that the base sends, over its albedo and times pi, by way of the wall (3); irradiance by other walls (3).
constexpr std::size_t kKnownValues = 6;

// Per face: the lamp's irradiance (3), what the base sends on of it (3), what is sent on to all sides alike of other light (3),
// centre (3), normal (3), what the coat mirrors of the lamp's light and of other light, over `glint`.
constexpr std::size_t kLampValues = 17;

// Between walls the coat's lobe is taken as this wide: a narrow one would be all noise with few rays per face.
constexpr float kWideAlpha = 0.3f;

// Of light that is not the lamp's the coat gets this part from about the lamp's side, the rest from all sides alike.
constexpr float kFromLampSide = 0.5f;

class VertexLight : public PathIntegrator {
 public:
  using PathIntegrator::PathIntegrator;

  // Like `camera_sample`, with the light that other walls send, and that walks in the wall, taken from the vertices:
  // `known` holds kKnownValues per vertex, negative where nothing is known. There a path is traced instead.
  void known_sample(Vec3 direction, const Hit* hit, rust::Slice<const float> known, Sampler& sampler, float* film) {
    ++counters.paths;
    if (!hit) {
      add(film, background_);
      return;
    }
    const Surface s = camera_surface(*hit, direction);
    const Frame frame(s.shading);
    const Vec3 o = upper(frame.local(-direction));
    const bool walked = tracer_.subsurface_ == Subsurface::kDiffuse;
    const Vec3 direct = direct_light(s, frame, o, !frame_.light_at_camera, walked ? Vec3{0, 0, 0} : s.albedo);
    Vec3 base{}, mirrored{}, light;
    if (known_light(known, *hit, walked ? 0 : 3, light)) {
      const float share = tracer_.coated_ ? 1.0f - tracer_.coat_.albedo(s.alpha, o.z) : 1.0f;
      base = light * (share * (1.0f / kPi));
      if (tracer_.coated_ && limit_ > 1) mirrored = known_mirrored(s, frame, o, known, sampler);
    } else if (walked) {
      scattered_light(s, frame, o, sampler, base, mirrored);
    } else if (limit_ > 1) {
      indirect_light(s, frame, o, sampler, base, mirrored);
    }
    record(s, direct, base, mirrored, film);
  }

  // What the lamp does to a face as a whole, at its centre (kLampValues).
  void lamp(std::uint32_t face, float* values) {
    const Surface s = face_surface(face, 1.0f / 3.0f, 1.0f / 3.0f);
    const Vec3 received = irradiance(s, true);
    const float e = tracer_.mean_coat_;
    store(values, received);
    store(values + 3, received * s.albedo * (1.0f - e));
    const float even = e * (1.0f - kFromLampSide);
    store(values + 6, s.albedo * (1.0f - e) + Vec3{even, even, even});
    store(values + 9, s.point);
    store(values + 12, s.shading);
    values[15] = values[16] = 0.0f;
    if (!tracer_.coated_) return;
    // As much as the coat sends back, through the wider lobe.
    const float cosine = std::max(dot(s.shading, normalize(light_ - s.point)), 0.0f);
    const float wide = std::max(tracer_.wide_coat_.albedo(kWideAlpha, cosine), 1e-6f);
    values[15] = tracer_.coat_.albedo(s.alpha, cosine) / wide;
    values[16] = e * kFromLampSide / wide;
  }

  // What the coat of a face sends towards `to` of light that comes from the lamp's side: radiance times pi over what it gets
  // there. `from`: its kLampValues.
  float glint(Vec3 to, const float* from) const {
    const Vec3 point = load(from + 9), way = to - point;
    const float l2 = dot(way, way);
    if (!(l2 > 0.0f)) return 0.0f;
    const Frame frame(load(from + 12));
    const Vec3 o = frame.local(way * (1.0f / std::sqrt(l2))), i = frame.local(normalize(light_ - point));
    return kPi * tracer_.wide_coat_.value(o, i, kWideAlpha);
  }

  // Faces that `count` rays meet which leave a face after the cosine law; kNothing for what leaves the mesh. The rays
  // lie on the tissue and not in space: what noise they leave moves with the wall and does not flicker.
  void gather(std::uint32_t face, std::uint32_t count, std::uint32_t* hits) {
    const std::uint32_t key = hash32(face ^ frame_.pattern_key);
    for (std::uint32_t k = 0; k < count; ++k) {
      Sampler sampler(key, k);
      float u, v, a, b;
      sampler.next2(u, v);
      sampler.next2(a, b);
      // Uniform over the triangle.
      const float root = std::sqrt(a);
      const Surface s = face_surface(face, root * (1.0f - b), root * b);
      const Vec3 direction = tissue_frame(face, s.shading).world(cosine_direction(u, v));
      Hit hit;
      const bool leaves = dot(direction, s.geometric) > 0.0f;
      hits[k] = leaves && intersect(s.point + s.geometric * kOffset, direction, hit) ? hit.face : kNothing;
    }
  }

  // Where a walk comes out that starts in `face`, the more likely the nearer to its vertex `corner` (linearly), and what is
  // left of its light over the albedo there. False where nothing comes out.
  bool walk_from(std::uint32_t face, std::uint32_t corner, Sampler& sampler, std::uint32_t& exit, Vec3& weight) {
    // The middle one of three.
    const float a = sampler.random(), b = sampler.random(), c = sampler.random();
    const float own = std::max(std::min(a, b), std::min(std::max(a, b), c));
    const float split = sampler.random();
    float w[3];
    w[corner] = own, w[(corner + 1) % 3] = (1.0f - own) * split, w[(corner + 2) % 3] = (1.0f - own) * (1.0f - split);
    const Surface s = face_surface(face, w[1], w[2]);
    const Medium medium = tracer_.medium(s.albedo);
    const RandomWalk walk(tracer_.fast_, medium, counters.rays);
    const Frame entry(s.geometric);
    Vec3 local, throughput, point = s.point;
    // The view is not known: a refracted entry is taken as seen from all sides alike.
    if (!entry_direction(cosine_direction(sampler.random(), sampler.random()), sampler, local)) return false;
    Vec3 inwards = entry.world(local);
    Hit hit;
    if (!walk.leave(point, inwards, sampler, throughput, hit)) return false;
    exit = hit.face;
    weight = over(throughput, s.albedo);
    return true;
  }

 private:
  // Interpolates what is known at the face's vertices, from `offset` on; vertices of which nothing is known leave
  // their part to the others.
  bool known_light(rust::Slice<const float> known, const Hit& hit, std::size_t offset, Vec3& light) const {
    const std::uint32_t* corners = tracer_.faces_ + 3ull * hit.face;
    const float w[3] = {1.0f - hit.u - hit.v, hit.u, hit.v};
    float total = 0.0f;
    light = {0, 0, 0};
    for (int k = 0; k < 3; ++k) {
      const float* value = known.data() + kKnownValues * corners[k];
      if (value[offset] < 0.0f) continue;
      light += load(value + offset) * w[k];
      total += w[k];
    }
    if (!(total > 0.05f)) return false;
    light = light * (1.0f / total);
    return true;
  }

  // One sample of what the coat mirrors, with light of more than one scattering from the vertices.
  Vec3 known_mirrored(const Surface& s, const Frame& frame, Vec3 o, rust::Slice<const float> known, Sampler& sampler) {
    Vec3 direction;
    float weight;
    if (!mirrored_direction(s, frame, o, sampler, direction, weight)) return {0, 0, 0};
    const Vec3 from = s.point + s.geometric * kOffset;
    Hit hit;
    if (!intersect(from, direction, hit)) return background_ * weight;
    // What no ray from a seen face has met in four generations hardly gets light by way of walls.
    Vec3 light;
    if (!known_light(known, hit, 3, light)) light = {0, 0, 0};
    const Surface met = surface(hit, from, direction);
    // Glare in a mirror would be all noise: the coat met there is taken as diffuse.
    const float e = tracer_.mean_coat_;
    const Vec3 received = irradiance(met, true) * lamp_reflectance(met) + light * (met.albedo * (1.0f - e) + Vec3{e, e, e});
    return received * (weight / kPi);
  }
};

}  // namespace respire
