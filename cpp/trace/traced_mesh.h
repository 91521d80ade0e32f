#pragma once
// One triangle mesh in Embree 4, and the rays through it.
//
// The mesh lies in two scenes over the same buffers: `robust` lets no ray through an edge, `fast` does so a few times
// in 1e7 at three quarters of the cost. Both are refitted, not rebuilt, when the vertices move. Embree wants
// flush-to-zero while it runs: whoever casts rays holds a `FloatMode`.
//
// Embree says which face a ray hits. Where on it is computed here (`TracedMesh::placed`): Embree divides by the
// processor's approximate reciprocal, whose last bits differ between makers, and films must not.

#include <embree4/rtcore.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "cpp/trace/vector.h"
#include "rust/cxx.h"

namespace respire {

// The face index where nothing was hit.
constexpr std::uint32_t NO_FACE = ~0u;

// Origins of rays are moved off the surface by this much, in mm: more than ten times the rounding of a coordinate of
// 200 mm.
constexpr float SURFACE_OFFSET = 2e-4f;

// Length in mm from which the end of a ray, whose rounding grows with it, may lie further off its face than
// SURFACE_OFFSET. No airway is as long; scenes may be seen from further away.
constexpr float LONG_RAY = 400.0f;

// Where a ray hits the mesh: distance, barycentric weights of the face's second and third corner, face, and its normal
// as wound (not normalised).
struct Hit {
  float t, u, v;
  std::uint32_t face;
  Vec3 geometric;
};

class TracedMesh;

// Up to eight rays traced as one packet.
class RayPacket {
 public:
  // Rays per packet: AVX2 has eight lanes of float.
  static constexpr std::size_t WIDTH = 8;

  // The first `count` lanes' rays; `origins` and `directions` are xyz interleaved, `origin_stride` floats lie between
  // two origins (0: one for all).
  void aim(const float* origins, std::size_t origin_stride, const float* directions, std::size_t count);

  // Camera rays of one packet are coherent, rays in all directions are not: Embree traverses them differently.
  enum class Bundle { COHERENT, SCATTERED };
  void trace(RTCScene scene, Bundle bundle);

  // Whether a lane's ray has met the mesh that was traced, and where.
  bool hit(const TracedMesh& mesh, std::size_t lane, Hit& hit) const;

 private:
  RTCRayHit8 rays_;
  alignas(32) int valid_[WIDTH];
};

// Owns an Embree object.
template <class T, void (*Release)(T)>
class Handle {
 public:
  Handle() = default;
  ~Handle() { reset(nullptr); }
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  void reset(T object) {
    if (object_) Release(object_);
    object_ = object;
  }
  operator T() const { return object_; }

 private:
  T object_ = nullptr;
};

// Reading is const and may happen on many threads at once; `update` and `refit` may not.
class TracedMesh {
 public:
  // xyz interleaved, three indices per face. Throws on indices that fit no vertex and where Embree refuses.
  TracedMesh(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces);

  // New positions, as many as at construction. Throws std::invalid_argument on a wrong length.
  void update(rust::Slice<const float> vertices);

  // Refits both hierarchies to the current vertices: Embree's part of `update`.
  void refit();

  std::size_t vertex_count() const { return vertex_count_; }
  std::size_t face_count() const { return face_count_; }
  const std::uint32_t* corners(std::uint32_t face) const { return faces_ + 3ull * face; }
  Vec3 position(std::uint32_t vertex) const { return load(vertices_ + 3ull * vertex); }
  // The point of a face that was hit.
  Vec3 point(const Hit& hit) const {
    const std::uint32_t* c = corners(hit.face);
    const Vec3 a = position(c[0]);
    return a + (position(c[1]) - a) * hit.u + (position(c[2]) - a) * hit.v;
  }
  // Area-weighted unit normals of the vertices, xyz interleaved.
  const float* normals() const { return normals_.data(); }
  // Which corner of a face a vertex is.
  std::uint32_t corner_of(std::uint32_t face, std::uint32_t vertex) const {
    const std::uint32_t* c = corners(face);
    return c[0] == vertex ? 0 : c[1] == vertex ? 1 : 2;
  }

  RTCScene robust() const { return robust_; }
  RTCScene fast() const { return fast_; }

