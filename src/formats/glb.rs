//! A breathing surface as binary glTF 2.0 (`.glb`): one mesh with one morph target, and an animation of its weight, so
//! that any viewer shows the breath.
//!
//! glTF is in metres with y up; a node above the mesh turns (mm, LPS: z towards the head) into that, so that the
//! vertices of the file are those of the surface. Coordinates are 32-bit floats, as the format demands.

use glam::{DVec3, Vec3};
use serde_json::json;

use crate::base::{Error, Result, TriangleMesh};

/// Metres in a millimetre.
const METRES: f64 = 1e-3;
/// A quarter turn about x, as quaternion x y z w: z up becomes y up.
const UPRIGHT: [f64; 4] = [-std::f64::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f64::consts::FRAC_1_SQRT_2];

/// Bytes of the file's one buffer, with the views and accessors into it.
#[derive(Default)]
struct GlbBuffer {
    bytes: Vec<u8>,
    views: Vec<serde_json::Value>,
    accessors: Vec<serde_json::Value>,
}

impl GlbBuffer {
    /// Adds numbers as a view of `target` (what the graphics card binds it as, if anything) and gives the number of its
    /// accessor. `more` holds the accessor's type, count and bounds.
    fn add(&mut self, data: impl Iterator<Item = [u8; 4]>, target: Option<u32>, more: serde_json::Value) -> usize {
        let start = self.bytes.len();
        data.for_each(|four| self.bytes.extend(four));
        let mut view = json!({ "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        let mut accessor = more;
        accessor["bufferView"] = self.views.len().into();
        self.views.push(view);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn vectors(&mut self, vectors: &[Vec3]) -> usize {
        let low = vectors.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let high = vectors.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        let more = json!({ "componentType": FLOAT, "count": vectors.len(), "type": "VEC3",
            "min": low.to_array(), "max": high.to_array() });
        self.add(vectors.iter().flat_map(|v| v.to_array().map(f32::to_le_bytes)), Some(ARRAY_BUFFER), more)
    }

    fn scalars(&mut self, values: &[f32]) -> usize {
        let low = values.iter().copied().fold(f32::INFINITY, f32::min);
        let high = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let more =
            json!({ "componentType": FLOAT, "count": values.len(), "type": "SCALAR", "min": [low], "max": [high] });
        self.add(values.iter().map(|v| v.to_le_bytes()), None, more)
    }
}

/// glTF's numbers for types and uses of data.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34_962;
const ELEMENT_ARRAY_BUFFER: u32 = 34_963;

/// `rest` with a morph target `expiration` that leads to `moved`, and a breath of `period_s` seconds from the one to
/// the other and back. Normals are those of `rest`.
///
/// Errors: surfaces with different faces.
pub fn breathing(rest: &TriangleMesh, moved: &TriangleMesh, period_s: f64) -> Result<Vec<u8>> {
    if rest.faces != moved.faces || rest.vertices.len() != moved.vertices.len() {
        return Err(Error::input("the two surfaces have different faces"));
    }
    let single = |v: DVec3| v.as_vec3();
    let positions: Vec<Vec3> = rest.vertices.iter().copied().map(single).collect();
    let shifts: Vec<Vec3> = rest.vertices.iter().zip(&moved.vertices).map(|(r, m)| single(*m - *r)).collect();
    // A vertex without a face has no normal, and glTF wants unit length.
    let normals: Vec<Vec3> =
        rest.vertex_normals().into_iter().map(|n| if n == DVec3::ZERO { Vec3::Z } else { single(n) }).collect();
    let mut buffer = GlbBuffer::default();
    let (position, normal) = (buffer.vectors(&positions), buffer.vectors(&normals));
    let shift = buffer.vectors(&shifts);
    let corners = rest.faces.as_flattened();
    let more = json!({ "componentType": UNSIGNED_INT, "count": corners.len(), "type": "SCALAR" });
    let indices = buffer.add(corners.iter().map(|v| v.to_le_bytes()), Some(ELEMENT_ARRAY_BUFFER), more);
    let times = buffer.scalars(&[0.0, (period_s / 2.0) as f32, period_s as f32]);
    let weights = buffer.scalars(&[0.0, 1.0, 0.0]);
    let document = json!({
        "asset": { "version": "2.0", "generator": "respire-bench" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "name": "airway", "mesh": 0, "rotation": UPRIGHT, "scale": [METRES, METRES, METRES] }],
        "meshes": [{
            "name": "airway",
            "primitives": [{
                "attributes": { "POSITION": position, "NORMAL": normal },
                "indices": indices,
                "material": 0,
                "targets": [{ "POSITION": shift }],
            }],
            "weights": [0.0],
            "extras": { "targetNames": ["expiration"], "unit": "mm", "space": "LPS" },
        }],
        "materials": [{
            "name": "mucosa",
            "doubleSided": true,
            "pbrMetallicRoughness": { "baseColorFactor": [0.78, 0.36, 0.33, 1.0], "metallicFactor": 0.0,
                "roughnessFactor": 0.6 },
        }],
        "animations": [{
            "name": "breath",
            "samplers": [{ "input": times, "output": weights, "interpolation": "LINEAR" }],
            "channels": [{ "sampler": 0, "target": { "node": 0, "path": "weights" } }],
        }],
        "buffers": [{ "byteLength": buffer.bytes.len() }],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
    });
    Ok(container(document.to_string().into_bytes(), buffer.bytes))
}

/// The two chunks behind the header; each is filled up to whole words, the text with blanks.
fn container(mut text: Vec<u8>, mut binary: Vec<u8>) -> Vec<u8> {
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let mut file = b"glTF".to_vec();
    file.extend(2u32.to_le_bytes());
    file.extend((12 + 8 + text.len() as u32 + 8 + binary.len() as u32).to_le_bytes());
    for (name, chunk) in [(b"JSON", text), (b"BIN\0", binary)] {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend(name);
        file.extend(chunk);
    }
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> TriangleMesh {
        TriangleMesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z * 3.0],
            faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        }
    }

