#pragma once
// Light on whole faces and at vertices: the queries of `src/render/vertex_light.rs`.

#include "cpp/trace/lamp.h"
#include "cpp/trace/sampler.h"
#include "cpp/trace/scatter_walk.h"

namespace respire {

// Barycentric weights of a place in a face whose corner `corner` has the weight `own`; the other two share the rest.
struct CornerWeights {
  float w[3];
  CornerWeights(std::uint32_t corner, float own, float split) {
    w[corner] = own, w[(corner + 1) % 3] = (1.0f - own) * split, w[(corner + 2) % 3] = (1.0f - own) * (1.0f - split);
  }
};

class FaceLighting {
 public:
  FaceLighting(const Wall& wall, const Lamp& lamp, const FrameSettings& frame)
      : wall_(wall), material_(wall.material), lamp_(lamp), caster_(wall.mesh), pattern_key_(frame.pattern_key) {}

  std::uint64_t rays() const { return caster_.rays; }

  // The lamp's light on a whole face: means over equal parts, more of them the nearer the face is to the lamp.
  FaceLight lamp_on(std::uint32_t face) {
    const Surface s = wall_.face_surface(face, 1.0f / 3.0f, 1.0f / 3.0f);
    // Irradiance, radiosity of the base and unshadowed irradiance, summed over the parts' centres.
    const int parts = parts_of(face, s.point);
    Vec3 received{}, sent{}, even{};
    for (int k = 0; k < parts * parts; ++k) {
      // Part k of the subdivided face: rows of upright triangles with inverted ones between them.
      const int row = static_cast<int>(std::sqrt(static_cast<float>(k) + 0.5f)), place = k - row * row;
      const float third = place % 2 == 0 ? 1.0f / 3.0f : 2.0f / 3.0f, size = 1.0f / static_cast<float>(parts);
      const float v = (static_cast<float>(place / 2) + third) * size;
      const float rest = (static_cast<float>(row) + (place % 2 == 0 ? 2.0f : 1.0f) / 3.0f) * size;
      const Surface part = parts == 1 ? s : wall_.face_surface(face, rest - v, v);
      const Vec3 light = lamp_.irradiance(part, &caster_);
      received += light, sent += light * part.albedo, even += lamp_.unshadowed(part);
    }
    const float each = 1.0f / static_cast<float>(parts * parts);
    const float e = material_.mean_coat();
    const Vec3 side = material_.lamp_side();
    const Vec3 spread = {e * (1.0f - side.x), e * (1.0f - side.y), e * (1.0f - side.z)};
    FaceLight out{};
    store(out.irradiance.data(), received * each);
    store(out.sent.data(), sent * (each * (1.0f - e)));
    store(out.reflectance.data(), s.albedo * (1.0f - e) + spread);
    store(out.centre.data(), s.point);
    store(out.normal.data(), s.shading);
    store(out.unshadowed.data(), even * each);
    out.uneven = parts > 1;
    if (!material_.coated()) return out;
    // The coat's total reflection, sent through the wider lobe.
    const float cosine = std::max(dot(s.shading, normalize(lamp_.position() - s.point)), 0.0f);
    const float wide = std::max(material_.wide_coat().albedo(WIDE_ALPHA, cosine), 1e-6f);
    out.mirrored_lamp = material_.coat().albedo(s.alpha, cosine) / wide;
    out.mirrored_other = {e * side.x / wide, e * side.y / wide, e * side.z / wide};
    return out;
  }

  // What the face lit as `from` sends towards the point `to`.
  Glint glint(Vec3 to, const FaceLight& from) const {
    Glint out{1.0f, 0.0f};
    const Vec3 point = load(from.centre.data()), way = to - point;
    const float l2 = dot(way, way);
    if (!(l2 > 0.0f)) return out;
    const TangentFrame frame(load(from.normal.data()));
    const Vec3 o = frame.local(way * (1.0f / std::sqrt(l2))), i = frame.local(normalize(lamp_.position() - point));
    out.base =
        (1.0f - material_.coat().albedo(material_.mean_alpha(), std::max(o.z, 0.0f))) / (1.0f - material_.mean_coat());
    out.coat = PI * material_.wide_coat().value(o, i, WIDE_ALPHA);
    return out;
  }

  // Faces hit by `count` cosine-distributed rays from `face`; NO_FACE for a ray that leaves the mesh. The rays are
  // fixed to the tissue, so their noise moves with the wall and does not flicker.
  void gather(std::uint32_t face, std::uint32_t count, std::uint32_t* hits) {
    const std::uint32_t key = hash32(face ^ pattern_key_);
    for (std::uint32_t k = 0; k < count; ++k) {
      Sampler sampler(key, k);
      float u, v, a, b;
      sampler.next2(u, v);
      sampler.next2(a, b);
      // Uniform over the triangle.
      const float root = std::sqrt(a);
      const Surface s = wall_.face_surface(face, root * (1.0f - b), root * b);
      const Vec3 direction = wall_.tissue_frame(face, s.shading).world(cosine_direction(u, v));
      Hit hit;
      const bool leaves = dot(direction, s.geometric) > 0.0f;
      hits[k] =
          leaves && caster_.intersect(s.point + s.geometric * SURFACE_OFFSET, direction, hit) ? hit.face : NO_FACE;
    }
  }

