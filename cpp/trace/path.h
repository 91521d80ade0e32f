#pragma once
// Unidirectional path tracing with next event estimation of one point light.
//
// All noise of a scene lit from the camera is in the indirect light (the direct light of a camera-visible point is a
// closed form and needs no shadow ray), so the film keeps the two apart, and the indirect part again in what the
// Lambert base sends (demodulated by its albedo: the field that is smooth over the surface) and what the coat mirrors.
//
// Russian roulette: from its second bounce on a path survives with the probability of its throughput (the largest
// channel), never capped: a cap below the albedo would make the variance infinite in a closed lumen. (Roulette at the
// first bounce too saves 8 % of the rays and costs 60 % in median variance on the reference tube.)
// Subsurface: at the first vertex (or at every one) the base's light walks through the wall (`cpp/trace/scatter_walk.h`) and leaves it
// elsewhere. With a diffuse boundary it enters by the cosine law and leaves as from a Lambert surface of albedo 1;
// with a matched boundary the surface does not bend or reflect it at all and every scattering is lit by the lamp.

#include <cmath>

#include "cpp/trace/coat.h"
#include "cpp/trace/lamp.h"
#include "cpp/trace/sampler.h"
#include "cpp/trace/vector.h"
#include "cpp/trace/scatter_walk.h"

namespace respire {

// Sums per pixel: direct (3), indirect (3), indirect from the base over its albedo (3), indirect from the coat (3),
// albedo (3), smooth normal (3), hits (1).
constexpr std::size_t kFilmChannels = 19;

inline Vec3 cosine_direction(float u, float v) {
  float c, s;
  cos_sin_turns(v, c, s);
  const float r = std::sqrt(u);
  return {r * c, r * s, std::sqrt(1.0f - u)};
}

inline Vec3 over(Vec3 a, Vec3 b) {
  return {b.x > 0 ? a.x / b.x : 0.0f, b.y > 0 ? a.y / b.y : 0.0f, b.z > 0 ? a.z / b.z : 0.0f};
}

class PathIntegrator : public LitWall {
 public:
  PathIntegrator(const Tracer& tracer, const FrameSettings& frame)
      : LitWall(tracer, frame),
        background_{frame.background[0], frame.background[1], frame.background[2]},
        limit_(frame.max_scatterings == 0 ? unlimited(tracer) : frame.max_scatterings) {}

  // One sample through a pixel, all light traced. `hit`: what the camera ray meets, or null.
  void camera_sample(Vec3 direction, const Hit* hit, Sampler& sampler, float* film) {
    first_vertex(direction, hit, film, [&](const Surface& s, const Frame& frame, Vec3 o, Vec3& base, Vec3& mirrored) {
      traced_light(s, frame, o, direction, sampler, base, mirrored);
    });
  }

 protected:
  // Roulette ends every path long before; the bound only keeps a perfectly white closed room from running for ever.
  static constexpr std::uint32_t kLongestPath = 4096;
  // Scatterings below the surface are many more.
  static std::uint32_t unlimited(const Tracer& tracer) {
    return tracer.subsurface_ == Subsurface::kMatched ? 1u << 24 : kLongestPath;
  }

  // The camera's vertex: the lamp's own light on it, and what `indirect` (surface, frame, view, base, mirrored) finds.
  template <class Indirect>
  void first_vertex(Vec3 direction, const Hit* hit, float* film, Indirect&& indirect) {
    ++counters.paths;
    if (!hit) {
      add(film, background_);
      return;
    }
    const Surface s = camera_surface(*hit, direction);
    const Frame frame(s.shading);
    const Vec3 o = upper(frame.local(-direction));
    Vec3 direct{}, base{}, mirrored{};
    // Light that walks in the wall is found with the indirect light; a matched boundary has no coat either.
    if (tracer_.subsurface_ != Subsurface::kMatched) {
      const bool walks = tracer_.subsurface_ == Subsurface::kDiffuse;
      direct = direct_light(s, frame, o, !frame_.light_at_camera, walks ? Vec3{0, 0, 0} : s.albedo);
    }
    indirect(s, frame, o, base, mirrored);
    record(s, direct, base, mirrored, film);
  }

  // One sample of all light but the lamp's own on the first vertex.
  void traced_light(const Surface& s, const Frame& frame, Vec3 o, Vec3 direction, Sampler& sampler, Vec3& base, Vec3& mirrored) {
    switch (tracer_.subsurface_) {
      case Subsurface::kOff:
        if (limit_ > 1) indirect_light(s, frame, o, sampler, base, mirrored);
        break;
      case Subsurface::kMatched:
        base = over(matched_light(s, direction, sampler), s.albedo);
        break;
      case Subsurface::kDiffuse:
        scattered_light(s, frame, o, sampler, base, mirrored);
    }
  }

