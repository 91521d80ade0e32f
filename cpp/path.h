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
// Subsurface: at the first vertex (or at every one) the base's light walks through the wall (`cpp/walk.h`) and leaves it
// elsewhere. With a diffuse boundary it enters by the cosine law and leaves as from a Lambert surface of albedo 1;
// with a matched boundary the surface does not bend or reflect it at all and every scattering is lit by the lamp.
// Fine detail (vessels, relief) is evaluated where the camera sees it; later vertices see the wall's mean colour.

#include <embree4/rtcore.h>
#include <immintrin.h>

#include <cmath>

#include "cpp/coat.h"
#include "cpp/sampler.h"
#include "cpp/tracer.h"
#include "cpp/vector.h"
#include "cpp/walk.h"
#include "respire-bench/src/ffi/tracer.rs.h"

namespace respire {

// Flush-to-zero and denormals-are-zero as Embree wants them; the caller's mode comes back at the end of the scope.
class FloatMode {
 public:
  FloatMode() : saved_(_mm_getcsr()) { _mm_setcsr(saved_ | 0x8040u); }
  ~FloatMode() { _mm_setcsr(saved_); }
  FloatMode(const FloatMode&) = delete;
  FloatMode& operator=(const FloatMode&) = delete;

 private:
  unsigned saved_;
};

// Sums per pixel: direct (3), indirect (3), indirect from the base over its albedo (3), indirect from the coat (3),
// albedo (3), smooth normal (3), hits (1).
constexpr std::size_t kFilmChannels = 19;

// Per vertex: light that the base sends, over its albedo and times pi, by way of the wall (3); irradiance by other walls (3).
constexpr std::size_t kKnownValues = 6;

// Per face: the lamp's irradiance (3), what the base sends on of it (3), what is sent on to all sides alike of other light (3),
// centre (3), normal (3), what the coat mirrors of the lamp's light and of other light, over `glint`.
constexpr std::size_t kLampValues = 17;

// Between walls the coat's lobe is taken as this wide: a narrow one would be all noise with few rays per face.
constexpr float kWideAlpha = 0.3f;

// Of light that is not the lamp's the coat gets this part from about the lamp's side, the rest from all sides alike.
constexpr float kFromLampSide = 0.5f;

// In place of a face.
constexpr std::uint32_t kNothing = ~0u;

struct Surface {
  Vec3 point, geometric, smooth, shading;  // normals: unit, on the side of the viewer
  Vec3 albedo;
  float alpha;
};

class PathIntegrator {
 public:
  TileCounters counters{};

  PathIntegrator(const Tracer& tracer, const FrameSettings& frame)
      : tracer_(tracer),
        frame_(frame),
        light_{frame.light[0], frame.light[1], frame.light[2]},
        intensity_{frame.intensity[0], frame.intensity[1], frame.intensity[2]},
        background_{frame.background[0], frame.background[1], frame.background[2]},
        origin_{frame.origin[0], frame.origin[1], frame.origin[2]},
        light_axis_{frame.rotation[2], frame.rotation[5], frame.rotation[8]},
        limit_(frame.max_scatterings == 0 ? unlimited(tracer) : frame.max_scatterings) {}

  // Camera axes to world axes.
  Vec3 world_direction(Vec3 d) const {
    const auto& r = frame_.rotation;
    return {r[0] * d.x + r[1] * d.y + r[2] * d.z, r[3] * d.x + r[4] * d.y + r[5] * d.z,
            r[6] * d.x + r[7] * d.y + r[8] * d.z};
  }