  // Where the ray that hits `face` crosses its plane, by exact divisions; `t` is Embree's distance, which stays where
  // the ray lies in the plane.
  Hit placed(std::uint32_t face, Vec3 from, Vec3 direction, float t) const {
    const std::uint32_t* c = corners(face);
    const Vec3 a = position(c[0]), edge1 = position(c[1]) - a, edge2 = position(c[2]) - a;
    // Moeller and Trumbore 1997: with C from the origin to the first corner, n = e1 x e2 and R = C x d,
    //   t = C.n / d.n,  u = R.e2 / d.n,  v = -R.e1 / d.n.
    const Vec3 normal = cross(edge1, edge2), to_corner = a - from, r = cross(to_corner, direction);
    const float along = dot(direction, normal);
    if (along == 0.0f) return {t, 0.0f, 0.0f, face, normal};
    // Rounding must not put the point outside of the face or behind the origin.
    const float u = clamp(dot(r, edge2) / along, 0.0f, 1.0f), v = clamp(-dot(r, edge1) / along, 0.0f, 1.0f - u);
    return {std::max(dot(to_corner, normal) / along, 0.0f), u, v, face, normal};
  }

 private:
  void update_normals();
  void require_no_error() const;

  // Declared in the order of creation, so that they are released in reverse.
  Handle<RTCDevice, rtcReleaseDevice> device_;
  Handle<RTCScene, rtcReleaseScene> robust_, fast_;
  Handle<RTCGeometry, rtcReleaseGeometry> geometry_;
  // These point into Embree's buffers.
  const float* vertices_{};
  const std::uint32_t* faces_{};
  std::size_t vertex_count_, face_count_;
  std::vector<float> normals_;
};

// Linear interpolation over a face of three `values` per vertex.
inline Vec3 interpolate(const float* values, const std::uint32_t* corners, float u, float v) {
  return load(values + 3ull * corners[0]) * (1.0f - u - v) + load(values + 3ull * corners[1]) * u +
         load(values + 3ull * corners[2]) * v;
}

// A single ray in Embree's form.
inline RTCRay ray_of(Vec3 from, Vec3 direction, float near, float far) {
  RTCRay ray;
  ray.org_x = from.x, ray.org_y = from.y, ray.org_z = from.z;
  ray.dir_x = direction.x, ray.dir_y = direction.y, ray.dir_z = direction.z;
  ray.tnear = near, ray.tfar = far, ray.time = 0, ray.mask = ~0u, ray.id = 0, ray.flags = 0;
  return ray;
}

// The first hit of a ray in one of a mesh's two scenes, between the ray's near and far end.
inline bool first_hit(const TracedMesh& mesh, RTCScene scene, const RTCRay& ray, Hit& hit) {
  RTCRayHit r;
  r.ray = ray;
  r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(scene, &r);
  if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;
  hit = mesh.placed(r.hit.primID, {ray.org_x, ray.org_y, ray.org_z}, {ray.dir_x, ray.dir_y, ray.dir_z}, r.ray.tfar);
  return true;
}

// Rays between walls, counted.
class RayCaster {
 public:
  explicit RayCaster(const TracedMesh& mesh) : mesh_(mesh) {}

  // Rays of all kinds so far; what casts rays past this class counts them here as well.
  std::uint64_t rays = 0;

  bool intersect(Vec3 from, Vec3 direction, Hit& hit) {
    const RTCRay ray = ray_of(from, direction, 0.0f, 1e30f);
    ++rays;
    if (first_hit(mesh_, mesh_.fast(), ray, hit) && !(dot(hit.geometric, direction) > 0.0f)) return true;
    // The ray left the mesh or hit a wall from behind, perhaps after slipping through an edge: the robust scene
    // decides.
    ++rays;
    return first_hit(mesh_, mesh_.robust(), ray, hit);
  }

  bool occluded(Vec3 from, Vec3 direction, float distance) {
    RTCRay ray = ray_of(from, direction, 0.0f, distance);
    ++rays;
    rtcOccluded1(mesh_.fast(), &ray);
    return ray.tfar < 0;
  }

 private:
  const TracedMesh& mesh_;
};

}  // namespace respire
