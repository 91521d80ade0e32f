#include "cpp/trace/tracer.h"

#include <embree4/rtcore.h>

#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>

#include "cpp/common/float_mode.h"
#include "cpp/common/isa.h"
#include "cpp/trace/vertex_light.h"
#include "respire-bench/src/ffi/trace/tracer.rs.h"

namespace respire {

namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

void demand(bool condition, const char* what) {
  if (!condition) throw std::invalid_argument(what);
}

Vec3 vec(const std::array<float, 3>& a) { return {a[0], a[1], a[2]}; }

// Rays `first` .. `first + count` (at most eight) of a bundle, traced as one packet.
void cast_packet(RTCScene scene, const float* origins, std::size_t origin_stride, const float* directions,
                 std::size_t count, bool coherent, RTCRayHit8& packet) {
  alignas(32) int valid[8];
  for (std::size_t lane = 0; lane < 8; ++lane) {
    std::size_t source = lane < count ? lane : 0;
    valid[lane] = lane < count ? -1 : 0;
    const float *o = origins + origin_stride * source, *d = directions + 3 * source;
    packet.ray.org_x[lane] = o[0], packet.ray.org_y[lane] = o[1], packet.ray.org_z[lane] = o[2];
    packet.ray.dir_x[lane] = d[0], packet.ray.dir_y[lane] = d[1], packet.ray.dir_z[lane] = d[2];
    packet.ray.tnear[lane] = 0, packet.ray.tfar[lane] = kInfinity, packet.ray.time[lane] = 0;
    packet.ray.mask[lane] = ~0u, packet.ray.id[lane] = 0, packet.ray.flags[lane] = 0;
    packet.hit.geomID[lane] = RTC_INVALID_GEOMETRY_ID;
    packet.hit.instID[0][lane] = RTC_INVALID_GEOMETRY_ID;
  }
  RTCIntersectArguments arguments;
  rtcInitIntersectArguments(&arguments);
  arguments.flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
  rtcIntersect8(valid, scene, &packet, &arguments);
}

}  // namespace

Tracer::Tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces,
               rust::Slice<const float> generations, rust::Slice<const float> axial_mm, const MaterialSettings& material)
    : vertex_floats_(vertices.size()),
      face_count_(faces.size() / 3),
      rest_(vertices.begin(), vertices.end()),
      generations_(generations.begin(), generations.end()),
      axial_mm_(axial_mm.begin(), axial_mm.end()),
      mucosa_(material.mucosa),
      coated_(material.coated),
      subsurface_(static_cast<Subsurface>(material.subsurface)),
      every_vertex_(material.walk_at_every_vertex),
      fixed_scattering_(material.fixed_scattering),
      refracted_entry_(material.refracted_entry),
      ior_(material.ior),
      extinction_(vec(material.extinction)),
      scattering_(vec(material.scattering)),
      albedo_(vec(material.albedo)),
      alpha_low_(material.alpha_low),
      alpha_high_(material.alpha_high),
      look_{material.vessels, material.blotches, material.relief, material.film, material.rings,
            material.ring_spacing_mm, material.seed},
      noise_(noise_kernel(widest_isa())) {
  demand(vertices.size() % 3 == 0 && faces.size() % 3 == 0, "vertex and index lengths must be multiples of 3");
  std::size_t count = vertices.size() / 3;
  demand(material.subsurface <= 2, "a kind of subsurface scattering that is not there");
  demand(generations.size() == count && axial_mm.size() == count, "one generation and axial distance per vertex");
  for (std::uint32_t v : faces) demand(v < count, "a face names a vertex that is not there");
  if (coated_) {
    coat_ = Coat(alpha_low_, alpha_high_, material.ior);
    wide_coat_ = Coat(kWideAlpha, kWideAlpha, material.ior);
    constexpr int kSteps = 64;
    for (int k = 0; k < kSteps; ++k) {
      const float cosine = (static_cast<float>(k) + 0.5f) / kSteps;
      mean_coat_ += coat_.albedo(0.5f * (alpha_low_ + alpha_high_), cosine) * cosine * (2.0f / kSteps);
    }
  }
  FloatMode mode;
  device_.reset(rtcNewDevice("isa=avx2"));
  if (!device_) throw std::runtime_error("Embree refuses a device: error " + std::to_string(rtcGetDeviceError(nullptr)));
  robust_.reset(rtcNewScene(device_));
  fast_.reset(rtcNewScene(device_));
  // Two-level mode: the only one that refits.
  rtcSetSceneBuildQuality(robust_, RTC_BUILD_QUALITY_LOW);
  rtcSetSceneBuildQuality(fast_, RTC_BUILD_QUALITY_LOW);
  rtcSetSceneFlags(robust_, static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_DYNAMIC | RTC_SCENE_FLAG_ROBUST));
  rtcSetSceneFlags(fast_, RTC_SCENE_FLAG_DYNAMIC);
  geometry_.reset(rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE));
  rtcSetGeometryBuildQuality(geometry_, RTC_BUILD_QUALITY_REFIT);
  void* v = rtcSetNewGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, count);
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
  update_normals();
  bake_look();
}

