//! The `.ply` of 3D Gaussian splatting, as Inria's code writes it and viewers read it: one element `vertex` of floats
//! `x y z nx ny nz f_dc_0..2 f_rest_0.. opacity scale_0..2 rot_0..3`. `opacity` is a logit, `scale_*` are natural
//! logarithms of standard deviations, `rot_*` is w x y z, `f_rest` is channel-major (all red, then green, then blue).
//! Read in any order and any number type; other properties are skipped.

use std::path::Path;

use super::mesh_ply::parse_header;
use crate::base::{Error, Result, files};

/// Highest SH degree that is kept.
const MOST_DEGREE: usize = 3;

/// Gaussians with activated parameters, structure of arrays.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussianCloud {
    /// Centres.
    pub positions: Vec<[f32; 3]>,
    /// Unit quaternions w x y z.
    pub rotations: Vec<[f32; 4]>,
    /// Standard deviations (linear).
    pub scales: Vec<[f32; 3]>,
    /// In 0..1.
    pub opacities: Vec<f32>,
    /// `(sh_degree + 1)^2 * 3` per Gaussian: coefficient by coefficient, RGB interleaved.
    pub sh: Vec<f32>,
    /// 0 to 3.
    pub sh_degree: u8,
    /// Number of each Gaussian in the file; those with a value that is not finite are left out.
    pub index: Vec<u32>,
    /// How many the file has.
    pub count_in_file: usize,
    /// SH degree of the file, which may be higher than what is kept.
    pub degree_in_file: u8,
}

/// Where the properties of a Gaussian stand in a record.
struct PropertyColumns {
    fields: [usize; 14],
    rest: Vec<usize>,
}

/// Properties that every file has, in the order of the columns.
const FIELDS: [&str; 14] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2",
    "rot_3",
];

impl GaussianCloud {
    /// How many Gaussians are kept.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// True when there is none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Adds one record of the file, or leaves it out when it holds a value that is not finite or no direction.
    fn push(&mut self, number: usize, record: &[f64], places: &PropertyColumns, channel: usize) {
        let field = |k: usize| record[places.fields[k]];
        let quaternion = [10, 11, 12, 13].map(field);
        let length = quaternion.iter().map(|v| v * v).sum::<f64>().sqrt();
        let mut values: Vec<f32> = [0, 1, 2].map(|k| field(k) as f32).to_vec();
        values.extend(quaternion.map(|v| (v / length) as f32));
        values.extend([7, 8, 9].map(|k| field(k).exp() as f32));
        values.push((1.0 / (1.0 + (-field(6)).exp())) as f32);
        values.extend([3, 4, 5].map(|k| field(k) as f32));
        let kept = (self.sh_degree as usize + 1).pow(2) - 1;
        for k in 0..kept {
            values.extend([0, 1, 2].map(|c| record[places.rest[c * channel + k]] as f32));
        }
        // A logit of minus infinity would be an opacity of 0: it is damage all the same.
        if values.iter().any(|v| !v.is_finite()) || !field(6).is_finite() {
            return;
        }
        self.positions.push([values[0], values[1], values[2]]);
        self.rotations.push([values[3], values[4], values[5], values[6]]);
        self.scales.push([values[7], values[8], values[9]]);
        self.opacities.push(values[10]);
        self.sh.extend(&values[11..]);
        self.index.push(number as u32);
    }
}

/// Numbers `f_rest` of an SH degree.
fn coefficients(degree: usize) -> usize {
    3 * ((degree + 1).pow(2) - 1)
}

/// Reads a file. Gaussians with numbers that are not finite are left out and counted, SH beyond degree 3 are ignored.
///
/// Errors name the file: no PLY, a property that is missing, a number of SH coefficients that no degree has, a count
/// that the file cannot hold.
pub fn read(path: &Path) -> Result<GaussianCloud> {
    parse(&files::read_bytes(path)?).map_err(|e| e.at(path))
}

/// [`read`] for bytes in memory.
pub fn parse(bytes: &[u8]) -> Result<GaussianCloud> {
    let (elements, mut body) = parse_header(bytes)?;
    let Some(vertex) = elements.first().filter(|e| e.name == "vertex") else {
        return Err(Error::input("the first element is not vertex: these are not Gaussians"));
    };
    if let Some(list) = vertex.properties.iter().find(|p| p.list.is_some()) {
        return Err(Error::input("a Gaussian has no lists").element(format!("property {}", list.name)));
    }
    let place = |name: &str| vertex.properties.iter().position(|p| p.name == name);
    let missing = |name: &str| Error::input("is missing: these are not Gaussians").element(format!("property {name}"));
    let mut fields = [0; 14];
    for (found, name) in fields.iter_mut().zip(FIELDS) {
        *found = place(name).ok_or_else(|| missing(name))?;
    }
    // One more than the highest degree has, so that more are seen; each is a search.
    let rest: Vec<usize> = (0..=coefficients(10)).map_while(|k| place(&format!("f_rest_{k}"))).collect();
    let degree = (0..=10usize).find(|&d| coefficients(d) == rest.len()).ok_or_else(|| {
        Error::input(format!("{} coefficients f_rest belong to no SH degree", rest.len())).element("element vertex")
    })?;
    body.expect_room(vertex)?;
    let channel = rest.len() / 3;
    let places = PropertyColumns { fields, rest };
    let mut cloud = GaussianCloud {
        sh_degree: degree.min(MOST_DEGREE) as u8,
        count_in_file: vertex.count as usize,
        degree_in_file: degree as u8,
        ..GaussianCloud::default()
    };
    let mut record = vec![0.0; vertex.properties.len()];
    for number in 0..vertex.count as usize {
        for (value, property) in record.iter_mut().zip(&vertex.properties) {
            *value = body.next(property.number).ok_or_else(|| {
                Error::input("the file ends here, or a number cannot be read").element(format!("Gaussian {number}"))
            })?;
        }
        cloud.push(number, &record, &places, channel);
    }
    Ok(cloud)
}

