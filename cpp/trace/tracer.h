#pragma once
#include <embree4/rtcore.h>

#include <cstdint>
#include <memory>
#include <vector>

#include "cpp/trace/coat.h"
#include "cpp/trace/mucosa.h"
#include "cpp/trace/vector.h"
#include "cpp/trace/scatter_walk.h"
#include "rust/cxx.h"

namespace respire {

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

struct MaterialSettings;

// How the base's light gets through the wall.
enum class Subsurface { kOff, kDiffuse, kMatched };

struct FrameSettings;
struct Tile;
struct TileCounters;

// One triangle mesh in an Embree scene that is refitted, not rebuilt, when its vertices move; its material; and the
// path tracer of a tile of pixels. Tracing is const and may run on many threads at once; `update` may not.
class Tracer {
 public:
  Tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces,
         rust::Slice<const float> generations, rust::Slice<const float> axial_mm, const MaterialSettings& material);
  Tracer(const Tracer&) = delete;
  Tracer& operator=(const Tracer&) = delete;

  // New positions (xyz interleaved, as many as at construction). Throws std::invalid_argument on a wrong length.
  void update(rust::Slice<const float> vertices);

  // Refits the hierarchies to the vertices that are there: the part of `update` that is Embree's.
  void refit();

  // Adds the sums of the samples of one tile to `film`, kFilmChannels floats per pixel of the tile, row-major.
  // `corners` are the (width + 1) x (height + 1) directions through the pixel corners of the whole image.
  // `known`: kKnownValues per vertex (`cpp/trace/vertex_light.h`), or nothing, and all light is traced.
  TileCounters trace_tile(const FrameSettings& frame, const Tile& tile, rust::Slice<const float> corners,
                          rust::Slice<const float> known, rust::Slice<float> film) const;

  // Ray lengths along the given unit directions (camera axes) and the faces there; infinity and ~0 where nothing is hit.
  void trace_distances(const FrameSettings& frame, rust::Slice<const float> directions, rust::Slice<float> distances,
                       rust::Slice<std::uint32_t> faces) const;

  // kLampValues per face (`cpp/trace/vertex_light.h`).
  std::uint64_t lamp(const FrameSettings& frame, rust::Slice<const std::uint32_t> faces, rust::Slice<float> values) const;

  // For every ray two values: what the base of the face that it meets sends along it over its mean to all sides, and what the
  // coat sends of light that comes from the lamp's side, as irradiance over what the coat gets. `lamp`: what `lamp` found, of all faces that take part; `to`: places in it; `from`:
  // places of the faces that the rays of each meet, ~0 for none, the same number of rays for each.
  void glints(const FrameSettings& frame, rust::Slice<const float> lamp, rust::Slice<const std::uint32_t> to,
              rust::Slice<const std::uint32_t> from, rust::Slice<float> parts) const;

  // Per face the faces that hits.size() / faces.size() rays from it meet; ~0 where one leaves the mesh.
  std::uint64_t gather(const FrameSettings& frame, rust::Slice<const std::uint32_t> faces, rust::Slice<std::uint32_t> hits) const;

  // Per vertex exits.size() / vertices.size() walks through the wall: the faces where they come out (~0 where they do
  // not), the places there (barycentric weights of the second and third corner) and their weights (3). `flat`, per vertex (3): by
  // how much the mean weight of the same walks below a flat surface is above what is known of it.
  // `adjacent[offsets[v] .. offsets[v + 1]]` are the faces around vertex v.
  std::uint64_t walks(const FrameSettings& frame, rust::Slice<const std::uint32_t> vertices,
                      rust::Slice<const std::uint32_t> offsets, rust::Slice<const std::uint32_t> adjacent,
                      rust::Slice<std::uint32_t> exits, rust::Slice<float> places, rust::Slice<float> weights,
                      rust::Slice<float> flat) const;

