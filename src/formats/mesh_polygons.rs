//! Polygons of more than three corners, as the readers of meshes cut them: into a fan from the first corner, which covers a
//! convex one. A concave one may need another corner, or have no fan at all.

use glam::DVec3;

use crate::base::{Error, Result, TriangleMesh};

/// The fans of a mesh of more than one triangle.
#[derive(Debug, Default)]
pub(super) struct Fans(Vec<Fan>);

#[derive(Clone, Copy, Debug)]
struct Fan {
    /// Its first face in the mesh.
    first: usize,
    triangles: usize,
    /// What the file calls the polygon: a line, or a number of a face.
    number: usize,
}

impl Fans {
    /// Notes the polygon `number` of the file, whose triangles begin with the face `first` and are the last of `mesh`.
    pub fn add(&mut self, mesh: &TriangleMesh, first: usize, number: usize) {
        let triangles = mesh.faces.len() - first;
        if triangles > 1 {
            self.0.push(Fan { first, triangles, number });
        }
    }

    /// Cuts concave polygons from a corner that sees all others. Corners that are no vertices are left to whoever
    /// validates the mesh.
    ///
    /// Errors: a polygon that no fan covers, named as `what` and its number.
    pub fn settle(self, mesh: &mut TriangleMesh, what: &str) -> Result<()> {
        for fan in self.0 {
            let faces = &mesh.faces[fan.first..fan.first + fan.triangles];
            let corners: Vec<u32> = faces[0].iter().copied().chain(faces[1..].iter().map(|face| face[2])).collect();
            let places: Option<Vec<DVec3>> = corners.iter().map(|&c| mesh.vertices.get(c as usize).copied()).collect();
            let Some(places) = places else { continue };
            let count = corners.len();
            let Some(start) = (0..count).find(|&start| covers(&places, start)) else {
                let sentence =
                    format!("is a polygon of {count} corners that no fan of triangles covers: write it as triangles");
                return Err(Error::input(sentence).element(format!("{what} {}", fan.number)));
            };
            if start > 0 {
                let corner = |k: usize| corners[(start + k) % count];
                for k in 0..fan.triangles {
                    mesh.faces[fan.first + k] = [corner(0), corner(k + 1), corner(k + 2)];
                }
            }
        }
        Ok(())
    }
}

/// Part of a polygon's area that a triangle may have on its back: corners on one line lie off it by their rounding.
const SLIVER: f64 = 1e-6;

/// Whether the triangles of a fan from the corner `start` all face as the polygon does.
fn covers(places: &[DVec3], start: usize) -> bool {
    let count = places.len();
    let place = |k: usize| places[(start + k) % count] - places[start];
    let normals = (1..count - 1).map(|k| place(k).cross(place(k + 1)));
    let whole: DVec3 = normals.clone().sum();
    normals.into_iter().all(|normal| normal.dot(whole) >= -SLIVER * whole.length_squared())
}

#[cfg(test)]
mod tests {
    use crate::formats::mesh_obj;

    /// The area of an L is that of its triangles from each corner from which it is written, or it is refused.
    #[test]
    fn a_concave_polygon_is_covered_once() {
        let l = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]];
        let mut text: String = l.iter().map(|[x, y]| format!("v {x} {y} 0\n")).collect();
        text += "v 9 9 9\n";
        for start in 0..l.len() {
            let corners: Vec<String> = (0..l.len()).map(|k| ((start + k) % l.len() + 1).to_string()).collect();
            let mesh = mesh_obj::parse(format!("{text}f {}\n", corners.join(" ")).as_bytes()).unwrap();
            assert_eq!(mesh.faces.len(), 4);
            for face in 0..4 {
                assert!(mesh.area_normal(face).z >= 0.0, "start {start}");
            }
            let area: f64 = (0..4).map(|face| mesh.area_normal(face).length()).sum();
            let unit = 2.0 * mesh.area_normal(0).length()
                / (mesh.corners(0)[1] - mesh.corners(0)[0]).cross(mesh.corners(0)[2] - mesh.corners(0)[0]).length();
            assert!((area / unit - 3.0).abs() < 1e-12, "start {start}: {area}");
        }
    }

    /// Sides with corners of their own, none of them exactly on its line: convex, as CAD programs write it.
    #[test]
    fn corners_along_a_side_are_no_concavity() {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let mut text = String::new();
        for side in 0..4 {
            let ([a, b], [c, d]) = (corners[side], corners[(side + 1) % 4]);
            for step in 0..5 {
                let share = f64::from(step) / 5.0;
                let (x, y): (f64, f64) = (a + share * (c - a), b + share * (d - b));
                text += &format!("v {:.6} {:.6} 0\n", 0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y);
            }
        }
        let all: Vec<String> = (1..=20).map(|k: usize| k.to_string()).collect();
        let mesh = mesh_obj::parse(format!("{text}f {}\n", all.join(" ")).as_bytes()).unwrap();
        let area: f64 = (0..mesh.faces.len()).map(|face| mesh.area_normal(face).z).sum();
        assert!(area > 0.0 && mesh.faces.len() == 18);
    }

    /// A letter U with feet: no corner sees all others.
    #[test]
    fn a_polygon_without_a_fan_is_named() {
        let u = [[0, 0], [5, 0], [5, 5], [3, 5], [3, 4], [4, 4], [4, 1], [1, 1], [1, 4], [2, 4], [2, 5], [0, 5]];
        let text: String = u.iter().map(|[x, y]| format!("v {x} {y} 0\n")).collect();
        let said = mesh_obj::parse(format!("{text}f 1 2 3 4 5 6 7 8 9 10 11 12\n").as_bytes()).unwrap_err().to_string();
        assert!(said.contains("line 13") && said.contains("12 corners"), "{said}");
    }
}
