#pragma once
// What rays meet: a ray's first hit, and the wall there as a path's vertex sees it (normals, colour, roughness).
//
// Fine detail (vessels, film, fine relief) is evaluated where the camera sees it; later vertices see the wall's mean colour
// and the cartilage rings' relief.

#include <embree4/rtcore.h>

#include <cmath>

#include "cpp/trace/tracer.h"
#include "cpp/trace/vector.h"
#include "cpp/trace/scatter_walk.h"
#include "respire-bench/src/ffi/trace/tracer.rs.h"

namespace respire {

// In place of a face.
constexpr std::uint32_t kNothing = ~0u;

struct Surface {
  Vec3 point, geometric, smooth, shading;  // normals: unit, on the side of the viewer
  Vec3 albedo;
  float alpha;
};

// The shape and look that one frame's rays meet.
class Wall {
 public:
  TileCounters counters{};

  Wall(const Tracer& tracer, const FrameSettings& frame)
      : tracer_(tracer), frame_(frame), origin_{frame.origin[0], frame.origin[1], frame.origin[2]} {}

  // Camera axes to world axes.
  Vec3 world_direction(Vec3 d) const {
    const auto& r = frame_.rotation;
    return {r[0] * d.x + r[1] * d.y + r[2] * d.z, r[3] * d.x + r[4] * d.y + r[5] * d.z,
            r[6] * d.x + r[7] * d.y + r[8] * d.z};
  }

  // Albedo of the base where a camera ray hits.
  Vec3 camera_albedo(const Hit& hit, Vec3 direction) const { return camera_surface(hit, direction).albedo; }

 protected:
  // Origins are moved off the surface by this much, in mm.
  static constexpr float kOffset = 2e-4f;

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
    const MucosaPoint m = mucosa_at(t.noise_, t.look_, t.albedo_, rest0 + rest1 * hit.u + rest2 * hit.v,
                                    unit_or_zero(cross(rest1, rest2)), scalar(t.axial_mm_), scalar(t.ring_weight_),
                                    scalar(t.generations_), hit.t * frame_.pixel_angle);
    s.albedo = m.albedo;
    const float alpha = mix(t.alpha_low_, t.alpha_high_, m.roughness);
    s.alpha = std::sqrt(alpha * alpha + 2.0f * m.unseen_slope2);
    s.shading = bent(s.smooth, direction, face, {dot(m.height_gradient, rest1), dot(m.height_gradient, rest2)});
    return s;
  }

  // A point of the surface as seen from the lumen, where light comes out of the wall along `direction`.
  Surface exit_surface(const Hit& hit, Vec3 point, Vec3 direction) const {
    const Vec3 inwards = dot(hit.geometric, direction) > 0.0f ? -hit.geometric : hit.geometric;
    Surface s = surface(hit, point, inwards);
    s.point = point;
    return s;
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

  const Tracer& tracer_;
  const FrameSettings& frame_;
  Vec3 origin_;
};

}  // namespace respire
