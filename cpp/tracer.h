#pragma once
#include <embree4/rtcore.h>

#include <cstdint>
#include <memory>

#include "rust/cxx.h"

namespace respire {

// One triangle mesh in an Embree scene that is refitted, not rebuilt, when its vertices move.
class Tracer {
 public:
  Tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces);
  ~Tracer();
  Tracer(const Tracer&) = delete;
  Tracer& operator=(const Tracer&) = delete;

  // New positions (xyz interleaved, as many as at construction). Throws std::invalid_argument on a wrong length.
  void update(rust::Slice<const float> vertices);

 private:
  RTCDevice device_{};
  RTCScene scene_{};
  RTCGeometry geometry_{};
  std::size_t vertex_floats_{};
};

std::unique_ptr<Tracer> new_tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces);

}  // namespace respire
