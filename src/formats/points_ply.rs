//! Coloured points as PLY, in the order of properties that OpenSplat's reader demands and Open3D (nerfstudio), Brush
//! and others take: `x y z` float, `nx ny nz` float, `red green blue` uchar, and no other element.

use std::path::Path;

use glam::DVec3;

use super::colmap::ColoredPoint;
use crate::base::Result;
use crate::base::files::write_atomically;

/// Writes points with their unit normals, one per point.
pub fn write(path: &Path, points: &[ColoredPoint], normals: &[DVec3]) -> Result<()> {
    write_atomically(path, |out| {
        writeln!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}", points.len())?;
        for name in ["x", "y", "z", "nx", "ny", "nz"] {
            writeln!(out, "property float {name}")?;
        }
        writeln!(out, "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header")?;
        for (point, normal) in points.iter().zip(normals) {
            for value in point.position.to_array().into_iter().chain(normal.to_array()) {
                out.write_all(&(value as f32).to_le_bytes())?;
            }
            out.write_all(&point.color)?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_takes_twenty_seven_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.ply");
        let points = [1.0, 2.0].map(|x| ColoredPoint { position: DVec3::X * x, color: [1, 2, 3] });
        write(&path, &points, &[DVec3::Z; 2]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let start = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        assert_eq!(bytes.len() - start, 2 * 27);
        assert_eq!(bytes[start + 27..start + 31], 2f32.to_le_bytes());
        assert_eq!(bytes[start + 24..start + 27], [1, 2, 3]);
    }
}
