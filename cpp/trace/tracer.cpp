#include "cpp/trace/tracer.h"

#include <cstring>
#include <limits>

#include "cpp/common/float_mode.h"
#include "cpp/common/isa.h"
#include "cpp/common/require.h"
#include "cpp/trace/face_light.h"
#include "cpp/trace/known_light.h"
#include "cpp/trace/path.h"
#include "cpp/trace/wall_material.h"
#include "respire-bench/src/ffi/trace/tracer.rs.h"

namespace respire {

namespace {

// Distance of a ray that hits nothing.
constexpr float FAR_AWAY = std::numeric_limits<float>::infinity();

// The faces around a vertex and their areas (doubled).
class AreasAround {
 public:
  AreasAround(const TracedMesh& mesh, std::uint32_t vertex, const FacesAround& around) {
    const auto& offsets = around.offsets;
    require(offsets.size() == mesh.vertex_count() + 1, "one offset per vertex and one for the end");
    require(vertex < mesh.vertex_count(), "a vertex that is not there");
    const std::uint32_t first = offsets[vertex], end = offsets[vertex + 1];
    require(first <= end && end <= around.faces.size(), "faces around a vertex that are not there");
    faces_ = around.faces.data() + first;
    float total = 0.0f;
    for (std::uint32_t k = 0; k < end - first; ++k) {
      require(faces_[k] < mesh.face_count(), "a face that is not there");
      const std::uint32_t* corners = mesh.corners(faces_[k]);
      const Vec3 p = mesh.position(corners[0]);
      total += length(cross(mesh.position(corners[1]) - p, mesh.position(corners[2]) - p));
      so_far_.push_back(total);
    }
  }

  std::size_t count() const { return so_far_.size(); }
  std::uint32_t face(std::size_t k) const { return faces_[k]; }
  float area(std::size_t k) const { return k == 0 ? so_far_[0] : so_far_[k] - so_far_[k - 1]; }
  float total() const { return so_far_.empty() ? 0.0f : so_far_.back(); }
  // Mean place of the faces under weights that fall from 1 at the vertex to 0 at the opposite sides.
  Vec3 weighted_centre(const TracedMesh& mesh, std::uint32_t vertex) const {
    Vec3 sum{0, 0, 0};
    for (std::size_t k = 0; k < count(); ++k) {
      const std::uint32_t* corners = mesh.corners(faces_[k]);
      const Vec3 all = mesh.position(corners[0]) + mesh.position(corners[1]) + mesh.position(corners[2]);
      sum += (all + mesh.position(vertex)) * (0.25f * area(k));
    }
    return total() > 0.0f ? sum * (1.0f / total()) : mesh.position(vertex);
  }
  // The face at which the cumulative area reaches the fraction `part`.
  std::uint32_t face_at(float part) const {
    std::size_t k = 0;
    while (k + 1 < so_far_.size() && so_far_[k] <= part * total()) ++k;
    return faces_[k];
  }

 private:
  const std::uint32_t* faces_;
  std::vector<float> so_far_;
};

// Calls `found(ray, direction, hit)` for the camera rays along unit `directions` (camera axes); `hit` is null at a
// miss.
template <class Found>
void for_each_camera_ray(const Wall& wall, const FrameSettings& frame, rust::Slice<const float> directions,
                         Found&& found) {
  float world[RayPacket::WIDTH * 3];
  RayPacket packet;
  const std::size_t rays = directions.size() / 3;
  for (std::size_t first = 0; first < rays; first += RayPacket::WIDTH) {
    const std::size_t count = std::min(RayPacket::WIDTH, rays - first);
    for (std::size_t lane = 0; lane < count; ++lane)
      store(world + 3 * lane, wall.world_direction(load(directions.data() + 3 * (first + lane))));
    packet.aim(frame.origin.data(), 0, world, count);
    packet.trace(wall.mesh.robust(), RayPacket::Bundle::COHERENT);
    for (std::size_t lane = 0; lane < count; ++lane) {
      Hit hit;
      found(first + lane, load(world + 3 * lane), packet.hit(wall.mesh, lane, hit) ? &hit : nullptr);
    }
  }
}

void check_tile(const FrameSettings& frame, const TileRequest& tile, std::size_t corners, std::size_t film) {
  require(tile.x1 <= frame.width && tile.y1 <= frame.height && tile.x0 < tile.x1 && tile.y0 < tile.y1,
          "tile outside the image");
  require(corners == 3 * (frame.width + 1ull) * (frame.height + 1ull), "one direction per pixel corner");
  require(film == static_cast<std::size_t>(tile.x1 - tile.x0) * (tile.y1 - tile.y0), "film size");
}

// Camera direction (not normalised) through a pixel, bilinear between those through its corners.
Vec3 direction_through(rust::Slice<const float> corners, const FrameSettings& frame, std::uint32_t x, std::uint32_t y,
                       Sampler& sampler) {
  float u, v;
  sampler.next2(u, v);
  const float* low = corners.data() + 3ull * (static_cast<std::uint64_t>(y) * (frame.width + 1) + x);
  const float* high = low + 3ull * (frame.width + 1);
  Vec3 top = load(low) * (1.0f - u) + load(low + 3) * u, bottom = load(high) * (1.0f - u) + load(high + 3) * u;
  return top * (1.0f - v) + bottom * v;
}

}  // namespace

Tracer::Tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces,
               rust::Slice<const RestVertex> rest, const MaterialSettings& material)
    : mesh_(vertices, faces), material_(std::make_unique<WallMaterial>(material, mesh_, rest)) {}

