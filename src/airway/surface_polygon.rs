//! Polygons of the zero surface by marching tetrahedra.
//!
//! Every cube of the grid is cut into the six tetrahedra around its main diagonal (Kuhn); neighbouring cubes agree on
//! their common faces, and inside a tetrahedron there is no ambiguous case: the surface is a closed 2-manifold by
//! construction. Winding: normals point to negative values, into the lumen.

use std::collections::HashMap;

use super::surface_field::LumenField;
use crate::base::TriangleMesh;

/// Corners (bit 0 x, bit 1 y, bit 2 z) of the six tetrahedra of a cube.
const TETRAHEDRA: [[usize; 4]; 6] =
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];

/// The zero surface of `field`.
pub fn polygonise(field: &LumenField) -> TriangleMesh {
    let [nx, ny, nz] = field.size();
    let mut mesh = TriangleMesh::default();
    let mut vertex_of_edge: HashMap<(usize, usize), u32> = HashMap::new();
    for z in 0..nz - 1 {
        for y in 0..ny - 1 {
            for x in 0..nx - 1 {
                let corner = |c: usize| [x + (c & 1), y + ((c >> 1) & 1), z + (c >> 2)];
                let values: [f32; 8] = std::array::from_fn(|c| field.value(corner(c)));
                let inside = values.iter().filter(|v| **v < 0.0).count();
                if inside == 0 || inside == 8 {
                    continue;
                }
                for tetrahedron in TETRAHEDRA {
                    let mut edge = |a: usize, b: usize| {
                        let (low, high) = (a.min(b), a.max(b));
                        let key = (field.index(corner(low)), field.index(corner(high)));
                        *vertex_of_edge.entry(key).or_insert_with(|| {
                            let (u, v) = (values[low] as f64, values[high] as f64);
                            // Away from the nodes, so that no triangle degenerates to a point.
                            let t = (u / (u - v)).clamp(0.02, 0.98);
                            mesh.vertices.push(field.position(corner(low)).lerp(field.position(corner(high)), t));
                            mesh.vertices.len() as u32 - 1
                        })
                    };
                    cut(tetrahedron, &values, &mut edge, &mut mesh.faces);
                }
            }
        }
    }
    mesh
}

/// Adds the triangles of one tetrahedron of positive orientation.
fn cut(corners: [usize; 4], values: &[f32; 8], edge: &mut impl FnMut(usize, usize) -> u32, faces: &mut Vec<[u32; 3]>) {
    let mask = (0..4).filter(|&k| values[corners[k]] < 0.0).fold(0usize, |m, k| m | 1 << k);
    // An even permutation of the corners that brings the negative ones to the front keeps the orientation.
    let order: [usize; 4] = match mask {
        0 | 15 => return,
        0b0001 | 0b1110 => [0, 1, 2, 3],
        0b0010 | 0b1101 => [1, 0, 3, 2],
        0b0100 | 0b1011 => [2, 0, 1, 3],
        0b1000 | 0b0111 => [3, 0, 2, 1],
        0b0011 => [0, 1, 2, 3],
        0b1100 => [2, 3, 0, 1],
        0b0101 => [0, 2, 3, 1],
        0b1010 => [1, 3, 2, 0],
        0b1001 => [0, 3, 1, 2],
        _ => [1, 2, 0, 3],
    };
    let [a, b, c, d] = order.map(|k| corners[k]);
    match mask.count_ones() {
        1 => faces.push([edge(a, b), edge(a, d), edge(a, c)]),
        3 => faces.push([edge(a, b), edge(a, c), edge(a, d)]),
        _ => {
            let (ac, ad, bc, bd) = (edge(a, c), edge(a, d), edge(b, c), edge(b, d));
            faces.push([ac, bc, ad]);
            faces.push([bc, bd, ad]);
        }
    }
}
