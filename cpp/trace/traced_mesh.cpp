#include "cpp/trace/traced_mesh.h"

#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>

#include "cpp/common/float_mode.h"
#include "cpp/common/require.h"

namespace respire {

void RayPacket::aim(const float* origins, std::size_t origin_stride, const float* directions, std::size_t count) {
  for (std::size_t lane = 0; lane < WIDTH; ++lane) {
    std::size_t source = lane < count ? lane : 0;
    valid_[lane] = lane < count ? -1 : 0;
    const float *o = origins + origin_stride * source, *d = directions + 3 * source;
    rays_.ray.org_x[lane] = o[0], rays_.ray.org_y[lane] = o[1], rays_.ray.org_z[lane] = o[2];
    rays_.ray.dir_x[lane] = d[0], rays_.ray.dir_y[lane] = d[1], rays_.ray.dir_z[lane] = d[2];
    rays_.ray.tnear[lane] = 0, rays_.ray.tfar[lane] = std::numeric_limits<float>::infinity(), rays_.ray.time[lane] = 0;
    rays_.ray.mask[lane] = ~0u, rays_.ray.id[lane] = 0, rays_.ray.flags[lane] = 0;
    rays_.hit.geomID[lane] = RTC_INVALID_GEOMETRY_ID;
    rays_.hit.instID[0][lane] = RTC_INVALID_GEOMETRY_ID;
  }
}

void RayPacket::trace(RTCScene scene, Bundle bundle) {
  RTCIntersectArguments arguments;
  rtcInitIntersectArguments(&arguments);
  arguments.flags = bundle == Bundle::COHERENT ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
  rtcIntersect8(valid_, scene, &rays_, &arguments);
}

bool RayPacket::hit(const TracedMesh& mesh, std::size_t lane, Hit& hit) const {
  if (rays_.hit.geomID[lane] == RTC_INVALID_GEOMETRY_ID) return false;
  const auto& ray = rays_.ray;
  hit = mesh.placed(rays_.hit.primID[lane], {ray.org_x[lane], ray.org_y[lane], ray.org_z[lane]},
                    {ray.dir_x[lane], ray.dir_y[lane], ray.dir_z[lane]}, ray.tfar[lane]);
  return true;
}

TracedMesh::TracedMesh(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces)
    : vertex_count_(vertices.size() / 3), face_count_(faces.size() / 3) {
  require(vertices.size() % 3 == 0 && faces.size() % 3 == 0, "vertex and index lengths must be multiples of 3");
  for (std::uint32_t v : faces) require(v < vertex_count_, "a face names a vertex that is not there");
  FloatMode mode;
  device_.reset(rtcNewDevice("isa=avx2"));
  if (!device_)
    throw std::runtime_error("Embree refuses a device: error " + std::to_string(rtcGetDeviceError(nullptr)));
  robust_.reset(rtcNewScene(device_));
  fast_.reset(rtcNewScene(device_));
  // Two-level mode: the only one that refits.
  rtcSetSceneBuildQuality(robust_, RTC_BUILD_QUALITY_LOW);
  rtcSetSceneBuildQuality(fast_, RTC_BUILD_QUALITY_LOW);
  rtcSetSceneFlags(robust_, static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_DYNAMIC | RTC_SCENE_FLAG_ROBUST));
  rtcSetSceneFlags(fast_, RTC_SCENE_FLAG_DYNAMIC);
  geometry_.reset(rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE));
  rtcSetGeometryBuildQuality(geometry_, RTC_BUILD_QUALITY_REFIT);
  void* v = rtcSetNewGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, vertex_count_);
  void* f = rtcSetNewGeometryBuffer(geometry_, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, face_count_);
  if (!v || !f) throw std::runtime_error("Embree has no memory for the mesh");
  std::memcpy(v, vertices.data(), vertices.size() * sizeof(float));
  std::memcpy(f, faces.data(), faces.size() * sizeof(std::uint32_t));
  vertices_ = static_cast<const float*>(v);
  faces_ = static_cast<const std::uint32_t*>(f);
  rtcCommitGeometry(geometry_);
  for (RTCScene scene : {static_cast<RTCScene>(robust_), static_cast<RTCScene>(fast_)}) {
    rtcAttachGeometry(scene, geometry_);
    rtcCommitScene(scene);
  }
  require_no_error();
  update_normals();
}

// Embree's functions say nothing when they fail: the device remembers the first error.
void TracedMesh::require_no_error() const {
  const RTCError error = rtcGetDeviceError(device_);
  if (error != RTC_ERROR_NONE) throw std::runtime_error("Embree reports error " + std::to_string(error));
}

void TracedMesh::update(rust::Slice<const float> vertices) {
  require(vertices.size() == 3 * vertex_count_, "the number of vertices cannot change");
  FloatMode mode;
  void* v = rtcGetGeometryBufferData(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
  if (std::memcmp(v, vertices.data(), vertices.size() * sizeof(float)) == 0) return;
  std::memcpy(v, vertices.data(), vertices.size() * sizeof(float));
  refit();
  update_normals();
}

void TracedMesh::refit() {
  FloatMode mode;
  rtcUpdateGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
  rtcCommitGeometry(geometry_);
  rtcCommitScene(robust_);
  rtcCommitScene(fast_);
  require_no_error();
}

// The area-weighted normals of the faces around each vertex, summed and normalised.
void TracedMesh::update_normals() {
  normals_.assign(3 * vertex_count_, 0.0f);
  for (std::size_t f = 0; f < face_count_; ++f) {
    const std::uint32_t* face = faces_ + 3 * f;
    Vec3 a = position(face[0]), b = position(face[1]), c = position(face[2]);
    Vec3 normal = cross(b - a, c - a);
    for (int k = 0; k < 3; ++k) {
      float* n = &normals_[3ull * face[k]];
      n[0] += normal.x, n[1] += normal.y, n[2] += normal.z;
    }
  }
  for (std::size_t v = 0; v < normals_.size(); v += 3) {
    Vec3 n = load(&normals_[v]);
    float l = length(n);
    if (l > 0.0f) store(&normals_[v], n * (1.0f / l));
  }
}

}  // namespace respire