Tracer::~Tracer() = default;

std::unique_ptr<Tracer> new_tracer(rust::Slice<const float> vertices, rust::Slice<const std::uint32_t> faces,
                                   rust::Slice<const RestVertex> rest, const MaterialSettings& material) {
  return std::make_unique<Tracer>(vertices, faces, rest, material);
}

TileCounters Tracer::trace_tile(const FrameSettings& frame, const TileRequest& tile, rust::Slice<const float> corners,
                                rust::Slice<const KnownLight> known, rust::Slice<FilmPixel> film) const {
  require(known.empty() || known.size() == mesh_.vertex_count(), "what is known must be known per vertex");
  check_tile(frame, tile, corners.size(), film.size());
  FloatMode mode;
  const Wall wall(mesh_, *material_, frame);
  const Lamp lamp(frame);
  PathTracer paths(wall, lamp, frame);
  KnownLightTracer from_vertices(paths, known.data());
  const std::uint32_t columns = tile.x1 - tile.x0, rows = tile.y1 - tile.y0;
  const std::uint64_t total = static_cast<std::uint64_t>(columns) * rows * tile.samples;
  float directions[RayPacket::WIDTH * 3];
  RayPacket packet;
  std::vector<Sampler> samplers;
  samplers.reserve(RayPacket::WIDTH);
  // Samples of the tile, pixel after pixel, eight camera rays at a time.
  for (std::uint64_t first = 0; first < total; first += RayPacket::WIDTH) {
    const std::size_t count = static_cast<std::size_t>(std::min<std::uint64_t>(RayPacket::WIDTH, total - first));
    samplers.clear();
    for (std::size_t lane = 0; lane < count; ++lane) {
      const std::uint64_t pixel = (first + lane) / tile.samples;
      const std::uint32_t x = tile.x0 + static_cast<std::uint32_t>(pixel % columns);
      const std::uint32_t y = tile.y0 + static_cast<std::uint32_t>(pixel / columns);
      const std::uint32_t index = tile.first_sample + static_cast<std::uint32_t>((first + lane) % tile.samples);
      samplers.emplace_back(hash32(frame.key ^ hash32(x + hash32(y + 0x9e3779b9u))), index);
      const Vec3 direction = direction_through(corners, frame, x, y, samplers.back());
      store(directions + 3 * lane, normalize(wall.world_direction(direction)));
    }
    packet.aim(frame.origin.data(), 0, directions, count);
    packet.trace(mesh_.robust(), RayPacket::Bundle::COHERENT);
    paths.caster().rays += count;
    for (std::size_t lane = 0; lane < count; ++lane) {
      Hit hit;
      const Hit* found = packet.hit(mesh_, lane, hit) ? &hit : nullptr;
      const Vec3 direction = load(directions + 3 * lane);
      FilmPixel& pixel = film[(first + lane) / tile.samples];
      if (known.empty())
        paths.camera_sample(direction, found, samplers[lane], pixel);
      else if (frame.gathers)
        from_vertices.gathered_sample(direction, found, samplers[lane], pixel);
      else
        from_vertices.known_sample(direction, found, samplers[lane], pixel);
    }
  }
  return {paths.paths, paths.caster().rays, paths.rejected};
}

void Tracer::probe_depth(const FrameSettings& frame, rust::Slice<const float> directions, rust::Slice<float> distances,
                         rust::Slice<std::uint32_t> faces) const {
  require(directions.size() == 3 * distances.size() && faces.size() == distances.size(), "one direction per distance");
  FloatMode mode;
  const Wall wall(mesh_, *material_, frame);
  for_each_camera_ray(wall, frame, directions, [&](std::size_t ray, Vec3, const Hit* hit) {
    distances[ray] = hit ? hit->t : FAR_AWAY;
    faces[ray] = hit ? hit->face : NO_FACE;
  });
}

