//! `respire-bench import ct`: two CT scans, or what somebody else made of them, become a case.

use std::path::PathBuf;

use clap::Args;

use super::Terminal;
use super::import_case::{AIRWAY, CENTERLINE, CaseArguments, EXPIRATION, INSPIRATION, NewCase, case_head, name_of};
use super::import_file::FileArguments;
use super::import_motion::{MotionArguments, mended_words, still_breathing};
use crate::airway::case::AnatomySource;
use crate::airway::case_build::{AirwayAtRest, from_field, from_pair, mended_pair};
use crate::airway::import_breathing::{breathing_toml, moving};
use crate::airway::import_check::trachea_note;
use crate::airway::import_mesh::FileMeaning;
use crate::airway::{Anatomy, centerline::Centerline};
use crate::base::range::NumberRange;
use crate::base::{Error, Progress, Result, TriangleMesh};
use crate::ct::quality::{BreathHold, QualityPage};
use crate::ct::scan::read_checked;
use crate::ct::scan_pair::{Facts, ScanRequest, airway_of, check_mask, import_pair, surface_of};
use crate::ct::surface_pair::{PairFrames, register_surfaces};

/// Labels of a segmentation.
const LABEL: NumberRange = NumberRange::new(1.0, 65_535.0);
/// The quality page.
const PAGE: &str = "import.html";
/// Deepest generation that growing reaches in the lungs it was tried on.
const DEEPEST_GROWN: u32 = 6;
/// Distance in mm that is red on the page where two surfaces were registered.
const RED_MM: f64 = 2.0;

/// Arguments of `import ct`.
#[derive(Args)]
#[command(
    after_help = "Scans and masks: .nii, .nii.gz, .mha, .mhd, or a folder of DICOM slices (scans only). Writes DIR/<id>.toml \
    and DIR/<id>-import.html: look at that first.\nExamples:\n  respire-bench import ct insp.nii.gz exp.nii.gz \
    --airway-mask airway.nii.gz --id mine --out mine\n  respire-bench import ct --airway-mask airway.nii.gz --motion \
    copd05 --id mine --out mine\n  respire-bench import ct --meshes insp.ply exp.ply --axes ras --id mine --out mine"
)]
pub struct CtArguments {
    /// Scan at full inspiration
    #[arg(value_name = "INSPIRATION")]
    inspiration: Option<PathBuf>,
    /// Scan at full expiration
    #[arg(value_name = "EXPIRATION")]
    expiration: Option<PathBuf>,
    /// Label map of the airway at inspiration, and of that at expiration to compare with; grown from the scan without
    #[arg(long, value_name = "MASK", num_args = 1..=2)]
    airway_mask: Vec<PathBuf>,
    /// Label of the airway in a map with several
    #[arg(long, value_name = "N", value_parser = LABEL.parser::<u32>())]
    label: Option<u32>,
    /// Masks of the lungs in the scans; found by a threshold without
    #[arg(long, value_names = ["INSPIRATION", "EXPIRATION"], num_args = 1..=2, requires = "inspiration")]
    lung_masks: Vec<PathBuf>,
    /// Displacement field from inspiration to expiration instead of a registration (vectors in LPS and mm: ITK, elastix)
    #[arg(long, value_name = "FIELD", requires = "inspiration")]
    field: Option<PathBuf>,
    /// Two surfaces instead of scans: of the same faces, or any two, which are then registered
    #[arg(long, value_names = ["INSPIRATION", "EXPIRATION"], num_args = 2, conflicts_with_all = ["inspiration", "airway_mask"])]
    meshes: Vec<PathBuf>,
    /// The two surfaces lie in one frame, so that all of their difference is motion; without it a rigid part is taken for
    /// the patient's place on the table
    #[arg(long, requires = "meshes")]
    same_frame: bool,
    #[command(flatten)]
    file: FileArguments,
    #[command(flatten)]
    case: CaseArguments,
    #[command(flatten)]
    motion: MotionArguments,
}

/// An airway on its way to a case, and what the page shows.
struct Import {
    facts: Facts,
    residual_mm: Vec<f64>,
    red_mm: f64,
    residual_words: &'static str,
}

