//! Surfaces from the formats people have: PLY (ASCII, binary) and OBJ by own readers, STL through `stl_io`; written as
//! binary PLY with double coordinates, since truth is never quantised.

use std::collections::HashMap;
use std::io::Cursor;
use std::path::Path;

use glam::DVec3;

use super::{mesh_obj, mesh_ply};
use crate::base::files::{read_bytes, write_atomically};
use crate::base::{Error, Result, TriangleMesh};

/// Reads a surface; the format follows from the file's extension (`ply`, `stl`, `obj`). Polygons are cut into fans,
/// the corners of an STL are welded where they are equal to the bit. The mesh is valid in the sense of
/// [`TriangleMesh::validate`]; faces keep the winding of the file.
pub fn read(path: &Path) -> Result<TriangleMesh> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    parse(&read_bytes(path)?, &extension).map_err(|e| e.at(path))
}

/// [`read`] for bytes in memory; `extension` is `ply`, `stl` or `obj`.
pub fn parse(bytes: &[u8], extension: &str) -> Result<TriangleMesh> {
    let mesh = match extension {
        "ply" => mesh_ply::parse(bytes),
        "stl" => parse_stl(bytes),
        "obj" => mesh_obj::parse(bytes),
        _ => Err(Error::input("the name must end in .ply, .stl or .obj")),
    }?;
    mesh.validate()?;
    Ok(mesh)
}

/// Writes binary little-endian PLY with double coordinates and one header line per comment.
pub fn write_ply(path: &Path, mesh: &TriangleMesh, comments: &[&str]) -> Result<()> {
    write_ply_as(path, mesh, comments, "double", |out, value| out.write_all(&value.to_le_bytes()))
}

/// [`write_ply`] with coordinates of single precision, for surfaces that are handed on: half the size.
pub fn write_small_ply(path: &Path, mesh: &TriangleMesh, comments: &[&str]) -> Result<()> {
    write_ply_as(path, mesh, comments, "float", |out, value| out.write_all(&(value as f32).to_le_bytes()))
}

fn write_ply_as(
    path: &Path,
    mesh: &TriangleMesh,
    comments: &[&str],
    kind: &str,
    put: impl Fn(&mut dyn std::io::Write, f64) -> std::io::Result<()>,
) -> Result<()> {
    write_atomically(path, |out| {
        writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment units=mm")?;
        for comment in comments {
            writeln!(out, "comment {comment}")?;
        }
        writeln!(out, "element vertex {}", mesh.vertices.len())?;
        writeln!(out, "property {kind} x\nproperty {kind} y\nproperty {kind} z")?;
        writeln!(out, "element face {}\nproperty list uchar int vertex_indices\nend_header", mesh.faces.len())?;
        for vertex in &mesh.vertices {
            for coordinate in vertex.to_array() {
                put(out, coordinate)?;
            }
        }
        for face in &mesh.faces {
            out.write_all(&[3])?;
            for vertex in face {
                out.write_all(&vertex.to_le_bytes())?;
            }
        }
        Ok(())
    })
}

fn parse_stl(bytes: &[u8]) -> Result<TriangleMesh> {
    let damaged = |e: std::io::Error| Error::input(format!("is not a whole STL file: {e}"));
    let mut bytes = Cursor::new(bytes);
    let triangles = stl_io::create_stl_reader(&mut bytes).map_err(damaged)?;
    let mut mesh = TriangleMesh::default();
    let mut known: HashMap<[u32; 3], u32> = HashMap::new();
    for triangle in triangles {
        let corners = triangle.map_err(damaged)?.vertices.map(|v| [v[0], v[1], v[2]]);
        let face = corners.map(|corner| {
            // +0.0 and -0.0 are one place.
            let key = corner.map(|c| (c + 0.0).to_bits());
            *known.entry(key).or_insert_with(|| {
                mesh.vertices.push(DVec3::from_array(corner.map(f64::from)));
                mesh.vertices.len() as u32 - 1
            })
        });
        // Slivers that welding closed are not part of the surface.
        if face[0] != face[1] && face[1] != face[2] && face[2] != face[0] {
            mesh.faces.push(face);
        }
    }
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{self, File};

    fn tetrahedron() -> TriangleMesh {
        TriangleMesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::new(0.1, 1.0 / 3.0, 0.0), DVec3::Z],
            faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        }
    }

    #[test]
    fn ply_round_trip_keeps_every_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ply");
        write_ply(&path, &tetrahedron(), &["SPACE=LPS"]).unwrap();
        assert_eq!(read(&path).unwrap(), tetrahedron());
    }

    #[test]
    fn ascii_ply_stl_and_obj_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let ascii = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                     element face 1\nproperty list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n";
        let path = folder.path().join("a.ply");
        fs::write(&path, ascii).unwrap();
        assert_eq!(read(&path).unwrap().faces, [[0, 1, 2], [0, 2, 3]]);

        let path = folder.path().join("a.obj");
        fs::write(&path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n").unwrap();
        let mesh = read(&path).unwrap();
        mesh.validate_closed().unwrap();

        let path = folder.path().join("a.stl");
        let vertex = |v: u32| stl_io::Vertex::new(mesh.vertices[v as usize].to_array().map(|c| c as f32));
        let triangles: Vec<_> = mesh
            .faces
            .iter()
            .map(|f| stl_io::Triangle { normal: stl_io::Normal::new([0.0; 3]), vertices: f.map(vertex) })
            .collect();
        stl_io::write_stl(&mut File::create(&path).unwrap(), triangles.iter()).unwrap();
        let welded = read(&path).unwrap();
        assert_eq!(welded.vertices.len(), 4);
        welded.validate_closed().unwrap();
    }

    #[test]
    fn damage_is_named_and_never_panics() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ply");
        write_ply(&path, &tetrahedron(), &[]).unwrap();
        let whole = fs::read(&path).unwrap();
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            let message = read(&path).unwrap_err().to_string();
            assert!(message.contains("t.ply"), "{message}");
        }
        let lying = String::from_utf8_lossy(&whole).replace("vertex 4", "vertex 4000000000");
        fs::write(&path, lying.as_bytes()).unwrap();
        assert!(read(&path).is_err());
        let mut mesh = tetrahedron();
        mesh.vertices[2].y = f64::NAN;
        write_ply(&path, &mesh, &[]).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("vertex 2"));
        assert!(read(Path::new("absent.stl")).unwrap_err().to_string().starts_with("absent.stl: reading failed"));
        assert!(read(Path::new("a.vtk")).is_err());
    }
}