void Tracer::probe(const FrameSettings& frame, rust::Slice<const float> directions,
                   rust::Slice<ProbedPoint> points) const {
  require(directions.size() == 3 * points.size(), "one direction per point");
  FloatMode mode;
  const Wall wall(mesh_, *material_, frame);
  for_each_camera_ray(wall, frame, directions, [&](std::size_t ray, Vec3 direction, const Hit* hit) {
    ProbedPoint& point = points[ray];
    point = {{NO_FACE, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}};
    if (!hit) return;
    point.place = {hit->face, hit->u, hit->v};
    store(point.albedo.data(), wall.camera_surface(*hit, direction).albedo);
  });
}

void Tracer::cast(rust::Slice<const float> origins, rust::Slice<const float> directions,
                  rust::Slice<float> distances) const {
  require(directions.size() == 3 * distances.size() && origins.size() == directions.size(), "one ray per distance");
  FloatMode mode;
  RayPacket packet;
  for (std::size_t first = 0; first < distances.size(); first += RayPacket::WIDTH) {
    const std::size_t count = std::min(RayPacket::WIDTH, distances.size() - first);
    packet.aim(origins.data() + 3 * first, 3, directions.data() + 3 * first, count);
    packet.trace(mesh_.robust(), RayPacket::Bundle::SCATTERED);
    for (std::size_t lane = 0; lane < count; ++lane) {
      Hit hit;
      distances[first + lane] = packet.hit(mesh_, lane, hit) ? hit.t : FAR_AWAY;
    }
  }
}

std::uint64_t Tracer::lamp_on_faces(const FrameSettings& frame, rust::Slice<const std::uint32_t> faces,
                                    rust::Slice<FaceLight> light) const {
  require(light.size() == faces.size(), "one record per face");
  FloatMode mode;
  const Wall wall(mesh_, *material_, frame);
  const Lamp lamp(frame);
  FaceLighting lighting(wall, lamp, frame);
  for (std::size_t f = 0; f < faces.size(); ++f) {
    require(faces[f] < mesh_.face_count(), "a face that is not there");
    light[f] = lighting.lamp_on(faces[f]);
  }
  return lighting.rays();
}

void Tracer::glints(const FrameSettings& frame, rust::Slice<const FaceLight> light, rust::Slice<const std::uint32_t> to,
                    rust::Slice<const std::uint32_t> from, rust::Slice<Glint> glints) const {
  require(!to.empty() && from.size() % to.size() == 0, "the same number of rays for every face");
  require(glints.size() == from.size(), "one record per ray");
  if (!material_->coated()) return;
  FloatMode mode;
  const Wall wall(mesh_, *material_, frame);
  const Lamp lamp(frame);
  const FaceLighting lighting(wall, lamp, frame);
  const std::size_t rays = from.size() / to.size();
  for (std::size_t ray = 0; ray < from.size(); ++ray) {
    const std::uint32_t source = from[ray], face = to[ray / rays];
    if (source == NO_FACE) continue;
    require(source < light.size() && face < light.size(), "a face without a record of its light");
    glints[ray] = lighting.glint(load(light[face].centre.data()), light[source]);
  }
}

std::uint64_t Tracer::gather(const FrameSettings& frame, rust::Slice<const std::uint32_t> faces,
                             rust::Slice<std::uint32_t> hits) const {
  require(!faces.empty() && !hits.empty() && hits.size() % faces.size() == 0, "the same number of rays for every face");
  FloatMode mode;
  const Wall wall(mesh_, *material_, frame);
  const Lamp lamp(frame);
  FaceLighting lighting(wall, lamp, frame);
  const std::size_t count = hits.size() / faces.size();
  for (std::size_t f = 0; f < faces.size(); ++f) {
    require(faces[f] < mesh_.face_count(), "a face that is not there");
    lighting.gather(faces[f], static_cast<std::uint32_t>(count), &hits[f * count]);
  }
  return lighting.rays();
}

