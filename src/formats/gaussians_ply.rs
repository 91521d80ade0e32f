//! The `.ply` of 3D Gaussian splatting, as Inria's code writes it and viewers read it: one element `vertex` of floats
//! `x y z nx ny nz f_dc_0..2 f_rest_0.. opacity scale_0..2 rot_0..3`. `opacity` is a logit, `scale_*` are natural
//! logarithms of standard deviations, `rot_*` is w x y z, `f_rest` is channel-major (all red, then green, then blue).
//! Without `scale_2`, as 2DGS writes it, a Gaussian is a flat disc: its third standard deviation is 0. With `filter_3D`, as
//! Mip-Splatting (Yu et al. 2024, equation 9) writes it, an ellipsoid is widened by that standard deviation, and its
//! opacity falls as its volume grows.
//! Read in any order and any number type; other properties and elements are skipped. A text has a line, or several, for
//! each Gaussian.

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
    /// Whether there is no `scale_2`: the Gaussians are discs of 2DGS.
    flat: bool,
    /// Mip-Splatting's `filter_3D`, if ellipsoids have it.
    filter: Option<usize>,
}

/// Properties that every file has, in the order of the columns; those of 2DGS have no `scale_2`.
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
        let largest = quaternion.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        // Squares of other sizes are beyond double precision.
        let quaternion = if (1e-150..1e150).contains(&largest) { quaternion } else { quaternion.map(|v| v / largest) };
        let length = quaternion.iter().map(|v| v * v).sum::<f64>().sqrt();
        let mut values: Vec<f32> = [0, 1, 2].map(|k| field(k) as f32).to_vec();
        values.extend(quaternion.map(|v| (v / length) as f32));
        let mut scales = [field(7).exp(), field(8).exp(), if places.flat { 0.0 } else { field(9).exp() }];
        let mut opacity = 1.0 / (1.0 + (-field(6)).exp());
        if let Some(filter) = places.filter.map(|place| record[place]) {
            let widened = scales.map(|scale| scale.hypot(filter));
            opacity *= scales.iter().zip(&widened).map(|(scale, wide)| scale / wide).product::<f64>();
            scales = widened;
        }
        values.extend(scales.map(|scale| scale as f32));
        values.push(opacity as f32);
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
/// that the file cannot hold, records that do not match the header.
pub fn read(path: &Path) -> Result<GaussianCloud> {
    parse(&files::read_bytes(path)?).map_err(|e| e.at(path))
}