  // Adds what one sample has found; a sample that cannot be is counted and left out.
  void record(const Surface& s, Vec3 direct, Vec3 base, Vec3 mirrored, float* film) {
    const Vec3 indirect = base * s.albedo + mirrored;
    if (!valid(direct) || !valid(indirect)) {
      ++counters.rejected;
      return;
    }
    add(film, direct);
    add(film + 3, indirect);
    add(film + 6, base);
    add(film + 9, mirrored);
    add(film + 12, s.albedo);
    add(film + 15, s.smooth);
    film[18] += 1.0f;
  }

  static void add(float* film, Vec3 v) { film[0] += v.x, film[1] += v.y, film[2] += v.z; }
  static bool valid(Vec3 v) { return v.x >= 0 && v.y >= 0 && v.z >= 0 && v.x + v.y + v.z < 1e30f; }
  // The viewer is above the surface; interpolated normals may say otherwise at the silhouette.
  static Vec3 upper(Vec3 o) {
    if (o.z >= 1e-3f) return o;
    return normalize({o.x, o.y, 1e-3f});
  }

  // A direction for the next ray. `base` and `coat` are f cos / density of the two terms, the base without its albedo.
  // False where the path ends.
  bool sample_direction(const Surface& s, Vec3 o, float base_albedo, Sampler& sampler, Vec3& local, float& base, float& coat) const {
    float u, v;
    if (!tracer_.coated_) {
      sampler.next2(u, v);
      local = cosine_direction(u, v);
      base = 1.0f, coat = 0.0f;
      return true;
    }
    const float e = tracer_.coat_.albedo(s.alpha, o.z);
    const float p_coat = e / (e + (1.0f - e) * base_albedo + 1e-6f);
    const float choice = sampler.next1();
    sampler.next2(u, v);
    if (choice < p_coat) {
      const Vec3 h = visible_normal(o, s.alpha, u, v);
      local = h * (2.0f * dot(o, h)) - o;
      if (local.z <= 0.0f) return false;
    } else {
      local = cosine_direction(u, v);
    }
    const float density = p_coat * Coat::density(o, local, s.alpha) + (1.0f - p_coat) * local.z * (1.0f / kPi);
    if (!(density > 1e-12f)) return false;
    base = (1.0f - e) * (1.0f / kPi) * local.z / density;
    coat = tracer_.coat_.value(o, local, s.alpha) * local.z / density;
    return true;
  }

  // One sample of the light that reaches the camera's vertex from other walls.
  void indirect_light(const Surface& s, const Frame& frame, Vec3 o, Sampler& sampler, Vec3& base, Vec3& mirrored) {
    Vec3 local;
    float base_weight, coat_weight;
    if (!sample_direction(s, o, max_component(s.albedo), sampler, local, base_weight, coat_weight)) return;
    const Vec3 direction = frame.world(local);
    if (dot(direction, s.geometric) <= 0.0f) return;
    const Vec3 throughput = s.albedo * base_weight + Vec3{coat_weight, coat_weight, coat_weight};
    const Vec3 light = incoming(s.point + s.geometric * kOffset, direction, throughput, 2, sampler);
    base = light * base_weight;
    mirrored = light * coat_weight;
  }

  // Direction (local, downwards) in which light that leaves towards `o` walked below the surface.
  bool entry_direction(Vec3 o, Sampler& sampler, Vec3& local) const {
    float u, v;
    sampler.next2(u, v);
    if (tracer_.refracted_entry_ > 0.0f && sampler.random() < tracer_.refracted_entry_) {
      const Vec3 h = visible_normal(o, 1.0f, u, v);
      const float eta = 1.0f / tracer_.ior_, cosine = dot(o, h);
      local = h * (eta * cosine - std::sqrt(std::max(0.0f, 1.0f - eta * eta * (1.0f - cosine * cosine)))) - o * eta;
      return local.z < 0.0f;
    }
    local = -cosine_direction(u, v);
    return true;
  }