/// Runs the command.
pub fn run(arguments: &CtArguments, terminal: &Terminal) -> Result<()> {
    let has_motion = arguments.motion.is_given();
    if let Some(option) = arguments.file.only_for_surfaces().filter(|_| arguments.meshes.is_empty()) {
        return Err(Error::usage(format!(
            "{option} is for --meshes alone: scans and masks say in their headers where they lie, and of a mask the \
             largest part is taken"
        )));
    }
    arguments.motion.check_options()?;
    if arguments.label.is_some() && arguments.airway_mask.is_empty() {
        return Err(Error::usage("--label is of an --airway-mask"));
    }
    if has_motion && !arguments.lung_masks.is_empty() {
        return Err(Error::usage("--lung-masks are for a registration, and --motion and --landmarks need none"));
    }
    if let (None, None, [_, second]) = (&arguments.expiration, &arguments.field, &arguments.airway_mask[..]) {
        return Err(Error::usage(format!(
            "--airway-mask took {} as the mask at expiration: where that is a scan, name the scans first",
            second.display()
        )));
    }
    match (&arguments.inspiration, &arguments.meshes[..]) {
        (None, [first, second]) if !has_motion => of_meshes(arguments, first, second, terminal),
        (Some(_), []) if !has_motion && arguments.expiration.is_none() && arguments.field.is_none() => {
            Err(Error::usage("one scan has no motion: give the expiration, or --field, --landmarks, --motion"))
        }
        (Some(scan), []) if !has_motion => of_scans(arguments, scan, terminal),
        (_, []) if has_motion && arguments.expiration.is_none() && arguments.field.is_none() => {
            of_motion(arguments, terminal)
        }
        (_, _) if has_motion => Err(Error::usage(
            "two scans, a field and two meshes have their own motion: --motion and --landmarks do not go with them",
        )),
        _ => Err(Error::usage("give two scans, an --airway-mask with --motion, or --meshes")),
    }
}

fn of_scans(arguments: &CtArguments, inspiration: &std::path::Path, terminal: &Terminal) -> Result<()> {
    let (wanted, meaning) = (&arguments.case, arguments.file.meaning());
    let scans = 1 + usize::from(arguments.expiration.is_some());
    if !arguments.lung_masks.is_empty() && arguments.lung_masks.len() != scans {
        return Err(Error::usage("--lung-masks: as many as there are scans, in their order"));
    }
    let mut new = NewCase::new(wanted)?;
    let request = ScanRequest {
        inspiration,
        expiration: arguments.expiration.as_deref(),
        airway: arguments.airway_mask.first().map(PathBuf::as_path),
        airway_expiration: arguments.airway_mask.get(1).map(PathBuf::as_path),
        anatomy: meaning.anatomy,
        label: arguments.label.map(|label| label as u16),
        lungs: [0, 1].map(|scan| arguments.lung_masks.get(scan).map(PathBuf::as_path)),
        field: arguments.field.as_deref(),
        way_back: true,
    };
    terminal.stage("airway and registration");
    let pair = import_pair(&request, &new.workshop(), terminal)?;
    terminal.finish();
    let mut import = Import {
        facts: pair.facts,
        red_mm: pair.surface.voxel_mm.max_element(),
        residual_mm: pair.surface.residual_mm,
        residual_words: "Distance of the surface from the mask",
    };
    let rest = pair.surface.mesh;
    let second = arguments.expiration.as_deref().or(arguments.field.as_deref()).unwrap_or(inspiration);
    meaning.check_moves(&rest, &pair.expiration).map_err(|e| e.at(second))?;
    terminal.proceed()?;
    terminal.stage("centreline");
    let line =
        meaning.centerline_in_volume(&rest, terminal).map_err(|e| e.at(request.airway.unwrap_or(inspiration)))?;
    terminal.finish();
    if request.airway.is_none() {
        note_on_grown(&line, terminal);
    }
    let anatomy = paired(rest, pair.expiration, line, &mut import).map_err(|e| e.at(second))?;
    if let Some(note) = trachea_note(&anatomy.centerline, &anatomy.centerline_expiration) {
        terminal.note(&note);
    }
    terminal.proceed()?;
    let names = ["inspiration", "expiration"];
    let vertices = [&anatomy.inspiration.vertices, &anatomy.expiration.vertices];
    let holds: Vec<BreathHold<'_>> = pair
        .scans
        .iter()
        .enumerate()
        .map(|(k, scan)| BreathHold { name: names[k], scan, vertices: vertices[k] })
        .collect();
    new.text(PAGE, &import.page(&wanted.id, &anatomy, &holds, Some(&pair.change))?)?;
    for (name, text) in &pair.kept {
        new.text(name, text)?;
    }
    finish_pair(
        arguments,
        new,
        &anatomy,
        &import,
        format!("{} and {}", name_of(inspiration), name_of(second)),
        terminal,
    )
}

