//! Wavefront OBJ: coordinates (`v`) and faces (`f`); everything else is skipped. Own reader rather than `tobj`: that one
//! panics on some damaged files, and it gives each group copies of its vertices, so that a closed surface in two groups
//! comes out open.

use glam::DVec3;

use super::mesh_polygons::Fans;
use crate::base::{Error, Result, TriangleMesh};

/// The mesh in the bytes of an OBJ file; the caller validates it. Polygons are cut into fans ([`Fans`]). Errors name the
/// line.
pub(super) fn parse(bytes: &[u8]) -> Result<TriangleMesh> {
    let (mut mesh, mut fans) = (TriangleMesh::default(), Fans::default());
    let mut lines = bytes.split(|&b| b == b'\n').enumerate();
    while let Some((index, first)) = lines.next() {
        // Names and comments may be in any encoding.
        let mut line = String::from_utf8_lossy(first).trim_end().to_owned();
        // A backslash at the end joins the next line.
        while line.ends_with('\\') {
            line.pop();
            let Some((_, next)) = lines.next() else { break };
            line.push(' ');
            line.push_str(String::from_utf8_lossy(next).trim_end());
        }
        let first = mesh.faces.len();
        add_line(&mut mesh, &line).map_err(|sentence| Error::input(sentence).element(format!("line {}", index + 1)))?;
        fans.add(&mesh, first, index + 1);
    }
    fans.settle(&mut mesh, "line")?;
    Ok(mesh)
}

fn add_line(mesh: &mut TriangleMesh, line: &str) -> Result<(), String> {
    let mut words = line.split('#').next().unwrap_or("").split_whitespace();
    match words.next() {
        Some("v") => {
            let mut coordinate = || words.next().and_then(|word| word.parse().ok()).ok_or("needs three numbers");
            let [x, y, z] = [coordinate()?, coordinate()?, coordinate()?];
            mesh.vertices.push(DVec3::new(x, y, z));
        }
        Some("f") => {
            let corners = words.map(|word| corner(word, mesh.vertices.len())).collect::<Result<Vec<u32>, String>>()?;
            let [first, rest @ ..] = corners.as_slice() else { return Err("has no corners".into()) };
            if rest.len() < 2 {
                return Err(format!("has {} corners", corners.len()));
            }
            mesh.faces.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
        }
        _ => {}
    }
    Ok(())
}

/// Vertex of `word` (`7`, `7/1`, `7//3`), which counts from 1, or from -1 backwards from the last of the `known`.
fn corner(word: &str, known: usize) -> Result<u32, String> {
    let number: Option<i64> = word.split('/').next().and_then(|number| number.parse().ok());
    let index = match number {
        None | Some(0) => None,
        Some(number) if number > 0 => Some(number - 1),
        Some(number) => number.checked_add(known as i64).filter(|&index| index >= 0),
    };
    index.and_then(|index| u32::try_from(index).ok()).ok_or_else(|| format!("\"{word}\" names no vertex"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_share_their_vertices_and_indices_count_both_ways() {
        let text = "# caf\u{e9}\no a\nv 0 0 0 1.0\nv 1 0 0 # second\nv 0 1 0\nv 0 0 1\nvn 0 0 1\ng one\nf 1//1 3//1 2//1\n\
                    f 1 \\\n2 4\ng two\nf -4 -1 -2\nf 2/1/1 3/2/1 4\n";
        let mesh = parse(text.as_bytes()).unwrap();
        assert_eq!(mesh.faces, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]);
        mesh.validate_closed().unwrap();
        let polygon = parse(b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\r\nf 1 2 3 4\r\n").unwrap();
        assert_eq!(polygon.faces, [[0, 1, 2], [0, 2, 3]]);
    }

    /// Found by fuzzing: indices out of range, of 0, below the smallest number; coordinates that are none.
    #[test]
    fn damage_is_named() {
        let refused = |text: &str| parse(text.as_bytes()).unwrap_err().to_string();
        assert_eq!(refused("v 0 0 0\nf 0 1 1\n"), "line 2: \"0\" names no vertex");
        assert_eq!(refused("v 0 0 0\nf -2 1 1\n"), "line 2: \"-2\" names no vertex");
        assert!(refused("v 0 0 0\nf -9223372036854775808 1 1\n").contains("names no vertex"));
        assert!(refused("v 0 0 0\nf 9223372036854775807 1 1\n").contains("names no vertex"));
        assert_eq!(refused("v 0 0 0\nf 1 1\n"), "line 2: has 2 corners");
        assert_eq!(refused("f\n"), "line 1: has no corners");
        assert_eq!(refused("\nv 0 x 0"), "line 2: needs three numbers");
    }
}