  void camera_sample(Vec3 direction, const Hit* hit, Sampler& sampler, float* film) {
    ++counters.paths;
    if (!hit) {
      add(film, background_);
      return;
    }
    const Surface s = camera_surface(*hit, direction);
    const Frame frame(s.shading);
    const Vec3 o = upper(frame.local(-direction));
    Vec3 direct{}, base{}, mirrored{};
    switch (tracer_.subsurface_) {
      case Subsurface::kOff:
        direct = direct_light(s, frame, o, !frame_.light_at_camera, s.albedo);
        if (limit_ > 1) indirect_light(s, frame, o, sampler, base, mirrored);
        break;
      case Subsurface::kMatched:
        base = over(matched_light(s, direction, sampler), s.albedo);
        break;
      case Subsurface::kDiffuse:
        direct = direct_light(s, frame, o, !frame_.light_at_camera, Vec3{0, 0, 0});
        scattered_light(s, frame, o, sampler, base, mirrored);
    }
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

  // Albedo of the base where a camera ray hits.
  Vec3 camera_albedo(const Hit& hit, Vec3 direction) const { return camera_surface(hit, direction).albedo; }

 private:
  // Roulette ends every path long before; the bound only keeps a perfectly white closed room from running for ever.
  static constexpr std::uint32_t kLongestPath = 4096;
  // Scatterings below the surface are many more.
  static std::uint32_t unlimited(const Tracer& tracer) {
    return tracer.subsurface_ == Subsurface::kMatched ? 1u << 24 : kLongestPath;
  }
  // Origins are moved off the surface by this much, in mm.
  static constexpr float kOffset = 2e-4f;
  // Closer than this to the light nothing is lit more brightly, in mm^2.
  static constexpr float kNearest2 = 1e-4f;

  static void add(float* film, Vec3 v) { film[0] += v.x, film[1] += v.y, film[2] += v.z; }
  static bool valid(Vec3 v) { return v.x >= 0 && v.y >= 0 && v.z >= 0 && v.x + v.y + v.z < 1e30f; }
  // The viewer is above the surface; interpolated normals may say otherwise at the silhouette.
  static Vec3 upper(Vec3 o) {
    if (o.z >= 1e-3f) return o;
    return normalize({o.x, o.y, 1e-3f});
  }

  bool intersect(Vec3 from, Vec3 direction, Hit& hit) {
    RTCRayHit r;
    r.ray.org_x = from.x, r.ray.org_y = from.y, r.ray.org_z = from.z;
    r.ray.dir_x = direction.x, r.ray.dir_y = direction.y, r.ray.dir_z = direction.z;
    r.ray.tnear = 0, r.ray.tfar = 1e30f, r.ray.time = 0, r.ray.mask = ~0u, r.ray.id = 0, r.ray.flags = 0;
    r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    ++counters.rays;
    rtcIntersect1(tracer_.fast_, &r);
    const bool missed = r.hit.geomID == RTC_INVALID_GEOMETRY_ID;
    if (missed || r.hit.Ng_x * direction.x + r.hit.Ng_y * direction.y + r.hit.Ng_z * direction.z > 0.0f) {
      // Out of the mesh, or a wall seen from behind: perhaps through an edge. The robust scene decides.
      r.ray.tfar = 1e30f;
      r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
      r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
      ++counters.rays;
      rtcIntersect1(tracer_.robust_, &r);
      if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;
    }
    hit = {r.ray.tfar, r.hit.u, r.hit.v, r.hit.primID, {r.hit.Ng_x, r.hit.Ng_y, r.hit.Ng_z}};
    return true;
  }

  bool occluded(Vec3 from, Vec3 direction, float distance) {
    RTCRay r;
    r.org_x = from.x, r.org_y = from.y, r.org_z = from.z;
    r.dir_x = direction.x, r.dir_y = direction.y, r.dir_z = direction.z;
    r.tnear = 0, r.tfar = distance, r.time = 0, r.mask = ~0u, r.id = 0, r.flags = 0;
    ++counters.rays;
    rtcOccluded1(tracer_.fast_, &r);
    return r.tfar < 0;
  }

  static Vec3 interpolate(const float* values, const std::uint32_t* face, float u, float v) {
    return load(values + 3ull * face[0]) * (1.0f - u - v) + load(values + 3ull * face[1]) * u +
           load(values + 3ull * face[2]) * v;
  }

  // What every vertex of a path needs; colour from the vertices.
  Surface surface(const Hit& hit, Vec3 from, Vec3 direction) const {
    Surface s;
    s.point = from + direction * hit.t;
    s.geometric = normalize(hit.geometric);
    const float side = dot(s.geometric, direction) > 0 ? -1.0f : 1.0f;
    s.geometric = s.geometric * side;
    s.smooth = s.geometric;
    const std::uint32_t* face = tracer_.faces_ + 3ull * hit.face;
    if (frame_.smooth) {
      const Vec3 n = interpolate(tracer_.normals_.data(), face, hit.u, hit.v) * side;
      const float l2 = dot(n, n);
      if (l2 > 1e-6f) s.smooth = n * (1.0f / std::sqrt(l2));
    }
    if (!tracer_.ring_height_.empty()) {
      const Rise rise = ring_rise(face, hit.u, hit.v);
      s.smooth = bent(s.smooth, direction, face, {rise.first * side, rise.second * side});
    }
    s.shading = s.smooth;
    s.albedo = tracer_.mucosa_ ? interpolate(tracer_.vertex_albedo_.data(), face, hit.u, hit.v) : tracer_.albedo_;
    s.alpha = tracer_.mucosa_ ? 0.5f * (tracer_.alpha_low_ + tracer_.alpha_high_) : tracer_.alpha_low_;
    return s;
  }

  // How much something rises along two edges of a face, from its first corner.
  struct Rise {
    float first, second;
  };

  // The cartilage rings' relief. Rings are as wide as several faces: they bend the normal of every vertex of a path.
  Rise ring_rise(const std::uint32_t* face, float w1, float w2) const {
    const Tracer& t = tracer_;
    const float w0 = 1.0f - w1 - w2;
    const float height = w0 * t.ring_height_[face[0]] + w1 * t.ring_height_[face[1]] + w2 * t.ring_height_[face[2]];
    if (height <= 0.0f) return {0.0f, 0.0f};
    const float a0 = t.axial_mm_[face[0]], a1 = t.axial_mm_[face[1]], a2 = t.axial_mm_[face[2]];
    float slope;
    ring_profile(w0 * a0 + w1 * a1 + w2 * a2, t.look_.ring_spacing_mm, slope);
    return {height * slope * (a1 - a0), height * slope * (a2 - a0)};
  }

  // `normal` of a face whose surface rises so, seen along `direction`. (A relief's rise along two edges of the rest triangle is
  // its rise along the deformed ones.)
  Vec3 bent(Vec3 normal, Vec3 direction, const std::uint32_t* face, Rise rise) const {
    const Vec3 p0 = load(tracer_.vertices_ + 3ull * face[0]);
    const Vec3 e1 = load(tracer_.vertices_ + 3ull * face[1]) - p0, e2 = load(tracer_.vertices_ + 3ull * face[2]) - p0;
    const Vec3 n = cross(e1, e2);
    const float n2 = dot(n, n);
    if (n2 <= 1e-20f) return normal;
    const Vec3 steep = normal - (cross(e2, n) * rise.first + cross(n, e1) * rise.second) * (1.0f / n2);
    const float away = dot(steep, -direction);
    const float length = std::sqrt(dot(direction, direction));
    // A normal that looks away from the viewer is bent back just into view.
    return normalize(away > 0.02f * length ? steep : steep - direction * ((0.02f - away / length) / length));
  }

  // The first vertex: with vessels, film and fine relief.
  Surface camera_surface(const Hit& hit, Vec3 direction) const {
    Surface s = surface(hit, origin_, direction);
    if (!tracer_.mucosa_) return s;
    const Tracer& t = tracer_;
    const std::uint32_t* face = t.faces_ + 3ull * hit.face;
    const float w[3] = {1.0f - hit.u - hit.v, hit.u, hit.v};
    auto scalar = [&](const std::vector<float>& values) {
      return w[0] * values[face[0]] + w[1] * values[face[1]] + w[2] * values[face[2]];
    };
    const Vec3 rest0 = load(&t.rest_[3ull * face[0]]);
    const Vec3 rest1 = load(&t.rest_[3ull * face[1]]) - rest0, rest2 = load(&t.rest_[3ull * face[2]]) - rest0;
    const MucosaPoint m = mucosa_at(t.look_, t.albedo_, rest0 + rest1 * hit.u + rest2 * hit.v,
                                    unit_or_zero(cross(rest1, rest2)), scalar(t.axial_mm_), scalar(t.ring_weight_),
                                    scalar(t.generations_), hit.t * frame_.pixel_angle);
    s.albedo = m.albedo;
    const float alpha = mix(t.alpha_low_, t.alpha_high_, m.roughness);
    s.alpha = std::sqrt(alpha * alpha + 2.0f * m.unseen_slope2);
    s.shading = bent(s.smooth, direction, face, {dot(m.height_gradient, rest1), dot(m.height_gradient, rest2)});
    return s;
  }

  // The light's profile: the part of its intensity in a direction of this cosine to its axis (the camera's).
  float emission(float cosine) const {
    if (frame_.emission_exponent == 0.0f) return 1.0f;
    cosine = clamp(cosine, 0.0f, 1.0f);
    return frame_.emission_exponent == 1.0f ? cosine : std::pow(cosine, frame_.emission_exponent);
  }

  // Radiance towards `o` by the light itself, from a base of albedo `rho`.
  Vec3 direct_light(const Surface& s, const Frame& frame, Vec3 o, bool shadows, Vec3 rho) {
    const Vec3 to_light = light_ - s.point;
    const float r2 = std::max(dot(to_light, to_light), kNearest2), r = std::sqrt(r2);
    const Vec3 direction = to_light * (1.0f / r);
    const float cosine = dot(s.shading, direction);
    if (cosine <= 0.0f || dot(s.geometric, direction) <= 0.0f) return {0, 0, 0};
    if (shadows && occluded(s.point + s.geometric * kOffset, direction, r * (1.0f - 1e-5f) - kOffset)) return {0, 0, 0};
    const Vec3 irradiance = intensity_ * (emission(-dot(direction, light_axis_)) * cosine / r2);
    if (!tracer_.coated_) return irradiance * rho * (1.0f / kPi);
    const float e = tracer_.coat_.albedo(s.alpha, o.z);
    const float mirrored = tracer_.coat_.value(o, frame.local(direction), s.alpha);
    return irradiance * (rho * ((1.0f - e) / kPi) + Vec3{mirrored, mirrored, mirrored});
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

  static Vec3 cosine_direction(float u, float v) {
    float c, s;
    cos_sin_turns(v, c, s);
    const float r = std::sqrt(u);
    return {r * c, r * s, std::sqrt(1.0f - u)};
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

  static Vec3 over(Vec3 a, Vec3 b) {
    return {b.x > 0 ? a.x / b.x : 0.0f, b.y > 0 ? a.y / b.y : 0.0f, b.z > 0 ? a.z / b.z : 0.0f};
  }

  // A point of the surface as seen from the lumen, where light comes out of the wall along `direction`.
  Surface exit_surface(const Hit& hit, Vec3 point, Vec3 direction) const {
    const Vec3 inwards = dot(hit.geometric, direction) > 0.0f ? -hit.geometric : hit.geometric;
    Surface s = surface(hit, point, inwards);
    s.point = point;
    return s;
  }

  // Irradiance of the lamp.
  Vec3 irradiance(const Surface& s, bool shadows) {
    const Vec3 to_light = light_ - s.point;
    const float r2 = std::max(dot(to_light, to_light), kNearest2), r = std::sqrt(r2);
    const Vec3 direction = to_light * (1.0f / r);
    const float cosine = dot(s.shading, direction);
    if (cosine <= 0.0f || dot(s.geometric, direction) <= 0.0f) return {0, 0, 0};
    if (shadows && occluded(s.point + s.geometric * kOffset, direction, r * (1.0f - 1e-5f) - kOffset)) return {0, 0, 0};
    return intensity_ * (emission(-dot(direction, light_axis_)) * cosine / r2);
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

  // Part of the lamp's light that base and coat send back to all sides.
  Vec3 lamp_reflectance(const Surface& s) const {
    if (!tracer_.coated_) return s.albedo;
    const float mean = tracer_.mean_coat_;
    const float e = tracer_.coat_.albedo(s.alpha, std::max(dot(s.shading, normalize(light_ - s.point)), 0.0f));
    return s.albedo * (1.0f - mean) + Vec3{e, e, e};
  }

  // A point of a face as seen from the lumen.
  Surface face_surface(std::uint32_t face, float u, float v) const {
    const std::uint32_t* corners = tracer_.faces_ + 3ull * face;
    const Vec3 p0 = load(tracer_.vertices_ + 3ull * corners[0]);
    const Vec3 e1 = load(tracer_.vertices_ + 3ull * corners[1]) - p0, e2 = load(tracer_.vertices_ + 3ull * corners[2]) - p0;
    const Vec3 normal = cross(e1, e2), point = p0 + e1 * u + e2 * v;
    // `surface` looks along a ray: one that comes from above.
    Surface s = surface(Hit{0.0f, u, v, face, normal}, point, -normal);
    s.point = point;
    return s;
  }

  // Axes with normal `n` that turn with the face.
  Frame tissue_frame(std::uint32_t face, Vec3 n) const {
    const std::uint32_t* corners = tracer_.faces_ + 3ull * face;
    const Vec3 edge = load(tracer_.vertices_ + 3ull * corners[1]) - load(tracer_.vertices_ + 3ull * corners[0]);
    Frame frame(n);
    const Vec3 along = edge - n * dot(edge, n);
    const float l2 = dot(along, along);
    if (l2 > 1e-12f) frame.t = along * (1.0f / std::sqrt(l2)), frame.b = cross(n, frame.t);
    return frame;
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

  // One sample of what leaves the wall at `at` by way of a walk that starts there: radiance (towards every side), its
  // first scattering included. `towards`: unit direction to
  // where the path comes from. `carried`: throughput before (for roulette only).
  Vec3 walked_light(const Surface& at, Vec3 towards, Vec3 carried, std::uint32_t scattering, Sampler& sampler) {
    const Medium medium = tracer_.medium(at.albedo);
    const RandomWalk walk(tracer_.fast_, medium, counters.rays);
    float u, v;
    const Frame entry(at.geometric);
    Vec3 point = at.point, throughput, inwards;
    if (!entry_direction(upper(entry.local(towards)), sampler, inwards)) return {0, 0, 0};
    inwards = entry.world(inwards);
    Hit hit;
    if (!walk.leave(point, inwards, sampler, throughput, hit)) return {0, 0, 0};
    const Surface s = exit_surface(hit, point, inwards);
    const float survival = scattering > 1 ? std::min(max_component(carried * throughput), 1.0f) : 1.0f;
    Vec3 light = irradiance(s, true) * (1.0f / kPi);
    if (scattering < limit_ && (survival >= 1.0f || sampler.random() < survival)) {
      sampler.next2(u, v);
      const Vec3 direction = Frame(s.shading).world(cosine_direction(u, v));
      const Vec3 onwards = carried * throughput * (1.0f / survival);
      if (dot(direction, s.geometric) > 0.0f)
        light += incoming(s.point + s.geometric * kOffset, direction, onwards, scattering + 1, sampler) * (1.0f / survival);
    }
    return throughput * light;
  }

  // What the first vertex of a subsurface material sends: by its base over its albedo, and mirrored by its coat.
  void scattered_light(const Surface& s, const Frame& frame, Vec3 o, Sampler& sampler, Vec3& base, Vec3& mirrored) {
    float share = 1.0f;
    if (tracer_.coated_) {
      const float e = tracer_.coat_.albedo(s.alpha, o.z);
      const float p_coat = e / (e + (1.0f - e) * max_component(s.albedo) + 1e-6f);
      if (sampler.next1() < p_coat) {
        if (limit_ > 1) mirrored = mirrored_light(s, frame, o, sampler) * (1.0f / p_coat);
        return;
      }
      share = (1.0f - e) / (1.0f - p_coat);
    }
    base = over(walked_light(s, frame.world(o), Vec3{share, share, share}, 1, sampler), s.albedo) * share;
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
  Vec3 mirrored_light(const Surface& s, const Frame& frame, Vec3 o, Sampler& sampler) {
    Vec3 direction;
    float weight;
    if (!mirrored_direction(s, frame, o, sampler, direction, weight)) return {0, 0, 0};
    return incoming(s.point + s.geometric * kOffset, direction, Vec3{weight, weight, weight}, 2, sampler) * weight;
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

  const Tracer& tracer_;
  const FrameSettings& frame_;
  Vec3 light_, intensity_, background_, origin_, light_axis_;
  std::uint32_t limit_;
};

}  // namespace respire
