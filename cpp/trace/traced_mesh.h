#pragma once
// One triangle mesh in Embree 4, and the rays through it.
//
// The mesh lies in two scenes over the same buffers: `robust` lets no ray through an edge, `fast` does so a few times
// in 1e7 at three quarters of the cost. Both are refitted, not rebuilt, when the vertices move. Embree wants
// flush-to-zero while it runs: whoever casts rays holds a `FloatMode`.

#include <embree4/rtcore.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "cpp/trace/vector.h"
#include "rust/cxx.h"

namespace respire {

// The face index where nothing was hit.
constexpr std::uint32_t kNoFace = ~0u;

// Origins of rays are moved off the surface by this much, in mm: more than ten times the rounding of a coordinate of
// 200 mm.
constexpr float kSurfaceOffset = 2e-4f;

// Where a ray hits the mesh: distance, barycentric weights of the face's second and third corner, face, and its normal
// as wound (not normalised).
struct Hit {
  float t, u, v;
  std::uint32_t face;
  Vec3 geometric;
};

// Up to eight rays traced as one packet.
class RayPacket {
 public:
  // Rays per packet: AVX2 has eight lanes of float.
  static constexpr std::size_t kWidth = 8;

  // The first `count` lanes' rays; `origins` and `directions` are xyz interleaved, `origin_stride` floats lie between
  // two origins (0: one for all).
  void aim(const float* origins, std::size_t origin_stride, const float* directions, std::size_t count);

  // Camera rays of one packet are coherent, rays in all directions are not: Embree traverses them differently.
  enum class Bundle { kCoherent, kScattered };
  void trace(RTCScene scene, Bundle bundle);

  // Whether a lane's ray has met the mesh, and where.
  bool hit(std::size_t lane, Hit& hit) const {
    if (rays_.hit.geomID[lane] == RTC_INVALID_GEOMETRY_ID) return false;
    hit = {rays_.ray.tfar[lane],
           rays_.hit.u[lane],
           rays_.hit.v[lane],
           rays_.hit.primID[lane],
           {rays_.hit.Ng_x[lane], rays_.hit.Ng_y[lane], rays_.hit.Ng_z[lane]}};
    return true;
  }

 private:
  RTCRayHit8 rays_;
  alignas(32) int valid_[kWidth];
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
  // Area-weighted unit normals of the vertices, xyz interleaved.
  const float* normals() const { return normals_.data(); }
  // Which corner of a face a vertex is.
  std::uint32_t corner_of(std::uint32_t face, std::uint32_t vertex) const {
    const std::uint32_t* c = corners(face);
    return c[0] == vertex ? 0 : c[1] == vertex ? 1 : 2;
  }

  RTCScene robust() const { return robust_; }
  RTCScene fast() const { return fast_; }

 private:
  void update_normals();
  void demand_no_error() const;

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

// The first hit of a ray in a scene, between `near` and `far`.
inline bool first_hit(RTCScene scene, const RTCRay& ray, Hit& hit) {
  RTCRayHit r;
  r.ray = ray;
  r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(scene, &r);
  if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;
  hit = {r.ray.tfar, r.hit.u, r.hit.v, r.hit.primID, {r.hit.Ng_x, r.hit.Ng_y, r.hit.Ng_z}};
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
    if (first_hit(mesh_.fast(), ray, hit) && !(dot(hit.geometric, direction) > 0.0f)) return true;
    // The ray left the mesh or hit a wall from behind, perhaps after slipping through an edge: the robust scene
    // decides.
    ++rays;
    return first_hit(mesh_.robust(), ray, hit);
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