void Tracer::update(rust::Slice<const float> vertices) {
  demand(vertices.size() == vertex_floats_, "the number of vertices cannot change");
  FloatMode mode;
  void* v = rtcGetGeometryBufferData(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
  if (std::memcmp(v, vertices.data(), vertices.size() * sizeof(float)) == 0) return;
  std::memcpy(v, vertices.data(), vertices.size() * sizeof(float));
  refit();
  update_normals();
}

void Tracer::refit() {
  FloatMode mode;
  rtcUpdateGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
  rtcCommitGeometry(geometry_);
  rtcCommitScene(robust_);
  rtcCommitScene(fast_);
}

void Tracer::update_normals() {
  normals_.assign(vertex_floats_, 0.0f);
  for (std::size_t f = 0; f < face_count_; ++f) {
    const std::uint32_t* face = faces_ + 3 * f;
    Vec3 a = load(vertices_ + 3 * face[0]), b = load(vertices_ + 3 * face[1]), c = load(vertices_ + 3 * face[2]);
    Vec3 normal = cross(b - a, c - a);
    for (int k = 0; k < 3; ++k) {
      float* n = &normals_[3 * face[k]];
      n[0] += normal.x, n[1] += normal.y, n[2] += normal.z;
    }
  }
  for (std::size_t v = 0; v < vertex_floats_; v += 3) {
    Vec3 n = load(&normals_[v]);
    float l = length(n);
    if (l > 0.0f) store(&normals_[v], n * (1.0f / l));
  }
}

// Later bounces see the mean colour around each vertex: what they carry is blurred by the next scattering anyway.
// Rings of real airways are neither evenly spaced nor of one height: slow noise bends and fades them.
void Tracer::bake_look() {
  if (!mucosa_) return;
  ring_weight_.assign(vertex_floats_ / 3, 0.0f);
  for (std::size_t v = 0; v < ring_weight_.size(); ++v) {
    const Vec3 p = load(&rest_[3 * v]);
    axial_mm_[v] += 0.22f * look_.ring_spacing_mm * gradient_noise(noise_, p * (1.0f / 9.0f), look_.seed + 8);
    // `normals_` are those of the rest shape still.
    ring_weight_[v] = ring_weight(generations_[v], load(&normals_[3 * v])) * clamp(0.85f + 0.5f * gradient_noise(noise_, p * (1.0f / 6.0f), look_.seed + 9), 0.0f, 1.2f);
  }
  if (look_.rings > 0.0f) {
    for (float weight : ring_weight_) ring_height_.push_back(kRingHeightMm * look_.rings * weight);
  }
  vertex_albedo_.assign(vertex_floats_, 0.0f);
  std::vector<float> weights(vertex_floats_ / 3, 0.0f);
  for (std::size_t f = 0; f < face_count_; ++f) {
    const std::uint32_t* face = faces_ + 3 * f;
    Vec3 corner[3];
    for (int k = 0; k < 3; ++k) corner[k] = load(&rest_[3 * face[k]]);
    Vec3 normal = cross(corner[1] - corner[0], corner[2] - corner[0]);
    float area = length(normal);
    for (int k = 0; k < 3; ++k) {
      std::uint32_t v = face[k];
      Vec3 p = corner[k] * (2.0f / 3.0f) + (corner[(k + 1) % 3] + corner[(k + 2) % 3]) * (1.0f / 6.0f);
      MucosaPoint m = mucosa_at(noise_, look_, albedo_, p, unit_or_zero(normal), axial_mm_[v], ring_weight_[v],
                                generations_[v], 0.0f);
      store(&vertex_albedo_[3 * v], load(&vertex_albedo_[3 * v]) + m.albedo * area);
      weights[v] += area;
    }
  }
  for (std::size_t v = 0; v < weights.size(); ++v) {
    if (weights[v] > 0.0f) store(&vertex_albedo_[3 * v], load(&vertex_albedo_[3 * v]) * (1.0f / weights[v]));
  }
}

TileCounters Tracer::trace_tile(const FrameSettings& frame, const Tile& tile, rust::Slice<const float> corners,
                                rust::Slice<const float> known, rust::Slice<float> film) const {
  demand(known.empty() || known.size() == vertex_floats_ / 3 * kKnownValues, "what is known must be known per vertex");
  demand(tile.x1 <= frame.width && tile.y1 <= frame.height && tile.x0 < tile.x1 && tile.y0 < tile.y1, "tile outside the image");
  demand(corners.size() == 3ull * (frame.width + 1) * (frame.height + 1), "one direction per pixel corner");
  demand(film.size() == static_cast<std::size_t>(tile.x1 - tile.x0) * (tile.y1 - tile.y0) * kFilmChannels, "film size");
  FloatMode mode;
  VertexLight integrator(*this, frame);
  const std::uint32_t columns = tile.x1 - tile.x0, rows = tile.y1 - tile.y0;
  const std::uint64_t total = static_cast<std::uint64_t>(columns) * rows * tile.samples;
  float directions[8 * 3];
  RTCRayHit8 packet;
  std::vector<Sampler> samplers;
  samplers.reserve(8);
  for (std::uint64_t first = 0; first < total; first += 8) {
    const std::uint32_t count = static_cast<std::uint32_t>(std::min<std::uint64_t>(8, total - first));
    samplers.clear();
    for (std::uint32_t lane = 0; lane < count; ++lane) {
      const std::uint64_t pixel = (first + lane) / tile.samples;
      const std::uint32_t x = tile.x0 + static_cast<std::uint32_t>(pixel % columns);
      const std::uint32_t y = tile.y0 + static_cast<std::uint32_t>(pixel / columns);
      const std::uint32_t index = tile.first_sample + static_cast<std::uint32_t>((first + lane) % tile.samples);
      samplers.emplace_back(hash32(frame.key ^ hash32(x + hash32(y + 0x9e3779b9u))), index);
      float u, v;
      samplers.back().next2(u, v);
      const float* low = corners.data() + 3ull * (static_cast<std::uint64_t>(y) * (frame.width + 1) + x);
      const float* high = low + 3ull * (frame.width + 1);
      Vec3 top = load(low) * (1.0f - u) + load(low + 3) * u, bottom = load(high) * (1.0f - u) + load(high + 3) * u;
      store(directions + 3 * lane, normalize(integrator.world_direction(top * (1.0f - v) + bottom * v)));
    }
    cast_packet(robust_, frame.origin.data(), 0, directions, count, true, packet);
    integrator.counters.rays += count;
    for (std::uint32_t lane = 0; lane < count; ++lane) {
      const std::uint64_t pixel = (first + lane) / tile.samples;
      Hit hit{packet.ray.tfar[lane], packet.hit.u[lane], packet.hit.v[lane], packet.hit.primID[lane],
              {packet.hit.Ng_x[lane], packet.hit.Ng_y[lane], packet.hit.Ng_z[lane]}};
      const bool found = packet.hit.geomID[lane] != RTC_INVALID_GEOMETRY_ID;
      float* sums = film.data() + pixel * kFilmChannels;
      if (known.empty())
        integrator.camera_sample(load(directions + 3 * lane), found ? &hit : nullptr, samplers[lane], sums);
      else if (frame.gathers)
        integrator.gathered_sample(load(directions + 3 * lane), found ? &hit : nullptr, known, samplers[lane], sums);
      else
        integrator.known_sample(load(directions + 3 * lane), found ? &hit : nullptr, known, samplers[lane], sums);
    }
  }
  return integrator.counters;
}

// The faces around a vertex and their areas (doubled).
class Tracer::AreasAround {
 public:
  AreasAround(const Tracer& tracer, std::uint32_t vertex, rust::Slice<const std::uint32_t> offsets,
              rust::Slice<const std::uint32_t> adjacent) {
    demand(offsets.size() == tracer.vertex_floats_ / 3 + 1, "one offset per vertex and one for the end");
    demand(vertex + 1 < offsets.size() && offsets[vertex] <= offsets[vertex + 1] && offsets[vertex + 1] <= adjacent.size(), "a vertex that is not there");
    faces_ = adjacent.data() + offsets[vertex];
    float total = 0.0f;
    for (std::uint32_t k = offsets[vertex]; k < offsets[vertex + 1]; ++k) {
      demand(adjacent[k] < tracer.face_count_, "a face that is not there");
      const std::uint32_t* face = tracer.faces_ + 3ull * adjacent[k];
      const Vec3 p = load(tracer.vertices_ + 3ull * face[0]);
      total += length(cross(load(tracer.vertices_ + 3ull * face[1]) - p, load(tracer.vertices_ + 3ull * face[2]) - p));
      so_far_.push_back(total);
    }
  }

  std::size_t count() const { return so_far_.size(); }
  std::uint32_t face(std::size_t k) const { return faces_[k]; }
  float area(std::size_t k) const { return k == 0 ? so_far_[0] : so_far_[k] - so_far_[k - 1]; }
  float total() const { return so_far_.empty() ? 0.0f : so_far_.back(); }
  // The face below which the part `part` of the area lies.
  std::uint32_t face_at(float part) const {
    std::size_t k = 0;
    while (k + 1 < so_far_.size() && so_far_[k] <= part * total()) ++k;
    return faces_[k];
  }

 private:
  const std::uint32_t* faces_;
  std::vector<float> so_far_;
};

std::uint32_t Tracer::corner_of(std::uint32_t face, std::uint32_t vertex) const {
  const std::uint32_t* corners = faces_ + 3ull * face;
  return corners[0] == vertex ? 0 : corners[1] == vertex ? 1 : 2;
}

std::uint64_t Tracer::lamp(const FrameSettings& frame, rust::Slice<const std::uint32_t> faces,
                           rust::Slice<float> values) const {
  demand(values.size() == kLampValues * faces.size(), "so many values per face");
  FloatMode mode;
  VertexLight integrator(*this, frame);
  for (std::size_t f = 0; f < faces.size(); ++f) {
    demand(faces[f] < face_count_, "a face that is not there");
    integrator.lamp(faces[f], &values[kLampValues * f]);
  }
  return integrator.counters.rays;
}

void Tracer::glints(const FrameSettings& frame, rust::Slice<const float> lamp, rust::Slice<const std::uint32_t> to,
                    rust::Slice<const std::uint32_t> from, rust::Slice<float> parts) const {
  demand(!to.empty() && from.size() % to.size() == 0 && parts.size() == 2 * from.size(), "the same number of rays for every face");
  if (!coated_) return;
  FloatMode mode;
  const VertexLight integrator(*this, frame);
  const std::size_t count = lamp.size() / kLampValues, rays = from.size() / to.size();
  for (std::size_t ray = 0; ray < from.size(); ++ray) {
    const std::uint32_t source = from[ray], face = to[ray / rays];
    if (source == kNothing) continue;
    demand(source < count && face < count, "a face that has no lamp values");
    integrator.glint(load(&lamp[kLampValues * face + 9]), &lamp[kLampValues * source], &parts[2 * ray]);
  }
}

std::uint64_t Tracer::gather(const FrameSettings& frame, rust::Slice<const std::uint32_t> faces,
                             rust::Slice<std::uint32_t> hits) const {
  demand(!faces.empty() && hits.size() % faces.size() == 0, "the same number of rays for every face");
  FloatMode mode;
  VertexLight integrator(*this, frame);
  const std::size_t count = hits.size() / faces.size();
  for (std::size_t f = 0; f < faces.size(); ++f) {
    demand(faces[f] < face_count_, "a face that is not there");
    integrator.gather(faces[f], static_cast<std::uint32_t>(count), &hits[f * count]);
  }
  return integrator.counters.rays;
}

std::uint64_t Tracer::walks(const FrameSettings& frame, rust::Slice<const std::uint32_t> vertices,
                            rust::Slice<const std::uint32_t> offsets, rust::Slice<const std::uint32_t> adjacent,
                            rust::Slice<std::uint32_t> exits, rust::Slice<float> places, rust::Slice<float> weights,
                            rust::Slice<float> flat) const {
  demand(!vertices.empty() && exits.size() % vertices.size() == 0, "the same number of walks for every vertex");
  demand(weights.size() == 3 * exits.size() && places.size() == 2 * exits.size(), "three weights and a place per walk");
  demand(flat.size() == 3 * vertices.size(), "three values per vertex");
  FloatMode mode;
  VertexLight integrator(*this, frame);
  const std::size_t count = exits.size() / vertices.size();
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const std::uint32_t vertex = vertices[i];
    const AreasAround around(*this, vertex, offsets, adjacent);
    Vec3 excess{0, 0, 0};
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t walk = i * count + k;
      VertexLight::Exit exit;
      if (around.total() > 0.0f) {
        Sampler sampler(hash32(vertex ^ hash32(frame.pattern_key + 1)), static_cast<std::uint32_t>(k));
        // Stratified over the faces around.
        const std::uint32_t face = around.face_at((static_cast<float>(k) + sampler.random()) / static_cast<float>(count));
        exit = integrator.walk_from(face, corner_of(face, vertex), sampler);
      }
      exits[walk] = exit.face;
      places[2 * walk] = exit.u, places[2 * walk + 1] = exit.v;
      store(&weights[3 * walk], exit.weight);
      excess += exit.flat;
    }
    store(&flat[3 * i], excess * (1.0f / static_cast<float>(count)));
  }
  return integrator.counters.rays;
}

