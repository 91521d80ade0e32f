//! What a film of the clinical track has on disk beside one of the ideal track: what methods are told in place of the
//! truth, and the truth that no phase says.

use std::path::Path;

use rayon::prelude::*;

use crate::airway::case::Case;
use crate::airway::centerline::CenterlineSettings;
use crate::airway::centerline_distance::SurfaceDistance;
use crate::airway::centerline_extract::extract;
use crate::airway::target::Target;
use crate::airway::{Anatomy, case_centerline};
use crate::base::{Error, Result, TriangleMesh, files};
use crate::formats::transforms::{Transforms, TransformsFrame};
use crate::formats::{mesh as mesh_file, png};

use super::clinical::ClinicalFilm;
use super::clinical::table::{PictureShares, table};
use super::film::Film;
use super::film_tables;
use super::misregister::misregister;
use super::sequence::{self, FrameRecord};

/// Codes that count as clipped: a lossy recorder rounds the highest ones down a little.
const CLIPPED: u8 = 253;

/// Writes them below `out`, whose frames are finished; `planned` are the targets.
pub(super) fn write(
    case: &Case,
    anatomy: &Anatomy,
    planned: &[Target],
    film: &Film,
    clinical: &ClinicalFilm,
    out: &Path,
) -> Result<()> {
    write_cameras(film, clinical, out)?;
    let given = write_surfaces(case, anatomy, clinical, out)?;
    let last_s = film.frames.last().map_or(0.0, |frame| frame.time_s);
    let last = TriangleMesh { vertices: clinical.wall_at(last_s), faces: anatomy.inspiration.faces.clone() };
    mesh_file::write_ply(&out.join(sequence::LAST_SURFACE), &last, &["units mm", "space LPS"])?;

    let mut text = format!("{}\n", film_tables::TARGETS_BY_FRAME_HEADER);
    for (frame, conditions) in film.conditions.iter().enumerate() {
        for (index, target) in planned.iter().enumerate() {
            let point = clinical.motion.point(target.inspiration_mm, target.expiration_mm);
            let p = clinical.motion.place(&point, &conditions.body);
            text += &format!("{frame},{index},{},{},{}\n", p.x, p.y, p.z);
        }
    }
    files::write_bytes(&out.join(sequence::TARGETS_BY_FRAME), text.as_bytes())?;

    let times_s: Vec<f64> = film.frames.iter().map(|f| f.time_s).collect();
    let poses: Vec<_> = film.frames.iter().map(|f| f.world_from_camera).collect();
    let shares = (0..film.frames.len()).into_par_iter().map(|frame| shares(out, frame)).collect::<Result<Vec<_>>>()?;
    let text = table(&times_s, &poses, &film.conditions, &shares);
    files::write_bytes(&out.join(sequence::CONDITIONS), text.as_bytes())?;
    let optics = &clinical.optics;
    let sizes = serde_json::json!({
        "sizes": clinical.settings,
        "surfaces": given,
        "cough_s": clinical.motion.cough_s,
        "contact_s": clinical.contact.as_ref().map(|contact| contact.middle_s),
        "share_of_motion_beyond_phase": clinical.motion.share,
        "lens": { "true": optics.camera, "told": optics.told_camera },
        "lamp_mm": optics.lamp_mm.to_array(),
        "lamp_half_angle_deg": optics.half_angle_deg,
        "vignette": optics.vignette,
    });
    files::write_json(&out.join(sequence::SIZES), &sizes)
}

