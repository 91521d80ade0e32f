//! Registers two breath holds with elastix, a program of its own: what moves where between inspiration and expiration.
//!
//! Both scans go in coarser, cropped to the lungs, as local contrast (`local_contrast.rs`), and with a mask: lungs
//! and airway, so that the ribs, which do not move with the lung, pull at nothing. Affine, then B-spline (Klein et al.,
//! IEEE Trans Med Imaging 29:196, 2010; lungs after Staring et al. at EMPIRE10). Parameters are files beside this one, and
//! are kept with the case, with the version of the program.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use glam::DVec3;

use super::local_contrast::local_contrast;
use super::lungs::{chest_air, on_grid};
use super::parts::grown;
use super::program::{REMEDY, run};
use crate::base::{Error, ErrorKind, Progress, Result, Volume, files};
use crate::formats::{nifti, volume};

/// The parameter files, in order, by the names under which a case keeps them.
pub const PARAMETERS: [(&str, &str); 2] = [
    ("elastix-affine.txt", include_str!("elastix/affine.txt")),
    ("elastix-bspline.txt", include_str!("elastix/bspline.txt")),
];
/// Voxels in mm that a registration works on.
pub const REGISTRATION_MM: f64 = 1.5;
/// Room in mm around the lungs, and around the airway in the mask.
const MARGIN_MM: f64 = 15.0;
const AROUND_AIRWAY_MM: f64 = 6.0;

/// One scan as the registration takes it.
pub struct RegistrationInput {
    /// HU, cropped and coarse.
    pub scan: Volume<i16>,
    /// Lungs and airway: where it matters.
    pub mask: Volume<u8>,
    /// The lungs alone.
    pub lungs: Volume<u8>,
    /// Lungs and airways as a threshold finds them: what stands out of its surroundings is told by them, since in both
    /// scans they are found by one rule, whether anybody knows the airway or not.
    pub air: Volume<u8>,
}

impl RegistrationInput {
    /// Crops a coarse scan with its lungs to where there is air, and adds the surroundings of the airway to the mask.
    pub fn new(scan: &Volume<i16>, lungs: &Volume<u8>, airway: Option<&Volume<u8>>) -> RegistrationInput {
        let mut mask = lungs.clone();
        if let Some(airway) = airway {
            let near = grown(&on_grid(airway, scan), AROUND_AIRWAY_MM);
            mask.data.iter_mut().zip(&near.data).filter(|(_, near)| **near > 0).for_each(|(value, _)| *value = 1);
        }
        let air = chest_air(scan, lungs);
        let spacing = scan.grid.spacing_mm();
        let margin = [0, 1, 2].map(|a| (MARGIN_MM / spacing[a]).ceil() as usize);
        let (mut low, mut high) = (scan.grid.size, [0usize; 3]);
        for at in (0..mask.data.len()).filter(|&at| mask.data[at] > 0 || air.data[at] > 0) {
            let cell = mask.grid.cell(at);
            for a in 0..3 {
                low[a] = low[a].min(cell[a].saturating_sub(margin[a]));
                high[a] = high[a].max((cell[a] + margin[a] + 1).min(scan.grid.size[a]));
            }
        }
        RegistrationInput {
            scan: scan.cropped(low, high),
            mask: mask.cropped(low, high),
            lungs: lungs.cropped(low, high),
            air: air.cropped(low, high),
        }
    }
}

/// The version of elastix, such as `5.0.1`; `None` where it is not installed or does not start.
pub fn elastix_version() -> Option<String> {
    started_version().ok()
}

/// The version, or why there is none.
fn started_version() -> std::result::Result<String, String> {
    let output =
        Command::new("elastix").arg("--version").stdin(Stdio::null()).output().map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => "which is not installed".to_owned(),
            _ => format!("which cannot be started ({e})"),
        })?;
    let text = String::from_utf8_lossy(&output.stdout).to_string();
    let word = text.split_whitespace().find(|w| w.starts_with(|c: char| c.is_ascii_digit()));
    word.map(str::to_owned).ok_or_else(|| {
        let said = String::from_utf8_lossy(&output.stderr).to_string();
        let said = said.lines().map(str::trim).rfind(|line| !line.is_empty()).unwrap_or("it said nothing").to_owned();
        format!("which is installed and does not work ({said})")
    })
}

/// Refuses work that needs elastix where it is not installed or does not work, with the command that installs it.
pub fn demand_elastix() -> Result<String> {
    started_version().map_err(|what| {
        let sentence =
            format!("registering two scans needs elastix, {what}: run {REMEDY}, or give a field with --field");
        Error::new(ErrorKind::Environment, sentence)
    })
}