void Tracer::unshadowed(const FrameSettings& frame, rust::Slice<const std::uint32_t> faces, rust::Slice<const float> places,
                        rust::Slice<float> values) const {
  demand(places.size() == 2 * faces.size() && values.size() == 3 * faces.size(), "a place and three values per face");
  FloatMode mode;
  const VertexLight integrator(*this, frame);
  for (std::size_t k = 0; k < faces.size(); ++k) {
    demand(faces[k] < face_count_, "a face that is not there");
    store(&values[3 * k], integrator.unshadowed_at(faces[k], places[2 * k], places[2 * k + 1]));
  }
}

void Tracer::unshadowed_around(const FrameSettings& frame, rust::Slice<const std::uint32_t> vertices,
                               rust::Slice<const std::uint32_t> offsets, rust::Slice<const std::uint32_t> adjacent,
                               rust::Slice<float> values) const {
  demand(values.size() == 3 * vertices.size(), "three values per vertex");
  FloatMode mode;
  const VertexLight integrator(*this, frame);
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const AreasAround around(*this, vertices[i], offsets, adjacent);
    Vec3 sum{0, 0, 0};
    for (std::size_t k = 0; k < around.count(); ++k) {
      const std::uint32_t face = around.face(k);
      sum += integrator.unshadowed_near(face, corner_of(face, vertices[i])) * around.area(k);
    }
    store(&values[3 * i], around.total() > 0.0f ? sum * (1.0f / around.total()) : sum);
  }
}