fn of_meshes(
    arguments: &CtArguments,
    first: &std::path::Path,
    second: &std::path::Path,
    terminal: &Terminal,
) -> Result<()> {
    let (wanted, meaning) = (&arguments.case, arguments.file.meaning());
    let mut new = NewCase::new(wanted)?;
    let (rest, other) = (meaning.read_surface(first)?, meaning.read_surface(second)?);
    terminal.stage("centreline");
    let line = meaning.centerline(&rest, terminal).map_err(|e| e.at(first))?;
    terminal.finish();
    terminal.proceed()?;
    let mut import = Import {
        facts: Facts::new(),
        residual_mm: vec![0.0; rest.vertices.len()],
        red_mm: RED_MM,
        residual_words: "Distance of the moved surface from the second one",
    };
    let moved = if rest.faces == other.faces && rest.vertices.len() == other.vertices.len() {
        meaning.check_pair(&rest, &other).map_err(|e| e.at(second))?;
        import.facts.push(("meshes", "of the same faces: taken as they are".to_owned()));
        other.vertices
    } else {
        let frames = if arguments.same_frame { PairFrames::Shared } else { PairFrames::Own };
        register(&meaning, [&rest, &other], frames, &mut import, terminal).map_err(|e| e.at(second))?
    };
    meaning.check_moves(&rest, &moved).map_err(|e| e.at(second))?;
    let anatomy = paired(rest, moved, line, &mut import)?;
    new.text(PAGE, &import.page(&wanted.id, &anatomy, &[], None)?)?;
    finish_pair(arguments, new, &anatomy, &import, format!("{} and {}", name_of(first), name_of(second)), terminal)
}

/// Says where an airway that was grown from a scan reaches deeper than growing does without leaking.
fn note_on_grown(line: &Centerline, terminal: &Terminal) {
    let deepest = line.points.iter().map(|point| point.generation).max().unwrap_or(0);
    if deepest > DEEPEST_GROWN {
        terminal.note(&format!(
            "the airway that was grown from the scan reaches generation {deepest}, and without a leak into the lung it \
             reaches {DEEPEST_GROWN} at most: look at the page; --airway-mask takes a segmentation"
        ));
    }
}

/// The first of two surfaces of other faces, moved onto the second.
fn register(
    meaning: &FileMeaning,
    [rest, other]: [&TriangleMesh; 2],
    frames: PairFrames,
    import: &mut Import,
    terminal: &Terminal,
) -> Result<Vec<glam::DVec3>> {
    // What lies wrong is said of the second as of the first.
    meaning.centerline(other, terminal)?;
    terminal.stage("registering the surfaces");
    let found = register_surfaces(rest, other, frames, terminal)?;
    terminal.finish();
    let facts = &mut import.facts;
    let place = match frames {
        PairFrames::Shared => "the same, as told".to_owned(),
        PairFrames::Own => format!(
            "{:.1} degrees and {:.1} mm apart, taken out: where both surfaces lie in one frame, motion is lost with it \
             (--same-frame)",
            found.turn_deg, found.shift_mm
        ),
    };
    facts.push(("place on the table", place));
    facts.push(("before registration", format!("{} from the second surface (median / 95 % / most)", found.before)));
    facts.push(("after registration", format!("{} (residual)", found.after)));
    facts.push(("motion", format!("{:.2} mm in the mean", found.motion_mm)));
    import.residual_mm = found.residual_mm;
    Ok(found.moved)
}

