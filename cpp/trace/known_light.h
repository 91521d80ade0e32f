#pragma once
// Camera samples that take smooth light from the vertices, where `src/render/vertex_light.rs` has solved for it.
//
// A vertex holds (`KnownLight`) the light that the base sends after scattering in the wall, the irradiance from other
// walls, and the part of the scattered light that comes out nearby. Negative means not known: there a path is traced.

#include "cpp/trace/face_light.h"
#include "cpp/trace/path.h"

namespace respire {

class KnownLightTracer {
 public:
  // `known`: one per vertex of the mesh.
  KnownLightTracer(PathTracer& paths, const KnownLight* known)
      : paths_(paths), wall_(paths.wall()), material_(paths.wall().material), lamp_(paths.lamp()), known_(known) {}

  // Like `PathTracer::camera_sample`, but light from other walls and light scattered in the wall come from the
  // vertices.
  void known_sample(Vec3 direction, const Hit* hit, Sampler& sampler, FilmPixel& film) {
    paths_.first_vertex(direction, hit, film, [&](const Vertex& at) -> Indirect {
      const bool scatters = material_.subsurface() == SubsurfaceKind::Diffuse;
      Vec3 light;
      if (!(scatters ? scattered_at(*hit, light) : irradiance_at(*hit, light)))
        return paths_.traced_light(at, direction, sampler);
      if (scatters) light = sharpened(*hit, light, at.s);
      const float share = material_.coated() ? 1.0f - material_.coat().albedo(at.s.alpha, at.o.z) : 1.0f;
      Indirect found;
      found.base = light * (share * (1.0f / PI));
      if (material_.coated() && paths_.limit() > 1) found.coat = mirrored(at, sampler);
      return found;
    });
  }

  // The same with the light of the vertices one bounce later: a sample's first ray or scatter walk is traced, and the
  // point it reaches gets the lamp's light exactly and other walls' light from the vertices. What the coat mirrors
  // there is traced.
  void gathered_sample(Vec3 direction, const Hit* hit, Sampler& sampler, FilmPixel& film) {
    paths_.first_vertex(direction, hit, film, [&](const Vertex& at) -> Indirect {
      if (material_.subsurface() == SubsurfaceKind::Diffuse) return gathered_walk(at, sampler);
      if (paths_.limit() > 1) return gathered_ray(at, sampler);
      return {};
    });
  }

 private:
  Indirect gathered_ray(const Vertex& at, Sampler& sampler) {
    PathTracer::Scattering next;
    if (!paths_.sample_direction(at, sampler, next)) return {};
    const Vec3 direction = at.frame.world(next.local);
    if (dot(direction, at.s.geometric) <= 0.0f) return {};
    const Vec3 carried = at.s.albedo * next.base + grey(next.coat);
    const Vec3 light = gathered(at.origin(), direction, carried, sampler);
    return {light * next.base, light * next.coat};
  }

  Indirect gathered_walk(const Vertex& at, Sampler& sampler) {
    float weight;
    if (paths_.coat_is_chosen(at, sampler, weight)) {
      if (paths_.limit() <= 1) return {};
      return {{}, paths_.mirrored_light(at, sampler) * weight};
    }
    Vec3 throughput, light;
    Hit hit;
    Surface out;
    if (!paths_.scatter_out(at.s, at.frame.world(at.o), sampler, throughput, hit, out)) return {};
    if (irradiance_at(hit, light))
      light = (light + lamp_.irradiance(out, &paths_.caster())) * (1.0f / PI);
    else
      light = paths_.lit_exit(out, throughput * weight, 1, sampler);
    return {quotient(throughput * light, at.s.albedo) * weight, {}};
  }

  // Radiance that arrives along a ray from a first vertex.
  Vec3 gathered(Vec3 from, Vec3 direction, Vec3 carried, Sampler& sampler) {
    Hit hit;
    if (!paths_.caster().intersect(from, direction, hit)) return paths_.background();
    Vec3 light;
    if (!irradiance_at(hit, light)) return paths_.reflected(hit, from, direction, carried, 2, sampler);
    const Vertex met = paths_.met(hit, from, direction);
    // The lamp, then other walls by the base and by the coat.
    Vec3 radiance = lamp_.direct_light(material_, met.s, met.frame, met.o, met.s.albedo, &paths_.caster());
    if (paths_.limit() == 2) return radiance;
    const float share = material_.coated() ? 1.0f - material_.coat().albedo(met.s.alpha, met.o.z) : 1.0f;
    radiance += light * met.s.albedo * (share * (1.0f / PI));
    float weight;
    if (paths_.coat_is_chosen(met, sampler, weight)) radiance += paths_.mirrored_light(met, sampler, 3) * weight;
    return radiance;
  }