    #[test]
    fn chunks_are_whole_words_and_accessors_stay_in_their_buffer() {
        let mut moved = tetrahedron();
        moved.vertices[3].z = 2.0;
        let file = breathing(&tetrahedron(), &moved, 4.0).unwrap();
        let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&file[..4], word(4), word(8)), (&b"glTF"[..], 2, file.len()));
        let text = word(12);
        assert_eq!((text % 4, &file[16..20]), (0, &b"JSON"[..]));
        let document: serde_json::Value = serde_json::from_slice(&file[20..20 + text]).unwrap();
        let binary = &file[20 + text + 8..];
        assert_eq!(document["buffers"][0]["byteLength"].as_u64(), Some(binary.len() as u64));
        let views = document["bufferViews"].as_array().unwrap();
        for accessor in document["accessors"].as_array().unwrap() {
            let view = &views[accessor["bufferView"].as_u64().unwrap() as usize];
            let width = if accessor["type"] == "VEC3" { 12 } else { 4 };
            assert_eq!(view["byteLength"].as_u64().unwrap(), accessor["count"].as_u64().unwrap() * width);
            assert!(view["byteOffset"].as_u64().unwrap() + view["byteLength"].as_u64().unwrap() <= binary.len() as u64);
        }
        // The shift of the last vertex, by the target's accessor.
        let target = document["meshes"][0]["primitives"][0]["targets"][0]["POSITION"].as_u64().unwrap() as usize;
        let start = views[target]["byteOffset"].as_u64().unwrap() as usize;
        assert_eq!(binary[start + 36 + 8..start + 48], (-1f32).to_le_bytes());
        let mut other = tetrahedron();
        other.faces.pop();
        assert!(breathing(&tetrahedron(), &other, 4.0).unwrap_err().to_string().contains("different faces"));
    }

    /// The node's rotation takes the head's direction to glTF's y, the back of the patient away from the viewer.
    #[test]
    fn the_head_is_up() {
        let [x, y, z, w] = UPRIGHT;
        let upright = glam::DQuat::from_xyzw(x, y, z, w);
        assert!((upright * DVec3::Z).distance(DVec3::Y) < 1e-15);
        assert!((upright * DVec3::Y).distance(DVec3::NEG_Z) < 1e-15);
    }
}
