#pragma once
// The path tracer's interface to Rust (`src/ffi/trace/tracer.rs` has the records and the meaning of each call). Every
// call takes whole arrays: a border crossed per ray would cost more than the ray.

#include <cstdint>
#include <memory>

#include "cpp/trace/traced_mesh.h"
#include "rust/cxx.h"

namespace respire {

struct FaceLight;
struct FacePlace;
struct FacesAround;
struct FilmPixel;
struct FlatWalks;
struct FrameSettings;
struct Glint;
struct GradientNoise;
struct KnownLight;
struct MaterialSettings;
struct NoiseNeighbour;
struct ProbedPoint;
struct RestVertex;
struct ScatterExit;
struct TileCounters;
struct TileRequest;
class WallMaterial;

// A mesh and its material. Tracing is const and may run on many threads at once; `update` and `refit` may not.
class Tracer {
 public:
  Tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces, rust::Slice<const RestVertex> rest,
         const MaterialSettings& material);
  ~Tracer();

  void update(rust::Slice<const float> vertices) { mesh_.update(vertices); }
  void refit() { mesh_.refit(); }

  TileCounters trace_tile(const FrameSettings& frame, const TileRequest& tile, rust::Slice<const float> corners,
                          rust::Slice<const KnownLight> known, rust::Slice<FilmPixel> film) const;
  void probe_depth(const FrameSettings& frame, rust::Slice<const float> directions, rust::Slice<float> distances,
                   rust::Slice<std::uint32_t> faces) const;
  void probe(const FrameSettings& frame, rust::Slice<const float> directions, rust::Slice<ProbedPoint> points) const;
  void cast(rust::Slice<const float> origins, rust::Slice<const float> directions, rust::Slice<float> distances) const;

  std::uint64_t lamp_on_faces(const FrameSettings& frame, rust::Slice<const std::uint32_t> faces,
                              rust::Slice<FaceLight> light) const;
  void glints(const FrameSettings& frame, rust::Slice<const FaceLight> light, rust::Slice<const std::uint32_t> to,
              rust::Slice<const std::uint32_t> from, rust::Slice<Glint> glints) const;
  std::uint64_t gather(const FrameSettings& frame, rust::Slice<const std::uint32_t> faces,
                       rust::Slice<std::uint32_t> hits) const;
  std::uint64_t scatter_walks(const FrameSettings& frame, rust::Slice<const std::uint32_t> vertices,
                              const FacesAround& around, rust::Slice<ScatterExit> exits,
                              rust::Slice<FlatWalks> flat) const;
  void unshadowed(const FrameSettings& frame, rust::Slice<const FacePlace> places, rust::Slice<float> irradiance) const;
  void unshadowed_around(const FrameSettings& frame, rust::Slice<const std::uint32_t> vertices,
                         const FacesAround& around, rust::Slice<float> irradiance) const;

 private:
  TracedMesh mesh_;
  std::unique_ptr<const WallMaterial> material_;
};

std::unique_ptr<Tracer> new_tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces,
                                   rust::Slice<const RestVertex> rest, const MaterialSettings& material);

// For tests.
float coat_albedo(float alpha, float ior, float cosine);
float medium_albedo(float rho);
void sobol_pair(std::uint32_t key, std::uint32_t index, std::uint32_t dimension, rust::Slice<float> pair);
GradientNoise gradient_noise(std::uint8_t isa, rust::Slice<const float> point, std::uint32_t seed);
void noise_neighbours(std::uint8_t isa, rust::Slice<const float> point, std::uint32_t seed,
                      rust::Slice<NoiseNeighbour> nearest);

}  // namespace respire
