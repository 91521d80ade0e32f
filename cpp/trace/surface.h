#pragma once
// The wall at a path's vertex: point, normals, colour, roughness.
//
// Fine detail (vessels, film, fine relief) is evaluated where the camera sees it; later vertices use the wall's mean
// colour and the relief of rings and folds.

#include <cmath>

#include "cpp/trace/traced_mesh.h"
#include "cpp/trace/vector.h"
#include "cpp/trace/wall_material.h"
#include "respire-bench/src/ffi/trace/tracer.rs.h"

namespace respire {

struct Surface {
  Vec3 point, geometric, smooth, shading;  // normals: unit, on the side of the viewer
  Vec3 albedo;
  float alpha;
};

// Shape and look of the wall in one frame.
class Wall {
 public:
  Wall(const TracedMesh& mesh, const WallMaterial& material, const FrameSettings& frame)
      : mesh(mesh), material(material), frame_(frame), origin_(load(frame.origin.data())) {}

  const TracedMesh& mesh;
  const WallMaterial& material;

  // Camera axes to world axes.
  Vec3 world_direction(Vec3 d) const {
    const auto& r = frame_.rotation;
    return {r[0] * d.x + r[1] * d.y + r[2] * d.z, r[3] * d.x + r[4] * d.y + r[5] * d.z,
            r[6] * d.x + r[7] * d.y + r[8] * d.z};
  }

  // What every vertex of a path needs; colour from the vertices.
  Surface surface(const Hit& hit, Vec3 from, Vec3 direction) const {
    Surface s;
    s.point = hit.t < LONG_RAY ? from + direction * hit.t : mesh.point(hit);
    s.geometric = unit_normal(hit.geometric);
    const float side = dot(s.geometric, direction) > 0 ? -1.0f : 1.0f;
    s.geometric = s.geometric * side;
    s.smooth = s.geometric;
    const std::uint32_t* corners = mesh.corners(hit.face);
    if (frame_.smooth) {
      const Vec3 n = interpolate(mesh.normals(), corners, hit.u, hit.v) * side;
      const float l2 = dot(n, n);
      if (l2 > 1e-6f) s.smooth = n * (1.0f / std::sqrt(l2));
    }
    if (material.has_coarse_relief()) {
      const WallMaterial::Rise rise = material.coarse_rise(corners, hit.u, hit.v);
      s.smooth = bent(s.smooth, direction, corners, {rise.first * side, rise.second * side});
    }
    s.shading = s.smooth;
    s.albedo = material.mean_albedo(corners, hit.u, hit.v);
    s.alpha = material.later_alpha();
    return s;
  }

  // The first vertex: with vessels, film and fine relief.
  Surface camera_surface(const Hit& hit, Vec3 direction) const {
    Surface s = surface(hit, origin_, direction);
    if (!material.mucosa()) return s;
    const std::uint32_t* corners = mesh.corners(hit.face);
    Vec3 edge1, edge2;
    const MucosaPoint m = material.look_at(corners, hit.u, hit.v, hit.t * frame_.pixel_angle, edge1, edge2);
    s.albedo = m.albedo;
    // Relief too fine to be seen widens the lobe: alpha^2 is twice the mean square slope per axis (Beckmann's measure).
    const float alpha = material.alpha(m.roughness);
    s.alpha = std::sqrt(alpha * alpha + 2.0f * m.unseen_slope2);
    s.shading = bent(s.smooth, direction, corners, {dot(m.height_gradient, edge1), dot(m.height_gradient, edge2)});
    return s;
  }

  // A point of the surface as seen from the lumen, where light comes out of the wall along `direction`.
  Surface exit_surface(const Hit& hit, Vec3 point, Vec3 direction) const {
    const Vec3 inwards = dot(hit.geometric, direction) > 0.0f ? -hit.geometric : hit.geometric;
    Surface s = surface(hit, point, inwards);
    s.point = point;
    return s;
  }

  // A point of a face as seen from the lumen.
  Surface face_surface(std::uint32_t face, float u, float v) const {
    const std::uint32_t* corners = mesh.corners(face);
    const Vec3 p0 = mesh.position(corners[0]);
    const Vec3 e1 = mesh.position(corners[1]) - p0, e2 = mesh.position(corners[2]) - p0;
    const Vec3 normal = cross(e1, e2), point = p0 + e1 * u + e2 * v;
    // `surface` takes a ray's direction: here that of a ray from above.
    Surface s = surface(Hit{0.0f, u, v, face, normal}, point, -normal);
    s.point = point;
    return s;
  }

  // Axes with normal `n` that turn with the face.
  TangentFrame tissue_frame(std::uint32_t face, Vec3 n) const {
    const std::uint32_t* corners = mesh.corners(face);
    const Vec3 edge = mesh.position(corners[1]) - mesh.position(corners[0]);
    TangentFrame frame(n);
    const Vec3 along = edge - n * dot(edge, n);
    const float l2 = dot(along, along);
    if (l2 > 1e-12f) frame.t = along * (1.0f / std::sqrt(l2)), frame.b = cross(n, frame.t);
    return frame;
  }

 private:
  // `normal` of a face whose relief h has the given rise, seen along `direction`: n - grad h, with the gradient from
  // the rise along two edges, grad h = (rise_1 (e2 x n) + rise_2 (n x e1)) / |n|^2. (A relief's rise along two edges of
  // the rest triangle is its rise along the deformed ones.)
  Vec3 bent(Vec3 normal, Vec3 direction, const std::uint32_t* corners, WallMaterial::Rise rise) const {
    const Vec3 p0 = mesh.position(corners[0]);
    const Vec3 e1 = mesh.position(corners[1]) - p0, e2 = mesh.position(corners[2]) - p0;
    const Vec3 n = cross(e1, e2);
    const float n2 = dot(n, n);
    if (n2 <= 1e-20f) return normal;
    const Vec3 steep = normal - (cross(e2, n) * rise.first + cross(n, e1) * rise.second) * (1.0f / n2);
    const float away = dot(steep, -direction);
    const float length = std::sqrt(dot(direction, direction));
    // A normal that points away from the viewer is bent back just into view.
    return normalize(away > 0.02f * length ? steep : steep - direction * ((0.02f - away / length) / length));
  }

  const FrameSettings& frame_;
  Vec3 origin_;
};

// The viewer is above the surface; interpolated normals may say otherwise at the silhouette.
inline Vec3 upper(Vec3 o) {
  if (o.z >= 1e-3f) return o;
  return normalize({o.x, o.y, 1e-3f});
}

}  // namespace respire
