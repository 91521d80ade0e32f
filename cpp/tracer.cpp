#include "cpp/tracer.h"

#include <cstring>
#include <stdexcept>
#include <string>

namespace respire {

Tracer::Tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces)
    : vertex_floats_(vertices.size()) {
  if (vertices.size() % 3 || faces.size() % 3) {
    throw std::invalid_argument("vertex and index lengths must be multiples of 3");
  }
  device_ = rtcNewDevice("isa=avx2");
  if (!device_) throw std::runtime_error("Embree refuses a device: error " + std::to_string(rtcGetDeviceError(nullptr)));
  scene_ = rtcNewScene(device_);
  // Two-level mode: the only one that refits (docs/BUILD.md).
  rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_LOW);
  rtcSetSceneFlags(scene_, static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_DYNAMIC | RTC_SCENE_FLAG_ROBUST));
  geometry_ = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetGeometryBuildQuality(geometry_, RTC_BUILD_QUALITY_REFIT);
  void* v = rtcSetNewGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, vertices.size() / 3);
  void* f = rtcSetNewGeometryBuffer(geometry_, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, faces.size() / 3);
  std::memcpy(v, vertices.data(), vertices.size() * sizeof(float));
  std::memcpy(f, faces.data(), faces.size() * sizeof(std::uint32_t));
  rtcCommitGeometry(geometry_);
  rtcAttachGeometry(scene_, geometry_);
  rtcCommitScene(scene_);
}

Tracer::~Tracer() {
  if (geometry_) rtcReleaseGeometry(geometry_);
  if (scene_) rtcReleaseScene(scene_);
  if (device_) rtcReleaseDevice(device_);
}

void Tracer::update(rust::Slice<const float> vertices) {
  if (vertices.size() != vertex_floats_) throw std::invalid_argument("the number of vertices cannot change");
  void* v = rtcGetGeometryBufferData(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
  std::memcpy(v, vertices.data(), vertices.size() * sizeof(float));
  rtcUpdateGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
  rtcCommitGeometry(geometry_);
  rtcCommitScene(scene_);
}

std::unique_ptr<Tracer> new_tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces) {
  return std::make_unique<Tracer>(vertices, faces);
}

}  // namespace respire