  // One sample of what the coat mirrors; light that scattered more than once comes from the vertices.
  Vec3 mirrored(const Vertex& at, Sampler& sampler) {
    Vec3 direction;
    float weight;
    if (!paths_.mirrored_direction(at, sampler, direction, weight)) return {0, 0, 0};
    const Vec3 from = at.origin();
    Hit hit;
    if (!paths_.caster().intersect(from, direction, hit)) return paths_.background() * weight;
    // A face that no ray from a visible face has reached in four generations gets hardly any indirect light.
    Vec3 light;
    if (!irradiance_at(hit, light)) light = {0, 0, 0};
    const Vertex met(wall_.surface(hit, from, direction), direction);
    // A sharp highlight in a mirror would be all noise, so the coat hit there uses the wide lobe.
    const Vec3 to_lamp = met.frame.local(normalize(lamp_.position() - met.s.point));
    const float cosine = std::max(to_lamp.z, 0.0f);
    const float wide = std::max(material_.wide_coat().albedo(WIDE_ALPHA, cosine), 1e-6f);
    const float glint = PI / wide * material_.wide_coat().value(met.o, to_lamp, WIDE_ALPHA);
    const float lamp = material_.coat().albedo(met.s.alpha, cosine) * glint;
    // Indirect light by the coat: of its uniform part, by reciprocity, the albedo seen from here; the rest through the
    // wide lobe.
    const float e = material_.coat().albedo(met.s.alpha, met.o.z);
    auto other = [&](float side) { return (1.0f - side) * e + side * material_.mean_coat() * glint; };
    const Vec3 side = material_.lamp_side();
    const Vec3 base = met.s.albedo * (1.0f - e);
    const Vec3 by_lamp = lamp_.irradiance(met.s, &paths_.caster()) * (base + grey(lamp));
    return (by_lamp + light * (base + Vec3{other(side.x), other(side.y), other(side.z)})) * (weight / PI);
  }

  bool scattered_at(const Hit& hit, Vec3& light) const {
    return interpolated(hit, [](const KnownLight& at) { return at.scattered.data(); }, light);
  }
  bool irradiance_at(const Hit& hit, Vec3& light) const {
    return interpolated(hit, [](const KnownLight& at) { return at.irradiance.data(); }, light);
  }

  // Interpolates what is known at the face's vertices; the others take over the weight of vertices that are not known.
  // False where hardly anything is known.
  template <class Values>
  bool interpolated(const Hit& hit, Values&& values, Vec3& light) const {
    // Least total weight of known vertices at which they may stand for the whole face.
    constexpr float ENOUGH = 0.05f;
    const std::uint32_t* corners = wall_.mesh.corners(hit.face);
    const float w[3] = {1.0f - hit.u - hit.v, hit.u, hit.v};
    float total = 0.0f;
    light = {0, 0, 0};
    for (int k = 0; k < 3; ++k) {
      const float* value = values(known_[corners[k]]);
      if (value[0] < 0.0f) continue;
      light += load(value) * w[k];
      total += w[k];
    }
    if (!(total > ENOUGH)) return false;
    light = light * (1.0f / total);
    return true;
  }

  // Replaces the interpolated part of the lamp's light that comes out nearby by its value at the sample's own point.
  Vec3 sharpened(const Hit& hit, Vec3 light, const Surface& s) const {
    const std::uint32_t* corners = wall_.mesh.corners(hit.face);
    const float w[3] = {1.0f - hit.u - hit.v, hit.u, hit.v};
    Vec3 nearby{}, smooth{};
    for (int k = 0; k < 3; ++k) {
      const KnownLight& at = known_[corners[k]];
      if (at.scattered[0] < 0.0f) return light;
      nearby += load(at.nearby.data()) * w[k];
      smooth += load(at.lamp_nearby.data()) * w[k];
    }
    const Vec3 sharp = light + nearby * lamp_.unshadowed(s) - smooth;
    return {std::max(sharp.x, 0.0f), std::max(sharp.y, 0.0f), std::max(sharp.z, 0.0f)};
  }

  PathTracer& paths_;
  const Wall& wall_;
  const WallMaterial& material_;
  const Lamp& lamp_;
  const KnownLight* known_;
};

}  // namespace respire
