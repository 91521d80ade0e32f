#pragma once
// Light at vertices: what `src/render/vertex_light.rs` asks of faces and vertices, and camera samples that use its answer.

#include "cpp/trace/path.h"

namespace respire {

// Per vertex: light that the base sends, over its albedo and times pi, by way of the wall (3); irradiance by other walls (3);
// the part of a walk's light that comes out nearby, over the albedo (3), and that part times the lamp's unshadowed
// irradiance around the vertex (3).
constexpr std::size_t kKnownValues = 12;

// Per face: the lamp's irradiance (3), what the base sends on of it (3), what is sent on to all sides alike of other light (3),
// centre (3), normal (3), what the coat mirrors of the lamp's light and of other light, over `glint`; the lamp's unshadowed
// irradiance (3); 1 where the face is so near that its light is not even.
constexpr std::size_t kLampValues = 21;

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
    first_vertex(direction, hit, film, [&](const Surface& s, const Frame& frame, Vec3 o, Vec3& base, Vec3& mirrored) {
      const bool walked = tracer_.subsurface_ == Subsurface::kDiffuse;
      Vec3 light;
      if (!known_light(known, *hit, walked ? 0 : 3, light)) return traced_light(s, frame, o, direction, sampler, base, mirrored);
      if (walked) light = sharpened(known, *hit, light, s);
      const float share = tracer_.coated_ ? 1.0f - tracer_.coat_.albedo(s.alpha, o.z) : 1.0f;
      base = light * (share * (1.0f / kPi));
      if (tracer_.coated_ && limit_ > 1) mirrored = known_mirrored(s, frame, o, known, sampler);
    });
  }

  // Like `camera_sample`, with the light that other walls send taken from the vertices one wall later: a sample's first ray, or
  // its walk, is traced, and what it meets is lit by the lamp exactly and by other walls as `known` says (its first three
  // values are not used). What the coat there mirrors is traced. Where nothing is known the path goes on.
  void gathered_sample(Vec3 direction, const Hit* hit, rust::Slice<const float> known, Sampler& sampler, float* film) {
    first_vertex(direction, hit, film, [&](const Surface& s, const Frame& frame, Vec3 o, Vec3& base, Vec3& mirrored) {
      if (tracer_.subsurface_ == Subsurface::kDiffuse)
        gathered_walk(s, frame, o, known, sampler, base, mirrored);
      else if (limit_ > 1)
        gathered_light(s, frame, o, known, sampler, base, mirrored);
    });
  }

  // What the lamp does to a face as a whole (kLampValues): means over equal parts of it, the more of them the nearer it is.
  void lamp(std::uint32_t face, float* values) {
    const Surface s = face_surface(face, 1.0f / 3.0f, 1.0f / 3.0f);
    const int parts = parts_of(face, s.point);
    Vec3 received{}, sent{}, even{};
    for (int k = 0; k < parts * parts; ++k) {
      // Rows of upright and, between them, inverted triangles.
      const int row = static_cast<int>(std::sqrt(static_cast<float>(k) + 0.5f)), place = k - row * row;
      const float third = place % 2 == 0 ? 1.0f / 3.0f : 2.0f / 3.0f, size = 1.0f / static_cast<float>(parts);
      const float v = (static_cast<float>(place / 2) + third) * size;
      const float rest = (static_cast<float>(row) + (place % 2 == 0 ? 2.0f : 1.0f) / 3.0f) * size;
      const Surface part = parts == 1 ? s : face_surface(face, rest - v, v);
      const Vec3 light = irradiance(part, true);
      received += light, sent += light * part.albedo, even += unshadowed(part);
    }
    const float each = 1.0f / static_cast<float>(parts * parts);
    const float e = tracer_.mean_coat_;
    store(values, received * each);
    store(values + 3, sent * (each * (1.0f - e)));
    const float spread = e * (1.0f - kFromLampSide);
    store(values + 6, s.albedo * (1.0f - e) + Vec3{spread, spread, spread});
    store(values + 9, s.point);
    store(values + 12, s.shading);
    values[15] = values[16] = 0.0f;
    store(values + 17, even * each);
    values[20] = parts > 1 ? 1.0f : 0.0f;
    if (!tracer_.coated_) return;
    // As much as the coat sends back, through the wider lobe.
    const float cosine = std::max(dot(s.shading, normalize(light_ - s.point)), 0.0f);
    const float wide = std::max(tracer_.wide_coat_.albedo(kWideAlpha, cosine), 1e-6f);
    values[15] = tracer_.coat_.albedo(s.alpha, cosine) / wide;
    values[16] = e * kFromLampSide / wide;
  }

  // The lamp's unshadowed irradiance at a place in a face.
  Vec3 unshadowed_at(std::uint32_t face, float u, float v) const { return unshadowed(face_surface(face, u, v)); }

  // The same as a mean over a face with weights that fall from 1 at the vertex `corner` to 0 at the side across (exact to
  // third order: two points each way).
  Vec3 unshadowed_near(std::uint32_t face, std::uint32_t corner) const {
    Vec3 sum{};
    for (const float own : {0.5f - 0.2236068f, 0.5f + 0.2236068f})
      for (const float split : {0.5f - 0.2886751f, 0.5f + 0.2886751f}) {
        float w[3];
        w[corner] = own, w[(corner + 1) % 3] = (1.0f - own) * split, w[(corner + 2) % 3] = (1.0f - own) * (1.0f - split);
        sum += unshadowed_at(face, w[1], w[2]);
      }
    return sum * 0.25f;
  }

  // What a face sends towards `to`: its base, over what it sends on the mean of all sides (under its coat less at a flat angle),
  // and its coat of light that comes from the lamp's side: radiance times pi over what it gets there. `from`: its kLampValues.
  void glint(Vec3 to, const float* from, float* base_and_coat) const {
    base_and_coat[0] = 1.0f, base_and_coat[1] = 0.0f;
    const Vec3 point = load(from + 9), way = to - point;
    const float l2 = dot(way, way);
    if (!(l2 > 0.0f)) return;
    const Frame frame(load(from + 12));
    const Vec3 o = frame.local(way * (1.0f / std::sqrt(l2))), i = frame.local(normalize(light_ - point));
    const float mean_alpha = 0.5f * (tracer_.alpha_low_ + tracer_.alpha_high_);
    base_and_coat[0] = (1.0f - tracer_.coat_.albedo(mean_alpha, std::max(o.z, 0.0f))) / (1.0f - tracer_.mean_coat_);
    base_and_coat[1] = kPi * tracer_.wide_coat_.value(o, i, kWideAlpha);
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

  // How a walk ended.
  struct Exit {
    std::uint32_t face = kNothing;
    float u = 0.0f, v = 0.0f;
    // What is left of its light over the albedo where it began, and the same below a flat surface by the same random
    // numbers, less what is known to be left there on the mean (0 where that is not known).
    Vec3 weight{}, flat{};
  };

  // A walk that starts in `face`, the more likely the nearer to its vertex `corner` (linearly).
  Exit walk_from(std::uint32_t face, std::uint32_t corner, Sampler& sampler) {
    // The middle one of three.
    const float a = sampler.random(), b = sampler.random(), c = sampler.random();
    const float own = std::max(std::min(a, b), std::min(std::max(a, b), c));
    float u, v;
    const float split = sampler.next1();
    float w[3];
    w[corner] = own, w[(corner + 1) % 3] = (1.0f - own) * split, w[(corner + 2) % 3] = (1.0f - own) * (1.0f - split);
    const Surface s = face_surface(face, w[1], w[2]);
    const Medium medium = tracer_.medium(s.albedo);
    const Frame entry(s.geometric);
    Exit exit;
    Vec3 local, throughput;
    // The view is not known: a refracted entry is taken as seen from all sides alike.
    sampler.next2(u, v);
    if (!entry_direction(cosine_direction(u, v), sampler, local)) return exit;
    const Vec3 inwards = entry.world(local);
    Hit hit;
    if (!tracer_.fixed_scattering_ && tracer_.refracted_entry_ == 0.0f) {
      Sampler same = sampler;
      Vec3 point = s.point, direction = inwards;
      if (RandomWalk(s.point, s.geometric, medium).leave(point, direction, same, throughput, hit)) exit.flat = over(throughput, s.albedo);
      const Vec3 mean = {flat_albedo(s.albedo.x), flat_albedo(s.albedo.y), flat_albedo(s.albedo.z)};
      exit.flat = exit.flat - over(mean, s.albedo);
    }
    Vec3 point = s.point, direction = inwards;
    if (!RandomWalk(tracer_.fast_, medium, counters.rays).leave(point, direction, sampler, throughput, hit)) return exit;
    exit.face = hit.face, exit.u = hit.u, exit.v = hit.v;
    exit.weight = over(throughput, s.albedo);
    return exit;
  }

 private:
  void gathered_light(const Surface& s, const Frame& frame, Vec3 o, rust::Slice<const float> known, Sampler& sampler, Vec3& base,
                      Vec3& mirrored) {
    Vec3 local;
    float base_weight, coat_weight;
    if (!sample_direction(s, o, max_component(s.albedo), sampler, local, base_weight, coat_weight)) return;
    const Vec3 direction = frame.world(local);
    if (dot(direction, s.geometric) <= 0.0f) return;
    const Vec3 carried = s.albedo * base_weight + Vec3{coat_weight, coat_weight, coat_weight};
    const Vec3 light = gathered(s.point + s.geometric * kOffset, direction, carried, known, sampler);
    base = light * base_weight;
    mirrored = light * coat_weight;
  }

  void gathered_walk(const Surface& s, const Frame& frame, Vec3 o, rust::Slice<const float> known, Sampler& sampler, Vec3& base,
                     Vec3& mirrored) {
    float share;
    if (coat_is_chosen(s, o, sampler, share)) {
      if (limit_ > 1) mirrored = mirrored_light(s, frame, o, sampler) * share;
      return;
    }
    Vec3 throughput, light;
    Hit hit;
    Surface out;
    if (!walk_out(s, frame.world(o), sampler, throughput, hit, out)) return;
    if (known_light(known, hit, 3, light))
      light = (light + irradiance(out, true)) * (1.0f / kPi);
    else
      light = lit_exit(out, throughput * share, 1, sampler);
    base = over(throughput * light, s.albedo) * share;
  }

  // Radiance that arrives along a ray from a first vertex.
  Vec3 gathered(Vec3 from, Vec3 direction, Vec3 carried, rust::Slice<const float> known, Sampler& sampler) {
    Hit hit;
    if (!intersect(from, direction, hit)) return background_;
    Vec3 light;
    if (!known_light(known, hit, 3, light)) return reflected(hit, from, direction, carried, 2, sampler);
    const Surface met = surface(hit, from, direction);
    const Frame frame(met.shading);
    const Vec3 o = tracer_.coated_ ? upper(frame.local(-direction)) : Vec3{0, 0, 1};
    Vec3 radiance = direct_light(met, frame, o, true, met.albedo);
    if (limit_ == 2) return radiance;
    const float share = tracer_.coated_ ? 1.0f - tracer_.coat_.albedo(met.alpha, o.z) : 1.0f;
    radiance += light * met.albedo * (share * (1.0f / kPi));
    float weight;
    if (coat_is_chosen(met, o, sampler, weight)) radiance += mirrored_light(met, frame, o, sampler, 3) * weight;
    return radiance;
  }

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

  // Takes the lamp's light that has come out nearby as it is at the sample's own place instead of interpolated.
  Vec3 sharpened(rust::Slice<const float> known, const Hit& hit, Vec3 light, const Surface& s) const {
    const std::uint32_t* corners = tracer_.faces_ + 3ull * hit.face;
    const float w[3] = {1.0f - hit.u - hit.v, hit.u, hit.v};
    Vec3 nearby{}, interpolated{};
    for (int k = 0; k < 3; ++k) {
      const float* value = known.data() + kKnownValues * corners[k];
      if (value[0] < 0.0f) return light;
      nearby += load(value + 6) * w[k];
      interpolated += load(value + 9) * w[k];
    }
    const Vec3 sharp = light + nearby * unshadowed(s) - interpolated;
    return {std::max(sharp.x, 0.0f), std::max(sharp.y, 0.0f), std::max(sharp.z, 0.0f)};
  }

  // Longest side of a face over its distance from the lamp: above the first limit it is taken in 2 x 2 parts, then 4 x 4, 8 x 8.
  int parts_of(std::uint32_t face, Vec3 centre) const {
    const std::uint32_t* corners = tracer_.faces_ + 3ull * face;
    float side2 = 0.0f;
    for (int k = 0; k < 3; ++k) {
      const Vec3 side = load(tracer_.vertices_ + 3ull * corners[(k + 1) % 3]) - load(tracer_.vertices_ + 3ull * corners[k]);
      side2 = std::max(side2, dot(side, side));
    }
    const Vec3 way = light_ - centre;
    const float size2 = side2 / std::max(dot(way, way), kNearest2);
    return size2 < 0.01f ? 1 : size2 < 0.05f ? 2 : size2 < 0.3f ? 4 : 8;
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
    // Sharp glare in a mirror would be all noise: the coat met there has the wide lobe.
    const Frame there(met.shading);
    const Vec3 to_light = there.local(normalize(light_ - met.point)), back = upper(there.local(-direction));
    const float cosine = std::max(to_light.z, 0.0f);
    const float wide = std::max(tracer_.wide_coat_.albedo(kWideAlpha, cosine), 1e-6f);
    const float glint = kPi / wide * tracer_.wide_coat_.value(back, to_light, kWideAlpha);
    const float lamp = tracer_.coat_.albedo(met.alpha, cosine) * glint;
    // As much of what comes from all sides alike as it would send there of light from this side.
    const float e = tracer_.coat_.albedo(met.alpha, back.z);
    const float other = (1.0f - kFromLampSide) * e + kFromLampSide * tracer_.mean_coat_ * glint;
    const Vec3 base = met.albedo * (1.0f - e);
    return (irradiance(met, true) * (base + Vec3{lamp, lamp, lamp}) + light * (base + Vec3{other, other, other})) * (weight / kPi);
  }
};

}  // namespace respire
