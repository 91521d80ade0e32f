#pragma once
// Unidirectional path tracing with next event estimation of one point light.
//
//   L_o(x, o) = E_lamp f + integral of L_i f cos,   f of `coat.h`,
// estimated along one path: radiance += throughput * direct light; throughput *= f cos / density at every vertex.
//
// All noise of a scene lit from the camera is in the indirect light (the direct light of a camera-visible point is a
// closed form and needs no shadow ray), so the film keeps the two apart. It splits the indirect part again, into what
// the Lambert base sends (demodulated by its albedo, hence smooth over the surface) and what the coat mirrors.
//
// Russian roulette: from its second bounce on a path survives with the probability of its throughput (the largest
// channel), never capped: a cap below the albedo would make the variance infinite in a closed lumen. (Roulette at the
// first bounce too saves 8 % of the rays and costs 60 % in median variance on the reference tube.)
//
// Subsurface: at the first vertex (or at every one) the base's light scatters through the wall
// (`cpp/trace/scatter_walk.h`) and leaves it elsewhere. With a diffuse boundary it enters by the cosine law and leaves
// as from a Lambert surface of albedo 1; with a matched boundary the surface does not bend or reflect it at all and
// every scattering is lit by the lamp.

#include <cmath>

#include "cpp/trace/lamp.h"
#include "cpp/trace/sampler.h"
#include "cpp/trace/scatter_walk.h"
#include "cpp/trace/vector.h"

namespace respire {

inline Vec3 grey(float v) { return {v, v, v}; }

// The probability of following the coat's term of directional albedo `e`, not the base's of albedo `base`.
inline float coat_probability(float e, float base) { return e / (e + (1.0f - e) * base + 1e-6f); }

// A vertex of a path: the surface, axes around its shading normal, and in these axes the direction back along the path.
struct Vertex {
  Surface s;
  TangentFrame frame;
  Vec3 o;
  explicit Vertex(const Surface& surface) : s(surface), frame(surface.shading), o{0, 0, 1} {}
  // The vertex that a ray along `direction` hits.
  Vertex(const Surface& surface, Vec3 direction) : Vertex(surface) { o = upper(frame.local(-direction)); }
  Vec3 origin() const { return s.point + s.geometric * SURFACE_OFFSET; }
};

// Indirect light that a vertex sends to the viewer: by the base, over its albedo, and by the coat.
struct Indirect {
  Vec3 base{}, coat{};
};

class PathTracer {
 public:
  PathTracer(const Wall& wall, const Lamp& lamp, const FrameSettings& frame)
      : wall_(wall),
        material_(wall.material),
        lamp_(lamp),
        caster_(wall.mesh),
        light_at_camera_(frame.light_at_camera),
        background_(load(frame.background.data())),
        limit_(frame.max_scatterings == 0 ? unlimited(wall.material) : frame.max_scatterings) {}

  std::uint64_t paths = 0, rejected = 0;

  RayCaster& caster() { return caster_; }
  const Wall& wall() const { return wall_; }
  const Lamp& lamp() const { return lamp_; }
  Vec3 background() const { return background_; }
  // Surface scatterings of the longest path, direct light = 1.
  std::uint32_t limit() const { return limit_; }

  // One sample through a pixel, all light traced. `hit`: what the camera ray meets, or null.
  void camera_sample(Vec3 direction, const Hit* hit, Sampler& sampler, FilmPixel& film) {
    first_vertex(direction, hit, film, [&](const Vertex& at) { return traced_light(at, direction, sampler); });
  }

  // Records the vertex that the camera sees: the lamp's own light on it, and what `indirect(vertex)` returns.
  template <class Find>
  void first_vertex(Vec3 direction, const Hit* hit, FilmPixel& film, Find&& indirect) {
    ++paths;
    if (!hit) {
      add(film.direct, background_);
      return;
    }
    const Vertex at(wall_.camera_surface(*hit, direction), direction);
    Vec3 direct{};
    // Light that scatters in the wall is found with the indirect light; a matched boundary has no coat either.
    if (material_.subsurface() != SubsurfaceKind::Matched) {
      const bool scatters = material_.subsurface() == SubsurfaceKind::Diffuse;
      const Vec3 rho = scatters ? Vec3{0, 0, 0} : at.s.albedo;
      direct = lamp_.direct_light(material_, at.s, at.frame, at.o, rho, light_at_camera_ ? nullptr : &caster_);
    }
    record(at.s, direct, indirect(at), film);
  }