/// [`read`] for bytes in memory.
pub fn parse(bytes: &[u8]) -> Result<GaussianCloud> {
    let (elements, mut body) = parse_header(bytes)?;
    let Some((vertex, others)) = elements.split_first().filter(|(first, _)| first.name == "vertex") else {
        return Err(Error::input("the first element is not vertex: these are not Gaussians"));
    };
    if let Some(list) = vertex.properties.iter().find(|p| p.list.is_some()) {
        return Err(Error::input("a Gaussian has no lists").element(format!("property {}", list.name)));
    }
    let place = |name: &str| vertex.properties.iter().position(|p| p.name == name);
    let missing = |name: &str| Error::input("is missing: these are not Gaussians").element(format!("property {name}"));
    let flat = place("scale_2").is_none();
    let mut fields = [0; 14];
    for (found, name) in fields.iter_mut().zip(FIELDS).filter(|(_, name)| !flat || *name != "scale_2") {
        *found = place(name).ok_or_else(|| missing(name))?;
    }
    // One more than the highest degree has, so that more are seen; each is a search.
    let rest: Vec<usize> = (0..=coefficients(10)).map_while(|k| place(&format!("f_rest_{k}"))).collect();
    let degree = (0..=10usize).find(|&d| coefficients(d) == rest.len()).ok_or_else(|| {
        Error::input(format!("{} coefficients f_rest belong to no SH degree", rest.len())).element("element vertex")
    })?;
    body.expect_room(vertex)?;
    let channel = rest.len() / 3;
    let filter = place("filter_3D").filter(|_| !flat);
    let places = PropertyColumns { fields, rest, flat, filter };
    let mut cloud = GaussianCloud {
        sh_degree: degree.min(MOST_DEGREE) as u8,
        count_in_file: vertex.count as usize,
        degree_in_file: degree as u8,
        ..GaussianCloud::default()
    };
    let mut record = vec![0.0; vertex.properties.len()];
    for number in 0..vertex.count as usize {
        let start = body.start_record();
        for (value, property) in record.iter_mut().zip(&vertex.properties) {
            *value = body.next(property.number).ok_or_else(|| {
                let message = "the file ends here, or a number cannot be read";
                body.first_mistake(Error::input(message).element(format!("Gaussian {number}")))
            })?;
        }
        if !body.end_record(start, || format!("Gaussian {number}")) {
            let noticed = Error::input("another one follows in its line").element(format!("Gaussian {number}"));
            return Err(body.first_mistake(noticed));
        }
        cloud.push(number, &record, &places, channel);
    }
    body.finish(others)?;
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

    /// Scales `sqrt(s^2 + f^2)` and opacity times `sqrt(det S / det (S + f^2 I))`, by hand.
    #[test]
    fn the_filter_of_mip_splatting_is_applied() {
        let names: String = FIELDS.iter().map(|name| format!("property float {name}\n")).collect();
        let (logit, ln2) = (0.0, 2f64.ln());
        let line = format!("0 0 0 0 0 0 {logit} 0 {ln2} {ln2} 1 0 0 0 1.5\n");
        let text =
            format!("ply\nformat ascii 1.0\nelement vertex 1\n{names}property float filter_3D\nend_header\n{line}");
        let read = parse(text.as_bytes()).unwrap();
        let wide = [3.25f64.sqrt(), 2.5, 2.5];
        for (found, wanted) in read.scales[0].iter().zip(wide) {
            assert!((f64::from(*found) - wanted).abs() < 1e-6, "{found} {wanted}");
        }
        assert!((f64::from(read.opacities[0]) - 0.5 * 4.0 / wide.iter().product::<f64>()).abs() < 1e-6);
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

    #[test]
    fn records_that_do_not_match_the_header_are_refused() {
        let names: String = FIELDS.iter().map(|n| format!("property float {n}\n")).collect();
        let head = format!("ply\nformat ascii 1.0\nelement vertex 3\n{names}");
        let line = |x: f64| format!("{x}{}", " 0.5".repeat(13));
        let lines = [line(0.0), line(1.0), line(2.0)];
        let read = |more: &str, lines: &[String]| {
            parse(format!("{head}{more}end_header\n{}\n", lines.join("\n")).as_bytes()).map_err(|e| e.to_string())
        };
        let places = |cloud: GaussianCloud| cloud.positions.iter().map(|p| p[0]).collect::<Vec<f32>>();
        assert_eq!(places(read("", &lines).unwrap()), [0.0, 1.0, 2.0]);
        // A wrapped record, white space, and an element that nobody wants.
        let wrapped = [lines[0].clone() + " \r", lines[1].replacen(' ', "\n", 1), lines[2].clone() + "\n\n2 7 8"];
        let more = "element face 1\nproperty list uchar int vertex_indices\n";
        assert_eq!(places(read(more, &wrapped).unwrap()), [0.0, 1.0, 2.0]);
        for (changed, says) in [
            (line(1.0) + " 7 7", "Gaussian 1: its line has 16 numbers, and the header's properties are 14"),
            (line(1.0).replacen(" 0.5", "", 3), "Gaussian 1: its line has 11 numbers"),
            (line(1.0).replacen(" 0.5", " x", 1), "Gaussian 1: the file ends here, or a number cannot be read"),
            (line(1.0) + "\n" + &line(1.5), "40 bytes follow the last element"),
        ] {
            let said = read("", &[lines[0].clone(), changed, lines[2].clone()]).unwrap_err();
            assert!(said.starts_with(says), "{said}");
        }
        assert!(read("", &[lines[0].clone(), lines[1].clone(), "2 1".into()]).unwrap_err().starts_with("Gaussian 2"));
        // Binary, with a property that the header forgets.
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.ply");
        write(&path, &cloud(3, 0)).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let cut = bytes.windows(18).position(|w| w == b"property float nx\n").unwrap();
        let forgotten = [&bytes[..cut], &bytes[cut + 18..]].concat();
        let said = parse(&forgotten).unwrap_err().to_string();
        assert!(said.contains("follow the last element: the header names too few"), "{said}");
    }

    #[test]
    fn discs_of_2dgs_are_flat() {
        let names: String =
            FIELDS.iter().filter(|n| **n != "scale_2").map(|n| format!("property float {n}\n")).collect();
        let text = format!("ply\nformat ascii 1.0\nelement vertex 1\n{names}end_header\n1 2 3 0 0 0 0 0 -1 0 0 0 2\n");
        let read = parse(text.as_bytes()).unwrap();
        assert_eq!(read.scales, [[1.0, (-1f64).exp() as f32, 0.0]]);
        assert_eq!((read.positions, read.rotations), (vec![[1.0, 2.0, 3.0]], vec![[0.0, 0.0, 0.0, 1.0]]));
        let without = text.replace("property float scale_1\n", "");
        assert!(parse(without.as_bytes()).unwrap_err().to_string().contains("property scale_1: is missing"));
    }

    #[test]
    fn quaternions_of_any_length_are_unit_quaternions() {
        let names: String = FIELDS.iter().map(|n| format!("property double {n}\n")).collect();
        let head = format!("ply\nformat ascii 1.0\nelement vertex 1\n{names}end_header\n0 0 0 0 0 0 0 0 0 0");
        let rotation = |scale: &str| {
            let text = format!("{head} 1e{scale} -1e{scale} 1e{scale} 1e{scale}\n");
            parse(text.as_bytes()).unwrap().rotations
        };
        for scale in ["0", "20", "200", "300", "-20", "-200", "-300"] {
            assert_eq!(rotation(scale), [[0.5, -0.5, 0.5, 0.5]], "{scale}");
        }
        assert!(parse(format!("{head} 0 0 0 0").as_bytes()).unwrap().is_empty());
    }
}