fn write_cameras(film: &Film, clinical: &ClinicalFilm, out: &Path) -> Result<()> {
    // No exposure, no phase: what is told stands here alone.
    let entry = |file_path: String, frame: &FrameRecord, pose: &glam::DAffine3| TransformsFrame {
        file_path,
        depth_file_path: None,
        mask_path: None,
        transform_matrix: TransformsFrame::matrix(pose),
        time: frame.time_s,
        breathing_phase: None,
        exposure: 1.0,
        white_balance: [1.0; 3],
        lens: Default::default(),
    };
    let told = film.frames.iter().zip(&film.conditions).enumerate();
    let entries = told.map(|(i, (frame, c))| entry(sequence::image_name(i), frame, &c.fault.told)).collect();
    Transforms::new(&clinical.optics.told_camera, entries).write(&out.join(sequence::TOLD_TRANSFORMS))?;
    let views = film.told_views.iter();
    let entries = views
        .map(|view| entry(sequence::novel_image_name(view.frame), &film.frames[view.frame], &view.world_from_camera))
        .collect();
    Transforms::new(&clinical.optics.told_camera, entries).write(&out.join(sequence::TOLD_NOVEL_TRANSFORMS))
}

/// The surfaces that methods are given: those of an import, or else the true ones; the second with a smooth error of
/// registration; and the centreline of the first. Says which.
fn write_surfaces(case: &Case, anatomy: &Anatomy, clinical: &ClinicalFilm, out: &Path) -> Result<String> {
    let (source, [rest, other], line) = match case.given_surfaces() {
        Some([inspiration, expiration]) => {
            let (rest, other) = (mesh_file::read(&inspiration)?, mesh_file::read(&expiration)?);
            if rest.faces != other.faces || rest.vertices.len() != other.vertices.len() {
                return Err(Error::input("has other faces than the surface at inspiration").at(expiration));
            }
            write_correspondence(&anatomy.inspiration, &rest, out)?;
            let line = extract(&rest, &CenterlineSettings::default()).map_err(|e| e.at(inspiration))?;
            ("import of simulated scans", [rest, other], line)
        }
        None => {
            let surfaces = [anatomy.inspiration.clone(), anatomy.expiration.clone()];
            ("true surfaces", surfaces, anatomy.centerline.clone())
        }
    };
    files::write_bytes(&out.join(sequence::TOLD_CENTERLINE), case_centerline::to_csv(&line).as_bytes())?;
    let error_mm = clinical.settings.surfaces.registration_error_mm;
    let (source, other) = if error_mm > 0.0 {
        (format!("{source}, smooth registration error"), misregister(&other, error_mm, case.seed))
    } else {
        (source.to_owned(), other)
    };
    let pair = [rest, other];
    let names = [sequence::TOLD_INSPIRATION, sequence::TOLD_EXPIRATION];
    for (name, surface) in names.iter().zip(&pair) {
        mesh_file::write_ply(&out.join(name), surface, &["units mm", "space LPS", "normals point into the lumen"])?;
    }
    Ok(source)
}

/// Where each vertex of `truth` lies on `given`: the nearest place at inspiration. A row's surface of those faces is then
/// scored like one of the true faces.
fn write_correspondence(truth: &TriangleMesh, given: &TriangleMesh, out: &Path) -> Result<()> {
    given.validate()?;
    let surface = SurfaceDistance::new(given);
    let places: Vec<(u32, [f64; 3])> = truth.vertices.par_iter().map(|v| surface.nearest_place(*v)).collect();
    let mut text = "vertex,face,b0,b1,b2\n".to_owned();
    for (vertex, (face, [a, b, c])) in places.iter().enumerate() {
        text += &format!("{vertex},{face},{a},{b},{c}\n");
    }
    files::write_bytes(&out.join(sequence::TOLD_CORRESPONDENCE), text.as_bytes())
}

/// What a frame's pictures say.
fn shares(out: &Path, frame: usize) -> Result<PictureShares> {
    let image = png::read_rgb(&out.join(sequence::image_name(frame)))?;
    let covered = png::read_rgb(&out.join(sequence::covered_name(frame)))?;
    let clipped = image.data.chunks_exact(3).filter(|pixel| pixel.iter().any(|&v| v >= CLIPPED)).count();
    let hidden: f64 = covered.data.iter().map(|&v| f64::from(v) / 255.0).sum();
    let pixels = (image.width * image.height) as f64;
    Ok(PictureShares {
        clipped_pct: 100.0 * clipped as f64 / pixels,
        covered_pct: 100.0 * hidden / covered.data.len().max(1) as f64,
    })
}