  // One sample of the indirect light of the first vertex, which the camera sees along `direction`.
  Indirect traced_light(const Vertex& at, Vec3 direction, Sampler& sampler) {
    Indirect light;
    switch (material_.subsurface()) {
      case SubsurfaceKind::Matched: light.base = quotient(matched_light(at.s, direction, sampler), at.s.albedo); break;
      case SubsurfaceKind::Diffuse: light = scattered_light(at, sampler); break;
      default:
        if (limit_ > 1) light = reflected_light(at, sampler);
    }
    return light;
  }

  // A direction for the next ray (local), and f cos / density of the two terms, the base without its albedo.
  struct Scattering {
    Vec3 local;
    float base, coat;
  };

  // False where the path ends. One of the two terms proposes the direction; the density is that of both together.
  bool sample_direction(const Vertex& at, Sampler& sampler, Scattering& next) const {
    float u, v;
    if (!material_.coated()) {
      sampler.next2(u, v);
      next = {cosine_direction(u, v), 1.0f, 0.0f};
      return true;
    }
    const Coat& coat = material_.coat();
    const float e = coat.albedo(at.s.alpha, at.o.z);
    const float p_coat = coat_probability(e, max_component(at.s.albedo));
    const float choice = sampler.next1();
    sampler.next2(u, v);
    if (choice < p_coat) {
      next.local = mirror(at.o, visible_normal(at.o, at.s.alpha, u, v));
      if (next.local.z <= 0.0f) return false;
    } else {
      next.local = cosine_direction(u, v);
    }
    const float density =
        p_coat * Coat::density(at.o, next.local, at.s.alpha) + (1.0f - p_coat) * next.local.z * (1.0f / PI);
    if (!(density > 1e-12f)) return false;
    next.base = (1.0f - e) * (1.0f / PI) * next.local.z / density;
    next.coat = coat.value(at.o, next.local, at.s.alpha) * next.local.z / density;
    return true;
  }

  // Whether a sample follows the coat's term and not the base's, and the sample's weight: 1 / probability for the coat,
  // (1 - e) / probability for the base.
  bool coat_is_chosen(const Vertex& at, Sampler& sampler, float& weight) const {
    weight = 1.0f;
    if (!material_.coated()) return false;
    const float e = material_.coat().albedo(at.s.alpha, at.o.z);
    const float p_coat = coat_probability(e, max_component(at.s.albedo));
    const bool chosen = sampler.next1() < p_coat;
    weight = chosen ? 1.0f / p_coat : (1.0f - e) / (1.0f - p_coat);
    return chosen;
  }

  // Samples the direction into which the coat mirrors, and its weight; false where that points into the wall.
  bool mirrored_direction(const Vertex& at, Sampler& sampler, Vec3& direction, float& weight) const {
    float u, v;
    sampler.next2(u, v);
    const Vec3 h = visible_normal(at.o, at.s.alpha, u, v), local = mirror(at.o, h);
    if (local.z <= 0.0f) return false;
    direction = at.frame.world(local);
    if (dot(direction, at.s.geometric) <= 0.0f) return false;
    weight = mirror_weight(at.o, h, local, at.s.alpha, material_.coat().ior());
    return true;
  }

  // One sample of the light from other walls that the coat mirrors.
  Vec3 mirrored_light(const Vertex& at, Sampler& sampler, std::uint32_t scattering = 2) {
    Vec3 direction;
    float weight;
    if (!mirrored_direction(at, sampler, direction, weight)) return {0, 0, 0};
    return incoming(at.origin(), direction, grey(weight), scattering, sampler) * weight;
  }

  // A scatter walk from `at` until it leaves the wall: the exit, and the remaining throughput. False where nothing
  // remains. `towards`: unit direction back along the path.
  bool scatter_out(const Surface& at, Vec3 towards, Sampler& sampler, Vec3& throughput, Hit& hit, Surface& out) {
    const Medium medium = material_.medium(at.albedo);
    const ScatterWalk walk(wall_.mesh, medium, caster_.rays);
    const TangentFrame entry(at.geometric);
    Vec3 inwards;
    if (!material_.entry_direction(upper(entry.local(towards)), sampler, inwards)) return false;
    ScatterWalk::Flight flight{at.point, entry.world(inwards), {}};
    if (!walk.leave(flight, sampler, hit)) return false;
    throughput = flight.throughput;
    out = wall_.exit_surface(hit, flight.point, flight.direction);
    return true;
  }