  // The lamp's irradiance (3) at places in faces (barycentric weights of the second and third corner) if nothing stood in its way.
  void unshadowed(const FrameSettings& frame, rust::Slice<const std::uint32_t> faces, rust::Slice<const float> places,
                  rust::Slice<float> values) const;

  // The same around vertices, as a mean with the weights of linear interpolation.
  void unshadowed_around(const FrameSettings& frame, rust::Slice<const std::uint32_t> vertices,
                         rust::Slice<const std::uint32_t> offsets, rust::Slice<const std::uint32_t> adjacent,
                         rust::Slice<float> values) const;

  // What camera rays along unit directions (camera axes) hit: face (~0 for nothing), and per ray distance, the
  // barycentric weights of the face's second and third corner, albedo (3).
  void probe(const FrameSettings& frame, rust::Slice<const float> directions, rust::Slice<std::uint32_t> faces,
             rust::Slice<float> values) const;

  // Lengths of arbitrary rays (world axes), infinity where nothing is hit.
  void cast(rust::Slice<const float> origins, rust::Slice<const float> directions, rust::Slice<float> distances) const;

 private:
  friend class Wall;
  friend class LitWall;
  friend class PathIntegrator;
  friend class VertexLight;

  class AreasAround;
  // Which corner of a face a vertex is.
  std::uint32_t corner_of(std::uint32_t face, std::uint32_t vertex) const;

  void bake_look();
  // The wall below a point of diffuse albedo `albedo`.
  Medium medium(Vec3 albedo) const {
    if (fixed_scattering_) return {extinction_, scattering_};
    return {extinction_, {single_scattering_albedo(albedo.x), single_scattering_albedo(albedo.y), single_scattering_albedo(albedo.z)}};
  }
  void update_normals();

  // In the order of their making: they are released in the opposite one.
  Handle<RTCDevice, rtcReleaseDevice> device_;
  // The same mesh twice: `robust_` lets no ray through an edge; `fast_` does so a few times in 1e7, at three quarters of
  // the cost.
  Handle<RTCScene, rtcReleaseScene> robust_, fast_;
  Handle<RTCGeometry, rtcReleaseGeometry> geometry_;
  const float* vertices_{};
  const std::uint32_t* faces_{};
  std::size_t vertex_floats_{}, face_count_{};
  std::vector<float> rest_, normals_, generations_, axial_mm_, vertex_albedo_;
  // How much cartilage there is at a vertex, and the rings' height in mm (empty without rings).
  std::vector<float> ring_weight_, ring_height_;
  bool mucosa_{}, coated_{};
  Subsurface subsurface_{};
  // Walks at every vertex of a path instead of the first alone.
  bool every_vertex_{};
  bool fixed_scattering_{};
  // Part of the walks that starts refracted through a microfacet of roughness 1 instead of by the cosine law.
  float refracted_entry_{}, ior_{};
  // Part of light from all sides that the coat sends back.
  float mean_coat_{};
  Vec3 extinction_{}, scattering_{};
  Vec3 albedo_{};
  float alpha_low_{}, alpha_high_{};
  MucosaLook look_{};
  NoiseKernel noise_{};
  Coat coat_, wide_coat_;
};

std::unique_ptr<Tracer> new_tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces,
                                   rust::Slice<const float> generations, rust::Slice<const float> axial_mm,
                                   const MaterialSettings& material);

// What the tests look at.
float coat_albedo(float alpha, float ior, float cosine);
float medium_albedo(float rho);
void sobol_pair(std::uint32_t key, std::uint32_t index, std::uint32_t dimension, rust::Slice<float> pair);
void gradient_noise(std::uint8_t isa, rust::Slice<const float> point, std::uint32_t seed, rust::Slice<float> values);
void noise_neighbours(std::uint8_t isa, rust::Slice<const float> point, std::uint32_t seed, rust::Slice<float> values,
                      rust::Slice<std::uint32_t> cells);

}  // namespace respire