  // Walks from `at` until the light of one sample comes out again: where, and what is left of it. False where nothing is.
  // `towards`: unit direction to where the path comes from.
  bool walk_out(const Surface& at, Vec3 towards, Sampler& sampler, Vec3& throughput, Hit& hit, Surface& s) {
    const Medium medium = tracer_.medium(at.albedo);
    const RandomWalk walk(tracer_.fast_, medium, counters.rays);
    const Frame entry(at.geometric);
    Vec3 point = at.point, inwards;
    if (!entry_direction(upper(entry.local(towards)), sampler, inwards)) return false;
    inwards = entry.world(inwards);
    if (!walk.leave(point, inwards, sampler, throughput, hit)) return false;
    s = exit_surface(hit, point, inwards);
    return true;
  }

  // One sample of what leaves the wall at `at` by way of a walk that starts there: radiance (towards every side), its
  // first scattering included. `carried`: throughput before (for roulette only).
  Vec3 walked_light(const Surface& at, Vec3 towards, Vec3 carried, std::uint32_t scattering, Sampler& sampler) {
    Vec3 throughput;
    Hit hit;
    Surface s;
    if (!walk_out(at, towards, sampler, throughput, hit, s)) return {0, 0, 0};
    return throughput * lit_exit(s, carried * throughput, scattering, sampler);
  }

  // What a place sends on of all light (radiance over its albedo) where a walk comes out.
  Vec3 lit_exit(const Surface& s, Vec3 carried, std::uint32_t scattering, Sampler& sampler) {
    const float survival = scattering > 1 ? std::min(max_component(carried), 1.0f) : 1.0f;
    Vec3 light = irradiance(s, true) * (1.0f / kPi);
    if (scattering < limit_ && (survival >= 1.0f || sampler.random() < survival)) {
      float u, v;
      sampler.next2(u, v);
      const Vec3 direction = Frame(s.shading).world(cosine_direction(u, v));
      const Vec3 onwards = carried * (1.0f / survival);
      if (dot(direction, s.geometric) > 0.0f)
        light += incoming(s.point + s.geometric * kOffset, direction, onwards, scattering + 1, sampler) * (1.0f / survival);
    }
    return light;
  }

  // What the first vertex of a subsurface material sends: by its base over its albedo, and mirrored by its coat.
  void scattered_light(const Surface& s, const Frame& frame, Vec3 o, Sampler& sampler, Vec3& base, Vec3& mirrored) {
    float share;
    if (coat_is_chosen(s, o, sampler, share)) {
      if (limit_ > 1) mirrored = mirrored_light(s, frame, o, sampler) * share;
      return;
    }
    base = over(walked_light(s, frame.world(o), Vec3{share, share, share}, 1, sampler), s.albedo) * share;
  }

  // Which of the two terms a sample goes on with, and its weight: the coat over the probability, or the base under its coat.
  bool coat_is_chosen(const Surface& s, Vec3 o, Sampler& sampler, float& share) const {
    share = 1.0f;
    if (!tracer_.coated_) return false;
    const float e = tracer_.coat_.albedo(s.alpha, o.z);
    const float p_coat = e / (e + (1.0f - e) * max_component(s.albedo) + 1e-6f);
    const bool chosen = sampler.next1() < p_coat;
    share = chosen ? 1.0f / p_coat : (1.0f - e) / (1.0f - p_coat);
    return chosen;
  }

  // Where the coat mirrors to, and with which weight; false where nowhere.
  bool mirrored_direction(const Surface& s, const Frame& frame, Vec3 o, Sampler& sampler, Vec3& direction, float& weight) const {
    float u, v;
    sampler.next2(u, v);
    const Vec3 h = visible_normal(o, s.alpha, u, v), local = h * (2.0f * dot(o, h)) - o;
    if (local.z <= 0.0f) return false;
    direction = frame.world(local);
    if (dot(direction, s.geometric) <= 0.0f) return false;
    const float lo = smith_lambda(o.z, s.alpha), li = smith_lambda(local.z, s.alpha);
    weight = fresnel(dot(o, h), tracer_.coat_.ior()) * (1.0f + lo) / (1.0f + lo + li);
    return true;
  }

  // One sample of what the coat mirrors of other walls.
  Vec3 mirrored_light(const Surface& s, const Frame& frame, Vec3 o, Sampler& sampler, std::uint32_t scattering = 2) {
    Vec3 direction;
    float weight;
    if (!mirrored_direction(s, frame, o, sampler, direction, weight)) return {0, 0, 0};
    return incoming(s.point + s.geometric * kOffset, direction, Vec3{weight, weight, weight}, scattering, sampler) * weight;
  }