  // Radiance, for albedo 1, that the exit of a scatter walk sends of the lamp's light and of one sample of indirect
  // light.
  Vec3 lit_exit(const Surface& s, Vec3 carried, std::uint32_t scattering, Sampler& sampler) {
    const float survival = scattering > 1 ? std::min(max_component(carried), 1.0f) : 1.0f;
    Vec3 light = lamp_.irradiance(s, &caster_) * (1.0f / PI);
    if (scattering < limit_ && (survival >= 1.0f || sampler.random() < survival)) {
      float u, v;
      sampler.next2(u, v);
      const Vertex at(s);
      const Vec3 direction = at.frame.world(cosine_direction(u, v));
      const Vec3 onwards = carried * (1.0f / survival);
      if (dot(direction, s.geometric) > 0.0f)
        light += incoming(at.origin(), direction, onwards, scattering + 1, sampler) * (1.0f / survival);
    }
    return light;
  }

  // Radiance that arrives along a ray from a first vertex; `carried` is the throughput up to there (for roulette only).
  // `scattering` is the number of the scattering at the vertex that the ray hits.
  Vec3 incoming(Vec3 from, Vec3 direction, Vec3 carried, std::uint32_t scattering, Sampler& sampler) {
    Hit hit;
    if (!caster_.intersect(from, direction, hit)) return background_;
    return reflected(hit, from, direction, carried, scattering, sampler);
  }

  // The same for a ray whose hit is known.
  Vec3 reflected(Hit hit, Vec3 from, Vec3 direction, Vec3 carried, std::uint32_t scattering, Sampler& sampler) {
    if (material_.scatters_at_every_vertex()) {
      const Surface s = wall_.surface(hit, from, direction);
      return subsurface_light(s, -direction, carried, scattering, sampler);
    }
    Vec3 radiance{0, 0, 0}, throughput{1, 1, 1};
    for (;; ++scattering) {
      const Vertex at = met(hit, from, direction);
      // Next event estimation.
      radiance += throughput * lamp_.direct_light(material_, at.s, at.frame, at.o, at.s.albedo, &caster_);
      if (scattering >= limit_) return radiance;
      // Next direction.
      Scattering next;
      if (!sample_direction(at, sampler, next)) return radiance;
      direction = at.frame.world(next.local);
      if (dot(direction, at.s.geometric) <= 0.0f) return radiance;
      throughput = throughput * (at.s.albedo * next.base + grey(next.coat));
      // Roulette.
      const float survival = max_component(throughput * carried);
      if (survival < 1.0f) {
        if (sampler.next1() >= survival) return radiance;
        throughput = throughput * (1.0f / survival);
      }
      from = at.origin();
      if (!caster_.intersect(from, direction, hit)) return radiance + throughput * background_;
    }
  }

  // The vertex that a ray hits; without a coat nothing depends on the view.
  Vertex met(const Hit& hit, Vec3 from, Vec3 direction) const {
    const Surface s = wall_.surface(hit, from, direction);
    return material_.coated() ? Vertex(s, direction) : Vertex(s);
  }

 private:
  // Most scatterings of an unlimited path. Roulette ends every path long before; the bound only stops paths in a
  // perfectly white closed room.
  static constexpr std::uint32_t LONGEST_PATH = 4096;
  // The same for a matched boundary, where every scattering below the surface counts.
  static constexpr std::uint32_t LONGEST_MATCHED_PATH = 1u << 24;
  static std::uint32_t unlimited(const WallMaterial& material) {
    return material.subsurface() == SubsurfaceKind::Matched ? LONGEST_MATCHED_PATH : LONGEST_PATH;
  }

  static void add(std::array<float, 3>& sum, Vec3 v) { sum[0] += v.x, sum[1] += v.y, sum[2] += v.z; }
  static bool valid(Vec3 v) { return v.x >= 0 && v.y >= 0 && v.z >= 0 && v.x + v.y + v.z < 1e30f; }

  // Adds one sample; a negative or non-finite one is counted and left out.
  void record(const Surface& s, Vec3 direct, const Indirect& light, FilmPixel& film) {
    const Vec3 indirect = light.base * s.albedo + light.coat;
    if (!valid(direct) || !valid(indirect)) {
      ++rejected;
      return;
    }
    add(film.direct, direct);
    add(film.indirect, indirect);
    add(film.indirect_base, light.base);
    add(film.indirect_coat, light.coat);
    add(film.albedo, s.albedo);
    add(film.normal, s.smooth);
    film.hits += 1.0f;
  }

  // One sample of the light that reaches the camera's vertex from other walls.
  Indirect reflected_light(const Vertex& at, Sampler& sampler) {
    Scattering next;
    if (!sample_direction(at, sampler, next)) return {};
    const Vec3 direction = at.frame.world(next.local);
    if (dot(direction, at.s.geometric) <= 0.0f) return {};
    const Vec3 throughput = at.s.albedo * next.base + grey(next.coat);
    const Vec3 light = incoming(at.origin(), direction, throughput, 2, sampler);
    return {light * next.base, light * next.coat};
  }