void Tracer::trace_distances(const FrameSettings& frame, rust::Slice<const float> directions,
                             rust::Slice<float> distances, rust::Slice<std::uint32_t> faces) const {
  demand(directions.size() == 3 * distances.size() && faces.size() == distances.size(), "one direction per distance");
  FloatMode mode;
  VertexLight integrator(*this, frame);
  float world[8 * 3];
  RTCRayHit8 packet;
  for (std::size_t first = 0; first < distances.size(); first += 8) {
    const std::size_t count = std::min<std::size_t>(8, distances.size() - first);
    for (std::size_t lane = 0; lane < count; ++lane)
      store(world + 3 * lane, integrator.world_direction(load(directions.data() + 3 * (first + lane))));
    cast_packet(robust_, frame.origin.data(), 0, world, count, true, packet);
    for (std::size_t lane = 0; lane < count; ++lane) {
      const bool found = packet.hit.geomID[lane] != RTC_INVALID_GEOMETRY_ID;
      distances[first + lane] = found ? packet.ray.tfar[lane] : kInfinity;
      faces[first + lane] = found ? packet.hit.primID[lane] : kNothing;
    }
  }
}

void Tracer::probe(const FrameSettings& frame, rust::Slice<const float> directions, rust::Slice<std::uint32_t> faces,
                   rust::Slice<float> values) const {
  demand(directions.size() == 3 * faces.size() && values.size() == 6 * faces.size(), "one direction and six values per face");
  FloatMode mode;
  VertexLight integrator(*this, frame);
  float world[8 * 3];
  RTCRayHit8 packet;
  for (std::size_t first = 0; first < faces.size(); first += 8) {
    const std::size_t count = std::min<std::size_t>(8, faces.size() - first);
    for (std::size_t lane = 0; lane < count; ++lane)
      store(world + 3 * lane, integrator.world_direction(load(directions.data() + 3 * (first + lane))));
    cast_packet(robust_, frame.origin.data(), 0, world, count, true, packet);
    for (std::size_t lane = 0; lane < count; ++lane) {
      float* out = values.data() + 6 * (first + lane);
      const bool found = packet.hit.geomID[lane] != RTC_INVALID_GEOMETRY_ID;
      faces[first + lane] = found ? packet.hit.primID[lane] : ~0u;
      Hit hit{packet.ray.tfar[lane], packet.hit.u[lane], packet.hit.v[lane], packet.hit.primID[lane],
              {packet.hit.Ng_x[lane], packet.hit.Ng_y[lane], packet.hit.Ng_z[lane]}};
      out[0] = found ? hit.t : 0.0f, out[1] = found ? hit.u : 0.0f, out[2] = found ? hit.v : 0.0f;
      store(out + 3, found ? integrator.camera_albedo(hit, load(world + 3 * lane)) : Vec3{0, 0, 0});
    }
  }
}