fn of_motion(arguments: &CtArguments, terminal: &Terminal) -> Result<()> {
    let (wanted, meaning) = (&arguments.case, arguments.file.meaning());
    let mut facts = Facts::new();
    let motion = arguments.motion.read(meaning.anatomy)?;
    let mask = arguments.airway_mask.first().map(PathBuf::as_path);
    let scan = arguments.inspiration.as_deref().map(|path| read_checked(path, terminal)).transpose()?;
    terminal.stage("the airway");
    let label = arguments.label.map(|label| label as u16);
    let airway = airway_of(mask, label, scan.as_ref(), meaning.anatomy, &mut facts, terminal)?;
    if let (Some(mask), Some(scan)) = (mask, &scan) {
        check_mask(&airway.mask, scan).map_err(|e| e.at(mask))?;
    }
    terminal.proceed()?;
    let surface = surface_of(&airway, &mut facts)?;
    terminal.finish();
    terminal.proceed()?;
    terminal.stage("centreline");
    let from = mask.or(arguments.inspiration.as_deref()).unwrap_or(std::path::Path::new(""));
    let line = meaning.centerline_in_volume(&surface.mesh, terminal).map_err(|e| e.at(from))?;
    terminal.finish();
    if mask.is_none() {
        note_on_grown(&line, terminal);
    }
    terminal.proceed()?;
    let title = format!("{} with the motion of {}", name_of(from), arguments.motion.name()?);
    let source = AnatomySource::Mesh { path: wanted.file(AIRWAY), centerline: Some(wanted.file(CENTERLINE)) };
    let mut case = wanted.case(title, source, Some(still_breathing()))?;
    let mut new = NewCase::new(wanted)?;
    new.mesh(AIRWAY, &surface.mesh)?;
    new.centerline(&line)?;
    let rest = from_field(surface.mesh, line, None, &still_breathing()).map_err(|e| e.at(from))?;
    let breathing = arguments.motion.fit(&rest, &case, &motion, terminal)?;
    facts.push(("motion", breathing.field.source.clone()));
    let mut import = Import {
        facts,
        red_mm: surface.voxel_mm.max_element(),
        residual_mm: surface.residual_mm,
        residual_words: "Distance of the surface from the mask",
    };
    let anatomy = moving(&AirwayAtRest::new(&rest.inspiration, &rest.centerline)?, &breathing)?;
    import.facts.push(("tree", tree_words(&anatomy.centerline)));
    let holds: Vec<BreathHold<'_>> = scan
        .iter()
        .map(|scan| BreathHold { name: "inspiration", scan, vertices: &anatomy.inspiration.vertices })
        .collect();
    new.text(PAGE, &import.page(&wanted.id, &anatomy, &holds, None)?)?;
    import.say(terminal);
    case.breathing = None;
    new.finish(&format!("{}\n{}", case_head(&case)?, breathing_toml(&breathing)), terminal)
}

/// Both states of a registered pair, faces that would turn over mended.
fn paired(rest: TriangleMesh, moved: Vec<glam::DVec3>, line: Centerline, import: &mut Import) -> Result<Anatomy> {
    let vertices = rest.vertices.len();
    let (expiration, mending) = mended_pair(&rest, moved)?;
    if mending.vertices > 0 {
        import.facts.push(("mended", mended_words(&mending, vertices)));
    }
    import.facts.push(("tree", tree_words(&line)));
    from_pair(rest, expiration, line)
}

fn finish_pair(
    arguments: &CtArguments,
    mut new: NewCase<'_>,
    anatomy: &Anatomy,
    import: &Import,
    title: String,
    terminal: &Terminal,
) -> Result<()> {
    let wanted = &arguments.case;
    let source = AnatomySource::MeshPair {
        inspiration: wanted.file(INSPIRATION),
        expiration: wanted.file(EXPIRATION),
        centerline: Some(wanted.file(CENTERLINE)),
    };
    let case = wanted.case(title, source, None)?;
    new.mesh(INSPIRATION, &anatomy.inspiration)?;
    new.mesh(EXPIRATION, &anatomy.expiration)?;
    new.centerline(&anatomy.centerline)?;
    import.say(terminal);
    new.finish(&case_head(&case)?, terminal)
}

/// How deep a tree goes.
fn tree_words(line: &Centerline) -> String {
    let branches = line.points.iter().map(|p| p.branch).max().map_or(0, |b| b + 1);
    let deepest = line.points.iter().map(|p| p.generation).max().unwrap_or(0);
    let counts: Vec<String> = (0..=deepest)
        .map(|generation| {
            let mut of: Vec<u32> =
                line.points.iter().filter(|p| p.generation == generation).map(|p| p.branch).collect();
            of.dedup();
            of.len().to_string()
        })
        .collect();
    format!("{branches} branches to generation {deepest} ({} of generations 0, 1, ..)", counts.join(", "))
}

impl Import {
    fn say(&self, terminal: &Terminal) {
        for (what, words) in &self.facts {
            terminal.note(&format!("{what}: {words}"));
        }
    }

    fn page(
        &self,
        case_id: &str,
        anatomy: &Anatomy,
        scans: &[BreathHold<'_>],
        change: Option<&crate::ct::motion_field::VolumeChange>,
    ) -> Result<String> {
        let page = QualityPage {
            case_id,
            facts: &self.facts,
            scans,
            anatomy,
            residual_mm: &self.residual_mm,
            red_mm: self.red_mm,
            residual_words: self.residual_words,
            change,
        };
        page.html()
    }
}