  // Radiance that comes out of an index-matched wall against `direction`, seen at `entry`: every scattering in the wall
  // is lit by the lamp through the boundary, and light that leaves the wall goes on to the next one.
  Vec3 matched_light(const Surface& entry, Vec3 direction, Sampler& sampler) {
    const Medium medium = tracer_.medium(entry.albedo);
    const RandomWalk walk(tracer_.fast_, medium, counters.rays);
    Vec3 radiance{0, 0, 0}, throughput{1, 1, 1}, point = entry.point;
    float near = RandomWalk::kStart;
    Hit hit;
    for (std::uint32_t scattering = 0;;) {
      const RandomWalk::Step step = walk.flight(point, direction, near, throughput, sampler, hit);
      if (step == RandomWalk::Step::kAbsorbed) return radiance;
      if (step == RandomWalk::Step::kSurface) {
        // Through the lumen to the next wall.
        const Vec3 from = point + direction * kOffset;
        if (!intersect(from, direction, hit)) return radiance + throughput * background_;
        if (!tracer_.every_vertex_) return radiance + throughput * reflected(hit, from, direction, throughput, scattering + 1, sampler);
        point = from + direction * hit.t;
        near = RandomWalk::kStart;
        continue;
      }
      ++scattering;
      radiance += throughput * lamp_through_boundary(walk, medium, point);
      if (scattering >= limit_ || !RandomWalk::survives(throughput, sampler)) return radiance;
      direction = isotropic_direction(sampler.random(), sampler.random());
      near = 0.0f;
    }
  }

  // What a scattering inside the wall sends on of the lamp's light, which crosses the boundary unbent, perhaps often.
  Vec3 lamp_through_boundary(const RandomWalk& walk, const Medium& medium, Vec3 point) {
    const Vec3 to_light = light_ - point;
    const float r2 = std::max(dot(to_light, to_light), kNearest2), r = std::sqrt(r2);
    const Vec3 direction = to_light * (1.0f / r);
    const float thinnest = std::min(medium.extinction.x, std::min(medium.extinction.y, medium.extinction.z));
    float in_wall = 0.0f, so_far = 0.0f;
    bool inside = true;
    Hit hit;
    for (float near = 0.0f;; near = so_far + RandomWalk::kStart, inside = !inside) {
      const bool surface = near < r && walk.reaches(point, direction, near, r, hit);
      const float end = surface ? hit.t : r;
      if (inside) in_wall += end - so_far;
      // Nothing to be seen of what is left.
      if (in_wall * thinnest > 20.0f) return {0, 0, 0};
      if (!surface) break;
      so_far = end;
    }
    return intensity_ * attenuation(medium.extinction, in_wall) * (emission(-dot(direction, light_axis_)) / (4.0f * kPi * r2));
  }

  // Radiance that arrives along a ray from a first vertex; `carried` is the throughput up to there (for roulette only).
  // `scattering` counts that at the vertex which the ray meets.
  Vec3 incoming(Vec3 from, Vec3 direction, Vec3 carried, std::uint32_t scattering, Sampler& sampler) {
    Hit hit;
    if (!intersect(from, direction, hit)) return background_;
    return reflected(hit, from, direction, carried, scattering, sampler);
  }

  // The same where the ray's end is known.
  Vec3 reflected(Hit hit, Vec3 from, Vec3 direction, Vec3 carried, std::uint32_t scattering, Sampler& sampler) {
    if (tracer_.every_vertex_) {
      const Surface s = surface(hit, from, direction);
      return walked_light(s, -direction, carried, scattering, sampler);
    }
    Vec3 radiance{0, 0, 0}, throughput{1, 1, 1};
    for (;; ++scattering) {
      const Surface s = surface(hit, from, direction);
      const Frame frame(s.shading);
      const Vec3 o = tracer_.coated_ ? upper(frame.local(-direction)) : Vec3{0, 0, 1};
      radiance += throughput * direct_light(s, frame, o, true, s.albedo);
      if (scattering >= limit_) return radiance;
      Vec3 local;
      float base_weight, coat_weight;
      if (!sample_direction(s, o, max_component(s.albedo), sampler, local, base_weight, coat_weight)) return radiance;
      direction = frame.world(local);
      if (dot(direction, s.geometric) <= 0.0f) return radiance;
      throughput = throughput * (s.albedo * base_weight + Vec3{coat_weight, coat_weight, coat_weight});
      const float survival = max_component(throughput * carried);
      if (survival < 1.0f) {
        if (sampler.next1() >= survival) return radiance;
        throughput = throughput * (1.0f / survival);
      }
      from = s.point + s.geometric * kOffset;
      if (!intersect(from, direction, hit)) return radiance + throughput * background_;
    }
  }

  Vec3 background_;
  std::uint32_t limit_;
};

}  // namespace respire