void Tracer::cast(rust::Slice<const float> origins, rust::Slice<const float> directions,
                  rust::Slice<float> distances) const {
  demand(directions.size() == 3 * distances.size() && origins.size() == directions.size(), "one ray per distance");
  FloatMode mode;
  RTCRayHit8 packet;
  for (std::size_t first = 0; first < distances.size(); first += 8) {
    const std::size_t count = std::min<std::size_t>(8, distances.size() - first);
    cast_packet(robust_, origins.data() + 3 * first, 3, directions.data() + 3 * first, count, false, packet);
    for (std::size_t lane = 0; lane < count; ++lane)
      distances[first + lane] = packet.hit.geomID[lane] == RTC_INVALID_GEOMETRY_ID ? kInfinity : packet.ray.tfar[lane];
  }
}

// E by stratified sampling of visible normals: the weight of a mirrored direction is F (1 + L(o)) / (1 + L(o) + L(i)).
Coat::Coat(float alpha_low, float alpha_high, float ior)
    : rows_(alpha_high > alpha_low ? 8 : 1), alpha_low_(alpha_low), ior_(ior) {
  const int strata = rows_ == 1 ? 64 : 32;
  rows_per_alpha_ = rows_ > 1 ? static_cast<float>(rows_ - 1) / (alpha_high - alpha_low) : 0.0f;
  for (int row = 0; row < rows_; ++row) {
    float alpha = rows_ > 1 ? alpha_low + static_cast<float>(row) / rows_per_alpha_ : alpha_low;
    for (int c = 0; c < kCosines; ++c) {
      float mu = std::max(static_cast<float>(c) / (kCosines - 1), 1e-3f);
      Vec3 o = {std::sqrt(1.0f - mu * mu), 0.0f, mu};
      double sum = 0.0;
      for (int a = 0; a < strata; ++a)
        for (int b = 0; b < strata; ++b) {
          Vec3 h = visible_normal(o, alpha, (static_cast<float>(a) + 0.5f) / static_cast<float>(strata),
                                  (static_cast<float>(b) + 0.5f) / static_cast<float>(strata));
          Vec3 i = h * (2.0f * dot(o, h)) - o;
          if (i.z <= 0.0f) continue;
          float lo = smith_lambda(o.z, alpha), li = smith_lambda(i.z, alpha);
          sum += fresnel(dot(o, h), ior) * (1.0f + lo) / (1.0f + lo + li);
        }
      table_.push_back(static_cast<float>(sum / (strata * strata)));
    }
  }
}