/// The displacement of `fixed`'s voxels to where the same tissue is in `moving`, on the grid of `fixed`. Works in
/// `folder`, which it leaves for the caller to remove.
///
/// Errors: elastix is missing or fails (its last words are told); the user stopped the work.
pub fn register(
    fixed: &RegistrationInput,
    moving: &RegistrationInput,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Volume<[f32; 3]>> {
    let place = |name: &str| folder.join(name);
    std::fs::create_dir_all(folder).map_err(|e| Error::io("writing", folder, e))?;
    nifti::write(&place("fixed.nii"), &local_contrast(&fixed.scan, &fixed.air))?;
    nifti::write(&place("moving.nii"), &local_contrast(&moving.scan, &moving.air))?;
    nifti::write(&place("mask.nii"), &fixed.mask)?;
    let threads = rayon::current_num_threads().to_string();
    let mut command = Command::new("elastix");
    command.arg("-f").arg(place("fixed.nii")).arg("-m").arg(place("moving.nii"));
    command.arg("-fMask").arg(place("mask.nii"));
    for (name, text) in PARAMETERS {
        files::write_bytes(&place(name), text.as_bytes())?;
        command.arg("-p").arg(place(name));
    }
    command.arg("-out").arg(folder).args(["-threads", &threads]);
    run(command, &place("elastix.out"), progress)?;
    let mut command = Command::new("transformix");
    command.args(["-def", "all", "-tp"]).arg(place(&format!("TransformParameters.{}.txt", PARAMETERS.len() - 1)));
    command.arg("-out").arg(folder).args(["-threads", &threads]);
    run(command, &place("transformix.out"), progress)?;
    let made: PathBuf = place("deformationField.mha");
    let field = volume::read_field(&made)?;
    if !field.grid.same_as(&fixed.scan.grid) {
        return Err(Error::input("has another grid than the scan it was made for").at(&made));
    }
    Ok(field)
}

/// The mean of the displacement over a mask of the field's grid, mm: what a patient's shift on the table adds.
pub fn mean_displacement(field: &Volume<[f32; 3]>, mask: &Volume<u8>) -> DVec3 {
    let inside = field.data.iter().zip(&mask.data).filter(|(_, inside)| **inside > 0);
    let (sum, count) = inside.fold((DVec3::ZERO, 0usize), |(sum, count), (v, _)| {
        (sum + DVec3::new(v[0].into(), v[1].into(), v[2].into()), count + 1)
    });
    sum / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};
    use crate::base::{NoProgress, VoxelGrid};
    use crate::ct::lungs::find_lungs;
    use crate::ct::motion_field::carried;
    use crate::skip::skip;

    /// Texture of smooth bumps, moved by a known motion: registered, it gives the motion back.
    #[test]
    fn elastix_finds_a_known_motion() {
        let Some(version) = elastix_version() else {
            return skip("elastix", &format!("elastix is not installed ({REMEDY})"));
        };
        println!("elastix {version}");
        let grid = VoxelGrid::upright([48, 48, 48], DVec3::new(-70.0, -70.0, -1070.0), DVec3::splat(3.0));
        let mut rng = CounterRng::new(8, Stage::Test, &[]);
        let bumps: Vec<(DVec3, f64)> = (0..300)
            .map(|_| {
                (
                    DVec3::new(rng.range(-70.0, 70.0), rng.range(-70.0, 70.0), rng.range(-1070.0, -930.0)),
                    rng.range(4.0, 9.0),
                )
            })
            .collect();
        let texture = |p: DVec3| {
            let sum: f64 = bumps.iter().map(|(c, r)| (-p.distance_squared(*c) / (r * r)).exp()).sum();
            (-900.0 + 500.0 * sum).min(200.0) as i16
        };
        // Expiration: what is at x is found at x + u; u is the same along each z.
        let motion = |p: DVec3| DVec3::new(2.0, 0.0, 8.0 * ((p.x / 70.0).cos()));
        let fixed = Volume { grid, data: (0..grid.count()).map(|at| texture(grid.centre(at))).collect() };
        let back = |p: DVec3| (0..20).fold(p, |x, _| p - motion(x));
        let moving = Volume { grid, data: (0..grid.count()).map(|at| texture(back(grid.centre(at)))).collect() };
        let whole = Volume::filled(grid, 1u8);
        let input = |scan: &Volume<i16>| RegistrationInput {
            scan: scan.clone(),
            mask: whole.clone(),
            lungs: whole.clone(),
            air: whole.clone(),
        };
        let folder = tempfile::tempdir().unwrap();
        let field = register(&input(&fixed), &input(&moving), folder.path(), &NoProgress).unwrap();
        let inner: Vec<f64> = (0..grid.count())
            .filter(|&at| grid.cell(at).iter().all(|c| (8..40).contains(c)))
            .map(|at| {
                let [x, y, z] = field.data[at].map(f64::from);
                (DVec3::new(x, y, z) - motion(grid.centre(at))).length()
            })
            .collect();
        let mean = inner.iter().sum::<f64>() / inner.len() as f64;
        assert!(mean < 0.5, "{mean}");
    }

    /// A chest: two lungs with bumps in them, and a trachea that runs from 90 mm above their middle down between them and
    /// divides into both. HU, and which voxels are airway.
    fn chest() -> (Volume<i16>, Volume<u8>) {
        let grid = VoxelGrid::upright([110, 80, 84], DVec3::new(-165.0, -120.0, -150.0), DVec3::splat(3.0));
        let mut rng = CounterRng::new(11, Stage::Test, &[]);
        let bumps: Vec<DVec3> = (0..400)
            .map(|_| DVec3::new(rng.range(-120.0, 120.0), rng.range(-70.0, 70.0), rng.range(-130.0, 30.0)))
            .collect();
        let tube = |p: DVec3, a: DVec3, b: DVec3| {
            let along = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            p.distance(a.lerp(b, along))
        };
        let carina = DVec3::new(0.0, 5.0, -30.0);
        let lumen = |p: DVec3| {
            let bronchi = [-50.0, 50.0].map(|x| tube(p, carina, DVec3::new(x, 10.0, -60.0)) - 7.0);
            (tube(p, DVec3::new(0.0, -15.0, 120.0), carina) - 9.0).min(bronchi[0]).min(bronchi[1])
        };
        let value = |p: DVec3| {
            let lung =
                ((p - DVec3::new(p.x.signum() * 70.0, 5.0, -50.0)) / DVec3::new(48.0, 70.0, 80.0)).length() < 1.0;
            match lumen(p) {
                _ if (p.truncate() / glam::DVec2::new(150.0, 105.0)).length() > 1.0 => -1000,
                d if d < 0.0 => -980,
                // Thin walls in the lung do not part airway and lung at this voxel size.
                d if d < 3.0 && !lung => 20,
                _ if lung && bumps.iter().any(|b| p.distance(*b) < 5.0) => 30,
                _ if lung => -850,
                _ => 40,
            }
        };
        let places: Vec<DVec3> = (0..grid.count()).map(|at| grid.centre(at)).collect();
        let airway = places.iter().map(|p| u8::from(lumen(*p) < 0.0)).collect();
        (Volume { grid, data: places.iter().map(|p| value(*p)).collect() }, Volume { grid, data: airway })
    }

    /// One scan on both sides, with its airway known on one and unknown on the other as in every import: it looks the same
    /// from both, above the lungs, too, so that nothing moves.
    #[test]
    fn a_scan_is_its_own_match() {
        let (scan, airway) = chest();
        let apart = find_lungs(&scan, Some(&airway)).unwrap();
        let whole = find_lungs(&scan, None).unwrap();
        let fixed = RegistrationInput::new(&scan, &apart, Some(&airway));
        let moving = RegistrationInput::new(&scan, &whole, None);
        let asked: Vec<usize> = (0..fixed.mask.data.len()).filter(|&at| fixed.mask.data[at] > 0).collect();
        let differing = |of: fn(&RegistrationInput) -> &Volume<u8>| {
            let [one, other] = [&fixed, &moving].map(|input| local_contrast(&input.scan, of(input)));
            let to_index = other.grid.index_from_place();
            let is_other = |at: &&usize| {
                let value = other.nearest(to_index(one.grid.centre(**at)));
                value.is_none_or(|value| (one.data[**at] - value).abs() > 10)
            };
            asked.iter().filter(is_other).count() as f64 / asked.len() as f64
        };
        let differ = differing(|input| &input.air);
        assert!(differ < 0.005, "{:.1} % of what is registered looks another", 100.0 * differ);
        // The lungs alone are not the same in both.
        let differ = differing(|input| &input.lungs);
        assert!(differ > 0.05, "{:.1} %", 100.0 * differ);

        let Some(_) = elastix_version() else {
            return skip("elastix", &format!("elastix is not installed ({REMEDY})"));
        };
        let folder = tempfile::tempdir().unwrap();
        let field = register(&fixed, &moving, folder.path(), &NoProgress).unwrap();
        let places = (0..scan.data.len()).filter(|&at| airway.data[at] > 0).map(|at| scan.grid.centre(at));
        let places: Vec<DVec3> = places.collect();
        let moved = carried(&field, &places);
        let most = places.iter().zip(&moved).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(most < 1.0, "{most}");
    }

    #[test]
    fn the_input_is_cropped_to_the_lungs() {
        let grid = VoxelGrid::upright([60, 60, 60], DVec3::ZERO, DVec3::splat(3.0));
        let mut lungs = Volume::filled(grid, 0u8);
        lungs.data[grid.at([30, 31, 32])] = 1;
        let input = RegistrationInput::new(&Volume::filled(grid, 0i16), &lungs, None);
        assert_eq!(input.scan.grid.size, [11; 3]);
        assert_eq!(input.mask.value([5, 5, 5]), 1);
        assert_eq!(input.scan.grid.centre(input.scan.grid.at([5, 5, 5])), grid.centre(grid.at([30, 31, 32])));
    }
}
