//! Damaged mesh files: every reader answers with a sentence that names the file, never with a panic, and never takes
//! memory because a header says so.

use std::fs;
use std::path::Path;

use glam::DVec3;
use respire_bench::base::TriangleMesh;
use respire_bench::base::random::{CounterRng, Stage};
use respire_bench::formats::mesh;

use crate::skip::shared;

fn octahedron() -> TriangleMesh {
    TriangleMesh {
        vertices: [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|a| [a / 3.0, -a / 3.0]).collect(),
        faces: vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]],
    }
}

/// The octahedron in every format that is read, as (file name, bytes).
fn whole_files() -> Vec<(&'static str, Vec<u8>)> {
    let mesh = octahedron();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("binary.ply");
    mesh::write_ply(&path, &mesh, &["a comment"]).unwrap();
    let binary_ply = fs::read(path).unwrap();
    let mut ascii_ply = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n\
        property float z\nelement face 8\nproperty list uchar int vertex_indices\nend_header\n"
        .to_string();
    let (mut obj, mut ascii_stl) = (String::new(), "solid s\n".to_string());
    let mut binary_stl = vec![0; 80];
    binary_stl.extend(8u32.to_le_bytes());
    for v in &mesh.vertices {
        ascii_ply += &format!("{} {} {}\n", v.x, v.y, v.z);
        obj += &format!("v {} {} {}\n", v.x, v.y, v.z);
    }
    for (f, [a, b, c]) in mesh.faces.iter().enumerate() {
        ascii_ply += &format!("3 {a} {b} {c}\n");
        obj += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
        ascii_stl += "facet normal 0 0 0\nouter loop\n";
        binary_stl.extend([0; 12]);
        for corner in mesh.corners(f) {
            ascii_stl += &format!("vertex {} {} {}\n", corner.x, corner.y, corner.z);
            binary_stl.extend(corner.to_array().iter().flat_map(|&x| (x as f32).to_le_bytes()));
        }
        ascii_stl += "endloop\nendfacet\n";
        binary_stl.extend([0; 2]);
    }
    ascii_stl += "endsolid s\n";
    vec![
        ("binary.ply", binary_ply),
        ("ascii.ply", ascii_ply.into_bytes()),
        ("binary.stl", binary_stl),
        ("ascii.stl", ascii_stl.into_bytes()),
        ("mesh.obj", obj.into_bytes()),
    ]
}

/// Reads `bytes` as a file `name`; a refusal must name the file, an acceptance must be valid.
fn read_as(folder: &Path, name: &str, bytes: &[u8]) -> Result<TriangleMesh, String> {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    match mesh::read(&path) {
        Ok(mesh) => {
            mesh.validate().unwrap();
            Ok(mesh)
        }
        Err(error) => {
            let sentence = error.to_string();
            assert!(sentence.contains(name) && error.kind().exit_code() == 4, "{sentence}");
            Err(sentence)
        }
    }
}

#[test]
fn whole_files_are_the_same_closed_mesh() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in whole_files() {
        let mesh = read_as(folder.path(), name, &bytes).unwrap();
        mesh.validate_closed().unwrap();
        assert_eq!((mesh.vertices.len(), mesh.faces.len()), (6, 8), "{name}");
        let volume = mesh.signed_volume().abs();
        assert!((volume - octahedron().signed_volume().abs()).abs() < 1e-6, "{name}: {volume}");
    }
}

#[test]
fn no_cut_and_no_flipped_byte_panics() {
    let folder = tempfile::tempdir().unwrap();
    for (format, (name, whole)) in whole_files().into_iter().enumerate() {
        for cut in (0..whole.len()).step_by(7) {
            let _ = read_as(folder.path(), name, &whole[..cut]);
        }
        for round in 0..200 {
            let mut rng = CounterRng::new(7, Stage::Test, &[format as u64, round]);
            let mut bytes = whole.clone();
            for _ in 0..1 + rng.index(4) {
                let at = rng.index(bytes.len());
                bytes[at] = rng.next_u32() as u8;
            }
            let _ = read_as(folder.path(), name, &bytes);
        }
    }
}

#[test]
fn half_a_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (name, whole) in whole_files() {
        // A cut OBJ or ASCII STL may end at a line that is whole; in the middle of the vertices it cannot.
        let cut = if name == "mesh.obj" { 30 } else { whole.len() / 2 };
        assert!(read_as(folder.path(), name, &whole[..cut]).is_err(), "{name}");
    }
}

#[test]
fn counts_that_lie_are_refused_without_the_memory() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = whole_files();
    let ((_, stl), (_, ply)) = (files.swap_remove(2), files.swap_remove(0));
    let text = |from: &str, to: &str| {
        let end = ply.windows(11).position(|w| w == b"end_header\n").unwrap();
        let header = String::from_utf8(ply[..end].to_vec()).unwrap();
        assert!(header.contains(from));
        [header.replace(from, to).as_bytes(), &ply[end..]].concat()
    };
    for lie in ["7", "4000000000", "18446744073709551615", "18446744073709551616", "-1", "six"] {
        for element in ["vertex 6", "face 8"] {
            let (word, _) = element.split_once(' ').unwrap();
            read_as(folder.path(), "lie.ply", &text(element, &format!("{word} {lie}"))).unwrap_err();
        }
    }
    let wide_list = text("list uchar int", "list uint int");
    read_as(folder.path(), "list.ply", &wide_list).unwrap_err();
    let mut long_stl = stl;
    long_stl[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    read_as(folder.path(), "lie.stl", &long_stl).unwrap_err();
}

#[test]
fn values_that_are_no_numbers_name_the_element() {
    let folder = tempfile::tempdir().unwrap();
    for bad in ["nan", "inf"] {
        let ascii = format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 {bad} 0\n0 1 0\n3 0 1 2\n"
        );
        let sentence = read_as(folder.path(), "bad.ply", ascii.as_bytes()).unwrap_err();
        assert!(sentence.contains("vertex 1"), "{sentence}");
        let obj = format!("v 0 0 0\nv 1 {bad} 0\nv 0 1 0\nf 1 2 3\n");
        let sentence = read_as(folder.path(), "bad.obj", obj.as_bytes()).unwrap_err();
        assert!(sentence.contains("vertex 1"), "{sentence}");
    }
    let (_, mut stl) = whole_files().swap_remove(2);
    stl[84 + 12..84 + 16].copy_from_slice(&f32::NAN.to_le_bytes());
    let sentence = read_as(folder.path(), "bad.stl", &stl).unwrap_err();
    assert!(sentence.contains("vertex 0"), "{sentence}");
}

#[test]
fn real_meshes_written_by_trimesh_are_read_whole() {
    for (name, vertices, faces) in [("ATM_384.ply", 89_810, 179_616), ("ATM_224.ply", 124_074, 248_144)] {
        let Some(path) = shared(&format!("data/atm22/meshes/{name}")) else { continue };
        let mesh = mesh::read(&path).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.faces.len()), (vertices, faces));
        mesh.validate_closed().unwrap();
        let litres = mesh.signed_volume() * 1e-6;
        assert!((0.01..0.2).contains(&litres), "an airway lumen with normals outwards: {litres} l");
    }
}