std::unique_ptr<Tracer> new_tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces,
                                   rust::Slice<const float> generations, rust::Slice<const float> axial_mm,
                                   const MaterialSettings& material) {
  return std::make_unique<Tracer>(vertices, faces, generations, axial_mm, material);
}

float coat_albedo(float alpha, float ior, float cosine) { return Coat(alpha, alpha, ior).albedo(alpha, cosine); }

float medium_albedo(float rho) { return single_scattering_albedo(rho); }

void sobol_pair(std::uint32_t key, std::uint32_t index, std::uint32_t dimension, rust::Slice<float> pair) {
  demand(pair.size() == 2, "a pair has two values");
  Sampler sampler(key, index);
  for (std::uint32_t d = 0; d <= dimension; ++d) sampler.next2(pair[0], pair[1]);
}

void gradient_noise(std::uint8_t isa, rust::Slice<const float> point, std::uint32_t seed, rust::Slice<float> values) {
  demand(isa <= widest_isa() && point.size() == 3 && values.size() == 4, "a noise has four values");
  const Noise n = noise_kernel(isa).gradient(point.data(), seed);
  std::memcpy(values.data(), &n, sizeof n);
}

void noise_neighbours(std::uint8_t isa, rust::Slice<const float> point, std::uint32_t seed, rust::Slice<float> values,
                      rust::Slice<std::uint32_t> cells) {
  demand(isa <= widest_isa() && point.size() == 3 && values.size() == 8 && cells.size() == 2, "two neighbours of four values");
  const Neighbours n = noise_kernel(isa).neighbours(point.data(), seed);
  for (std::size_t k = 0; k < 2; ++k) {
    std::memcpy(&values[4 * k], n.place[k], sizeof n.place[k]);
    values[4 * k + 3] = n.distance2[k];
    cells[k] = n.cell[k];
  }
}

}  // namespace respire