/// Writes a file that every viewer opens, in one atomic step. Opacities of 0 and 1 become the nearest finite logits.
pub fn write(path: &Path, cloud: &GaussianCloud) -> Result<()> {
    let coefficients = (cloud.sh_degree as usize + 1).pow(2);
    let mut header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", cloud.len());
    let rest: Vec<String> = (0..3 * (coefficients - 1)).map(|k| format!("f_rest_{k}")).collect();
    let names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"];
    let last = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    for name in names.into_iter().chain(rest.iter().map(String::as_str)).chain(last) {
        header += &format!("property float {name}\n");
    }
    let mut bytes = (header + "end_header\n").into_bytes();
    for i in 0..cloud.len() {
        let sh = &cloud.sh[3 * coefficients * i..3 * coefficients * (i + 1)];
        let mut record = cloud.positions[i].to_vec();
        record.extend([0.0; 3]);
        record.extend(&sh[..3]);
        for channel in 0..3 {
            record.extend((1..coefficients).map(|k| sh[3 * k + channel]));
        }
        let opacity = cloud.opacities[i].clamp(1e-7, 1.0 - 1e-7);
        record.push((opacity / (1.0 - opacity)).ln());
        record.extend(cloud.scales[i].map(|s| s.max(f32::MIN_POSITIVE).ln()));
        record.extend(cloud.rotations[i]);
        bytes.extend(record.iter().flat_map(|v| v.to_le_bytes()));
    }
    files::write_bytes(path, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(n: usize, degree: u8) -> GaussianCloud {
        let coefficients = (degree as usize + 1).pow(2) * 3;
        GaussianCloud {
            positions: (0..n).map(|i| [i as f32, 0.5, -2.0]).collect(),
            rotations: vec![[0.5, -0.5, 0.5, 0.5]; n],
            scales: (0..n).map(|i| [0.1, 0.2 + i as f32, 0.3]).collect(),
            opacities: (0..n).map(|i| 0.1 + 0.8 * i as f32 / n as f32).collect(),
            sh: (0..n * coefficients).map(|k| (k as f32 * 0.37).sin()).collect(),
            sh_degree: degree,
            index: (0..n as u32).collect(),
            count_in_file: n,
            degree_in_file: degree,
        }
    }

    #[test]
    fn what_is_written_is_read() {
        for degree in 0..=3 {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("g.ply");
            let cloud = cloud(7, degree);
            write(&path, &cloud).unwrap();
            let read = read(&path).unwrap();
            assert_eq!((read.len(), read.sh_degree, &read.sh), (7, degree, &cloud.sh));
            let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-5 * b.abs().max(1.0));
            assert!(near(&read.opacities, &cloud.opacities));
            assert!(near(read.scales.as_flattened(), cloud.scales.as_flattened()));
            assert_eq!((read.positions, read.rotations), (cloud.positions, cloud.rotations));
        }
    }

    /// The order and the activations, byte by byte: other people's viewers rely on them.
    #[test]
    fn the_file_is_as_inria_writes_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.ply");
        let mut one = cloud(1, 1);
        one.sh = (0..12).map(|k| k as f32).collect();
        one.opacities = vec![0.5];
        one.scales = vec![[1.0; 3]];
        write(&path, &one).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let text = String::from_utf8_lossy(&bytes[..end]);
        assert!(text.starts_with("ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\n"));
        assert!(text.contains("float f_dc_2\nproperty float f_rest_0\n"));
        assert!(text.contains("float f_rest_8\nproperty float opacity\nproperty float scale_0\n"));
        let values: Vec<f32> = bytes[end..].as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)).collect();
        // Centre, normal, DC, the three reds, greens and blues of degree 1, logit, logarithms, w x y z.
        let expected = [
            0.0, 0.5, -2.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 6.0, 9.0, 4.0, 7.0, 10.0, 5.0, 8.0, 11.0, 0.0, 0.0, 0.0,
            0.0, 0.5, -0.5, 0.5, 0.5,
        ];
        assert_eq!(values, expected);
    }

    #[test]
    fn damage_is_dropped_and_counted_or_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.ply");
        let mut broken = cloud(5, 1);
        broken.positions[1][2] = f32::NAN;
        broken.sh[12 * 3 + 5] = f32::INFINITY;
        broken.rotations[4] = [0.0; 4];
        write(&path, &broken).unwrap();
        let read_back = read(&path).unwrap();
        assert_eq!((read_back.index, read_back.count_in_file), (vec![0, 2], 5));
        let refused = |text: &str| parse(text.as_bytes()).unwrap_err().to_string();
        assert!(
            refused("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n")
                .contains("property y")
        );
        let names: String = FIELDS.iter().map(|n| format!("property float {n}\n")).collect();
        let head = format!("ply\nformat ascii 1.0\nelement vertex 9\n{names}");
        assert!(refused(&format!("{head}property float f_rest_0\nend_header\n")).contains("no SH degree"));
        assert!(refused(&format!("{head}end_header\n1 2 3")).contains("cannot hold"));
        // Degree 4: what the rasteriser cannot show is ignored.
        let rest: String = (0..72).map(|k| format!("property float f_rest_{k}\n")).collect();
        let values = ["0.5"; 86].join(" ");
        let four =
            parse(format!("{}{rest}end_header\n{values}\n", head.replace("vertex 9", "vertex 1")).as_bytes()).unwrap();
        assert_eq!((four.degree_in_file, four.sh_degree, four.sh.len()), (4, 3, 48));
    }
}