  // One sample of the radiance, the same in all directions, that leaves the wall at `at`, found by a scatter walk that
  // starts there. `carried`: throughput before (for roulette only).
  Vec3 subsurface_light(const Surface& at, Vec3 towards, Vec3 carried, std::uint32_t scattering, Sampler& sampler) {
    Vec3 throughput;
    Hit hit;
    Surface out;
    if (!scatter_out(at, towards, sampler, throughput, hit, out)) return {0, 0, 0};
    return throughput * lit_exit(out, carried * throughput, scattering, sampler);
  }

  // What the first vertex of a subsurface material sends.
  Indirect scattered_light(const Vertex& at, Sampler& sampler) {
    float weight;
    if (coat_is_chosen(at, sampler, weight)) {
      if (limit_ <= 1) return {};
      return {{}, mirrored_light(at, sampler) * weight};
    }
    const Vec3 light = subsurface_light(at.s, at.frame.world(at.o), grey(weight), 1, sampler);
    return {quotient(light, at.s.albedo) * weight, {}};
  }

  // Radiance that comes out of an index-matched wall against `direction`, seen at `entry`: every scattering in the wall
  // is lit by the lamp through the boundary, and light that leaves the wall goes on to the next one.
  Vec3 matched_light(const Surface& entry, Vec3 direction, Sampler& sampler) {
    const Medium medium = material_.medium(entry.albedo);
    const ScatterWalk walk(wall_.mesh, medium, caster_.rays);
    Vec3 radiance{0, 0, 0};
    ScatterWalk::Flight flight{entry.point, direction, {1, 1, 1}};
    float near = ScatterWalk::START;
    Hit hit;
    for (std::uint32_t scattering = 0;;) {
      const ScatterWalk::Step step = walk.fly(flight, near, sampler, hit);
      if (step == ScatterWalk::Step::ABSORBED) return radiance;
      if (step == ScatterWalk::Step::SURFACE) {
        // Through the lumen to the next wall.
        const Vec3 from = flight.point + flight.direction * SURFACE_OFFSET;
        if (!caster_.intersect(from, flight.direction, hit)) return radiance + flight.throughput * background_;
        if (!material_.scatters_at_every_vertex()) {
          const Vec3 onwards = reflected(hit, from, flight.direction, flight.throughput, scattering + 1, sampler);
          return radiance + flight.throughput * onwards;
        }
        flight.point = from + flight.direction * hit.t;
        near = ScatterWalk::START;
        continue;
      }
      ++scattering;
      radiance += flight.throughput * lamp_through_boundary(walk, medium, flight.point);
      if (scattering >= limit_ || !ScatterWalk::survives(flight.throughput, sampler)) return radiance;
      const float v = sampler.random(), u = sampler.random();
      flight.direction = isotropic_direction(u, v);
      near = 0.0f;
    }
  }

  // What a scattering inside the wall sends of the lamp's light, which crosses the boundary unbent, perhaps several
  // times: I exp(-sigma d) / (4 pi r^2), d the length of the path inside the wall.
  Vec3 lamp_through_boundary(const ScatterWalk& walk, const Medium& medium, Vec3 point) {
    // Optical depth beyond which the remaining light (2e-9) is invisible.
    constexpr float OPAQUE = 20.0f;
    Vec3 direction;
    const float r2 = lamp_.direction_from(point, direction), r = std::sqrt(r2);
    const float thinnest = std::min(medium.extinction.x, std::min(medium.extinction.y, medium.extinction.z));
    float in_wall = 0.0f, so_far = 0.0f;
    bool inside = true;
    Hit hit;
    for (float near = 0.0f;; near = so_far + ScatterWalk::START, inside = !inside) {
      const bool surface = near < r && walk.reaches(point, direction, near, r, hit);
      // A hit at grazing incidence is placed by rounding; it must not lie before where the ray began, or this never ends.
      const float end = surface ? std::max(hit.t, near) : r;
      if (inside) in_wall += end - so_far;
      if (in_wall * thinnest > OPAQUE) return {0, 0, 0};
      if (!surface) break;
      so_far = end;
    }
    const float falloff = lamp_.emission(direction) / (4.0f * PI * r2);
    return lamp_.intensity() * attenuation(medium.extinction, in_wall) * falloff;
  }

  const Wall& wall_;
  const WallMaterial& material_;
  const Lamp& lamp_;
  RayCaster caster_;
  bool light_at_camera_;
  Vec3 background_;
  std::uint32_t limit_;
};

}  // namespace respire