  // The lamp's unshadowed irradiance at a point of a face.
  Vec3 unshadowed_at(std::uint32_t face, float u, float v) const {
    return lamp_.unshadowed(wall_.face_surface(face, u, v));
  }

  // The same as a mean over a face, with weights that fall from 1 at the vertex `corner` to 0 at the opposite side.
  // Two-point quadrature each way, exact to third order: Gauss-Jacobi for the weight (1 - x) x, and Gauss-Legendre.
  Vec3 unshadowed_near(std::uint32_t face, std::uint32_t corner) const {
    Vec3 sum{};
    for (const float own : {0.5f - 0.2236068f, 0.5f + 0.2236068f})
      for (const float split : {0.5f - 0.2886751f, 0.5f + 0.2886751f}) {
        const CornerWeights place(corner, own, split);
        sum += unshadowed_at(face, place.w[1], place.w[2]);
      }
    return sum * 0.25f;
  }

  // A scatter walk and its control variate: the light (over the albedo) that the same random numbers bring out of a
  // flat wall, less its known mean; where it begins, and how far away it comes out. No light where the mean is not known.
  struct Walked {
    ScatterExit exit;
    Vec3 flat{}, flat_excess{}, start{}, flat_way{};
  };

  // Random numbers of walk `index` from a vertex; the walk starts in one of the faces around it.
  Sampler walk_sampler(std::uint32_t vertex, std::uint32_t index) const {
    return Sampler(hash32(vertex ^ hash32(pattern_key_ + 1)), index);
  }

  // A walk that starts in `face`, at a point whose density rises linearly towards the vertex `corner`.
  Walked scatter_from(std::uint32_t face, std::uint32_t corner, Sampler& sampler) {
    // Start: the weight of the corner has the density 6 x (1 - x), whose distribution 3 x^2 - 2 x^3 is inverted.
    float u, v;
    sampler.next2(u, v);
    const CornerWeights place(corner, inverse_smoothstep(u), v);
    const Surface s = wall_.face_surface(face, place.w[1], place.w[2]);
    // Direction. The view is not known, so a refracted entry assumes a cosine-distributed one.
    Walked walked{no_exit()};
    walked.start = s.point;
    Vec3 local;
    sampler.next2(u, v);
    if (!material_.entry_direction(cosine_direction(u, v), sampler, local)) return walked;
    const Medium medium = material_.medium(s.albedo);
    const Vec3 inwards = TangentFrame(s.geometric).world(local);
    // The walk through the mesh, and the same below the tangent plane.
    const ScatterWalk walk(wall_.mesh, medium, caster_.rays);
    ScatterWalk::Flight flight{s.point, inwards, {}};
    Hit hit;
    bool out;
    if (material_.has_flat_albedo()) {
      ScatterWalk::Flight flat{};
      const ScatterWalk::Left left =
          walk.leave_both(ScatterWalk(s.point, s.geometric, medium), flight, flat, sampler, hit);
      out = left.here;
      if (left.there) walked.flat = quotient(flat.throughput, s.albedo), walked.flat_way = flat.point - s.point;
      const Vec3 mean = {flat_albedo(s.albedo.x), flat_albedo(s.albedo.y), flat_albedo(s.albedo.z)};
      walked.flat_excess = walked.flat - quotient(mean, s.albedo);
    } else {
      out = walk.leave(flight, sampler, hit);
    }
    if (!out) return walked;
    walked.exit.place = {hit.face, hit.u, hit.v};
    store(walked.exit.weight.data(), quotient(flight.throughput, s.albedo));
    return walked;
  }

  // The exit of a walk that does not come out.
  static ScatterExit no_exit() { return {{NO_FACE, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}}; }

 private:
  // Parts along a face's side, chosen by the squared ratio of its longest side to its distance from the lamp.
  int parts_of(std::uint32_t face, Vec3 centre) const {
    const std::uint32_t* corners = wall_.mesh.corners(face);
    float side2 = 0.0f;
    for (int k = 0; k < 3; ++k) {
      const Vec3 side = wall_.mesh.position(corners[(k + 1) % 3]) - wall_.mesh.position(corners[k]);
      side2 = std::max(side2, dot(side, side));
    }
    const float size2 = side2 / Lamp::squared(lamp_.position() - centre);
    return size2 < 0.01f ? 1 : size2 < 0.05f ? 2 : size2 < 0.3f ? 4 : 8;
  }

  const Wall& wall_;
  const WallMaterial& material_;
  const Lamp& lamp_;
  RayCaster caster_;
  std::uint32_t pattern_key_;
};

}  // namespace respire