std::uint64_t Tracer::scatter_walks(const FrameSettings& frame, rust::Slice<const std::uint32_t> vertices,
                                    const FacesAround& around, rust::Slice<ScatterExit> exits,
                                    rust::Slice<FlatWalks> flat) const {
  require(!vertices.empty() && exits.size() % vertices.size() == 0, "the same number of walks for every vertex");
  require(flat.size() == vertices.size(), "one record per vertex");
  FloatMode mode;
  const Wall wall(mesh_, *material_, frame);
  const Lamp lamp(frame);
  FaceLighting lighting(wall, lamp, frame);
  const std::size_t count = exits.size() / vertices.size();
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const std::uint32_t vertex = vertices[i];
    const AreasAround areas(mesh_, vertex, around);
    const Vec3 centre = areas.weighted_centre(mesh_, vertex);
    // Squared diameter of a disc of the faces' area: how far the slope that these give is to be trusted.
    const float reach2 = std::max(areas.total() * (2.0f / PI), 1e-12f);
    Vec3 excess{0, 0, 0}, moments[3] = {};
    for (std::size_t k = 0; k < count; ++k) {
      ScatterExit& exit = exits[i * count + k];
      exit = FaceLighting::no_exit();
      if (!(areas.total() > 0.0f)) continue;
      Sampler sampler = lighting.walk_sampler(vertex, static_cast<std::uint32_t>(k));
      // Stratified over the faces around.
      const std::uint32_t face = areas.face_at((static_cast<float>(k) + sampler.random()) / static_cast<float>(count));
      const FaceLighting::Walked walked = lighting.scatter_from(face, mesh_.corner_of(face, vertex), sampler);
      exit = walked.exit;
      excess += walked.flat_excess;
      // Far away the light is not linear any more: long ways count less (all directions alike, so the mean stays 0).
      const float shorter = 1.0f / (1.0f + dot(walked.flat_way, walked.flat_way) / reach2);
      const Vec3 way = walked.start - centre + walked.flat_way * shorter;
      moments[0] += way * walked.flat.x, moments[1] += way * walked.flat.y, moments[2] += way * walked.flat.z;
    }
    const float each = 1.0f / static_cast<float>(count);
    store(flat[i].excess.data(), excess * each);
    for (std::size_t c = 0; c < 3; ++c) store(flat[i].moments.data() + 3 * c, moments[c] * each);
  }
  return lighting.rays();
}

void Tracer::unshadowed(const FrameSettings& frame, rust::Slice<const FacePlace> places,
                        rust::Slice<float> irradiance) const {
  require(irradiance.size() == 3 * places.size(), "three values per place");
  FloatMode mode;
  const Wall wall(mesh_, *material_, frame);
  const Lamp lamp(frame);
  const FaceLighting lighting(wall, lamp, frame);
  for (std::size_t k = 0; k < places.size(); ++k) {
    require(places[k].face < mesh_.face_count(), "a face that is not there");
    store(&irradiance[3 * k], lighting.unshadowed_at(places[k].face, places[k].u, places[k].v));
  }
}

void Tracer::unshadowed_around(const FrameSettings& frame, rust::Slice<const std::uint32_t> vertices,
                               const FacesAround& around, rust::Slice<float> irradiance) const {
  require(irradiance.size() == 3 * vertices.size(), "three values per vertex");
  FloatMode mode;
  const Wall wall(mesh_, *material_, frame);
  const Lamp lamp(frame);
  const FaceLighting lighting(wall, lamp, frame);
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const AreasAround areas(mesh_, vertices[i], around);
    Vec3 sum{0, 0, 0};
    for (std::size_t k = 0; k < areas.count(); ++k) {
      const std::uint32_t face = areas.face(k);
      sum += lighting.unshadowed_near(face, mesh_.corner_of(face, vertices[i])) * areas.area(k);
    }
    store(&irradiance[3 * i], areas.total() > 0.0f ? sum * (1.0f / areas.total()) : sum);
  }
}

float coat_albedo(float alpha, float ior, float cosine) { return Coat(alpha, alpha, ior).albedo(alpha, cosine); }

float medium_albedo(float rho) { return single_scattering_albedo(rho); }

void sobol_pair(std::uint32_t key, std::uint32_t index, std::uint32_t dimension, rust::Slice<float> pair) {
  require(pair.size() == 2, "a pair has two values");
  Sampler sampler(key, index);
  for (std::uint32_t d = 0; d <= dimension; ++d) sampler.next2(pair[0], pair[1]);
}

GradientNoise gradient_noise(std::uint8_t isa, rust::Slice<const float> point, std::uint32_t seed) {
  require(isa <= widest_isa() && point.size() == 3, "a point and an instruction set of this processor");
  const Noise n = noise_kernel(isa).gradient(point.data(), seed);
  return {n.value, {n.gradient[0], n.gradient[1], n.gradient[2]}};
}

void noise_neighbours(std::uint8_t isa, rust::Slice<const float> point, std::uint32_t seed,
                      rust::Slice<NoiseNeighbour> nearest) {
  require(isa <= widest_isa() && point.size() == 3 && nearest.size() == 2, "a point and its two neighbours");
  const Neighbours n = noise_kernel(isa).neighbours(point.data(), seed);
  for (std::size_t k = 0; k < 2; ++k)
    nearest[k] = {{n.place[k][0], n.place[k][1], n.place[k][2]}, n.distance2[k], n.cell[k]};
}

}  // namespace respire
