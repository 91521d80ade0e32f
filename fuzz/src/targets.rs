//! What is fuzzed: every reader of a file that people or programs outside may have written, as a function on bytes.
//!
//! A target must come back quickly with a value that keeps its promises or with an error that is one sentence and
//! exit code 4 or 2; it must not panic, ask for memory out of proportion, or hang. `src/main.rs` gives these functions
//! to libFuzzer; `tests/all/readers.rs` of the main crate replays the corpus through them and mutates for some seconds.

use std::fmt::Debug;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use respire_bench::airway::case::Case;
use respire_bench::airway::import_axes::PatientAxes;
use respire_bench::airway::import_breathing::LungBox;
use respire_bench::airway::import_check::ExpectedAnatomy;
use respire_bench::airway::import_mesh::{FileMeaning, PartChoice};
use respire_bench::airway::import_tree;
use respire_bench::airway::target::Target as AirwayTarget;
use respire_bench::airway::{case_build, case_centerline};
use respire_bench::base::pose::rotation_error;
use respire_bench::base::random::CounterRng;
use respire_bench::base::{Camera, Image, Mask, Result, TriangleMesh, files, hash};
use respire_bench::bench::claim::Claims;
use respire_bench::bench::live_poses::LivePoses;
use respire_bench::bench::store::{MARKER, ProductState, Scrutiny, Store};
use respire_bench::bench::{Ablations, Profile, timing};
use respire_bench::experiments::ct_loop::result::LoopResult;
use respire_bench::experiments::ct_loop::tables;
use respire_bench::formats::http::{self, HttpStatus};
use respire_bench::formats::transforms::Transforms;
use respire_bench::formats::{depth_png, exr, gaussians_ply, landmarks, mesh, nifti, npy, png, volume};
use respire_bench::reconstruct::MethodFile;
use respire_bench::render::scene_file::SceneFile;
use respire_bench::report::scene::{FilmScene, Scenes};
use respire_bench::report::{compare, gate, merge, read, read_back, summary, table};
use respire_bench::score::{CellScore, Prediction, Question, Truth};
use respire_bench::simulate::participant::{Given, Participant};
use respire_bench::simulate::sequence::{self, FrameRecord, NovelView, Sequence};

/// Between the files of an input that is a folder (the group separator of ASCII).
pub const SEPARATOR: u8 = 0x1d;

/// A reader.
pub struct Target {
    /// Name, also of its folder in the corpus.
    pub name: &'static str,
    /// Reads the bytes and checks the answer.
    pub run: fn(&[u8], &Scratch),
}

/// Every reader.
pub const TARGETS: &[Target] = &[
    Target { name: "ablations", run: ablations },
    Target { name: "case", run: case },
    Target { name: "centerline", run: centerline },
    Target { name: "clinical", run: clinical },
    Target { name: "depth_png", run: read_depth_png },
    Target { name: "dicom", run: dicom },
    Target { name: "environments", run: environments },
    Target { name: "exr", run: read_exr },
    Target { name: "gate", run: thresholds },
    Target { name: "gaussians", run: gaussians },
    Target { name: "http", run: http_request },
    Target { name: "landmarks", run: read_landmarks },
    Target { name: "live_poses", run: live_poses },
    Target { name: "loop_result", run: loop_result },
    Target { name: "lung_box", run: lung_box },
    Target { name: "marker", run: marker },
    Target { name: "merge", run: merged },
    Target { name: "metaimage", run: |bytes, scratch| read_volume(bytes, "volume.mha", scratch) },
    Target { name: "method", run: method },
    Target { name: "nifti", run: |bytes, scratch| read_volume(bytes, "volume.nii", scratch) },
    Target { name: "npy", run: read_npy },
    Target { name: "obj", run: |bytes, scratch| surface(bytes, "obj", scratch) },
    Target { name: "participant", run: participant },
    Target { name: "ply", run: |bytes, scratch| surface(bytes, "ply", scratch) },
    Target { name: "png", run: read_png },
    Target { name: "prediction", run: prediction },
    Target { name: "profile", run: profile },
    Target { name: "results", run: results },
    Target { name: "scene", run: scene },
    Target { name: "scenes", run: scenes },
    Target { name: "score", run: score },
    Target { name: "sequence", run: read_sequence },
    Target { name: "stl", run: |bytes, scratch| surface(bytes, "stl", scratch) },
    Target { name: "timings", run: timings },
    Target { name: "transforms", run: transforms },
    Target { name: "tree", run: tree },
    Target { name: "tree_table", run: tree_table },
];

/// Folders in memory for readers that take a path.
pub struct Scratch {
    folder: PathBuf,
    bench_cases: PathBuf,
}

impl Scratch {
    /// Makes a folder of this `name`; `root` is the root of the repository.
    pub fn new(root: &Path, name: &str) -> std::io::Result<Scratch> {
        let memory = Path::new("/dev/shm");
        let parent = if memory.is_dir() { memory.to_path_buf() } else { std::env::temp_dir() };
        let folder = parent.join(format!("respire-bench-{name}-{}", std::process::id()));
        let bench_cases = root.join("bench-cases");
        let parts =
            ["clinical/told", "dicom", "methods", "participant", "prediction/color", "prediction/mesh", "sequence"];
        for part in parts {
            std::fs::create_dir_all(folder.join(part))?;
        }
        for entry in std::fs::read_dir(bench_cases.join("methods"))? {
            let entry = entry?;
            std::fs::copy(entry.path(), folder.join("methods").join(entry.file_name()))?;
        }
        for frame in 0..PREDICTED_FRAMES {
            std::fs::write(folder.join(format!("prediction/color/{frame:06}.png")), "")?;
        }
        std::fs::write(folder.join("present"), "")?;
        Ok(Scratch { folder, bench_cases })
    }

    fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.folder.join(name);
        std::fs::write(&path, bytes).expect("the scratch folder takes files");
        path
    }

    /// Writes the parts of an input as files of these names; an empty part is no file.
    fn write_parts(&self, folder: &str, names: &[&str], bytes: &[u8]) -> PathBuf {
        let mut parts = bytes.splitn(names.len(), |&b| b == SEPARATOR);
        for name in names {
            let name = format!("{folder}/{name}");
            match parts.next().unwrap_or(&[]) {
                [] => drop(std::fs::remove_file(self.folder.join(name))),
                part => drop(self.write(&name, part)),
            }
        }
        self.folder.join(folder)
    }

    /// Lists the files `names` with their hashes in the JSON `manifest` of `folder`, where that has an empty table of
    /// files: a changed file then meets its reader, and not the comparison of hashes alone.
    fn seal(&self, folder: &str, manifest: &str, names: &[&str]) {
        let path = self.folder.join(folder).join(manifest);
        let Ok(mut head) = files::read_json::<serde_json::Value>(&path) else { return };
        let Some(table) = head.get_mut("files").and_then(|files| files.as_object_mut()) else { return };
        if !table.is_empty() {
            return;
        }
        for name in names {
            if let Ok(hash) = hash::of_file(&self.folder.join(folder).join(name)) {
                table.insert((*name).to_owned(), hash.into());
            }
        }
        std::fs::write(path, head.to_string()).expect("the scratch folder takes files");
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Frames of the sequence that predictions are opened for.
const PREDICTED_FRAMES: usize = 3;

/// The value, or nothing after an error that is one readable sentence and says that the input is at fault.
fn answer<T>(outcome: Result<T>) -> Option<T> {
    let error = match outcome {
        Ok(value) => return Some(value),
        Err(error) => error,
    };
    let sentence = error.to_string();
    assert!(!sentence.is_empty() && sentence.len() < 10_000, "an error of {} characters", sentence.len());
    assert!(!sentence.chars().any(char::is_control), "more than a line: {sentence:?}");
    assert!(matches!(error.kind().exit_code(), 2 | 4), "exit {}: {sentence}", error.kind().exit_code());
    None
}

/// The value that was read and written must be the value that is read again.
fn same<T: PartialEq + Debug>(again: Option<T>, first: &T) {
    assert!(again.as_ref() == Some(first), "read {first:?}, wrote it, and read {again:?}");
}

fn assert_shape<T>(image: &Image<T>) {
    assert_eq!(image.data.len(), image.width * image.height * image.channels);
}

fn bits(image: &Image<f32>) -> Vec<u32> {
    image.data.iter().map(|v| v.to_bits()).collect()
}

fn case(bytes: &[u8], scratch: &Scratch) {
    let path = scratch.write("case.toml", bytes);
    let Some(case) = answer(Case::load(&path)) else { return };
    let write = |case: &Case| toml::to_string(case).expect("a case can be written");
    let text = write(&case);
    same(answer(Case::load(&scratch.write("case.toml", text.as_bytes()))).map(|again| write(&again)), &text);
    answer(respire_bench::simulate::material(&case));
    for time_s in [0.0, 0.3, 60.0] {
        assert!((0.0..=1.0).contains(&case.waveform.phase(time_s, 1)));
    }
}

fn method(bytes: &[u8], scratch: &Scratch) {
    let path = scratch.write("methods/fuzzed.toml", bytes);
    if let Some(file) = answer(MethodFile::load(&path)) {
        answer(file.method(0.25));
    }
}

fn profile(bytes: &[u8], scratch: &Scratch) {
    let path = scratch.write("profile.toml", bytes);
    if let Some(profile) = answer(Profile::load(&scratch.folder, &path.to_string_lossy())) {
        assert!(profile.frames(4.0) >= profile.minimum_frames);
    }
}

const RESULTS: &str = "run_id,case_id,case_hash,config,seed,split,metric,definition,unit,direction,alignment,mask,value,sd,n,ci_low,ci_high,status,detail\n\
    smoke-89108fe7,case1,f81d6e,ours,1,online,psnr_db,psnr_db/1,dB,higher,,none,24.8,5.2,400,23.9,25.7,ok,\n\
    smoke-89108fe7,case2,f81d6e,ours,1,online,psnr_db,psnr_db/1,dB,higher,,none,23.8,5.2,400,23.9,25.7,ok,\n";

fn known_results(scratch: &Scratch) -> read::Results {
    let folder = scratch.folder.join("known");
    if !folder.exists() {
        std::fs::create_dir_all(&folder).expect("the scratch folder takes folders");
        std::fs::write(folder.join("results.csv"), RESULTS).expect("the scratch folder takes files");
    }
    read::read(&folder).expect("these results are fine")
}

fn thresholds(bytes: &[u8], scratch: &Scratch) {
    let path = scratch.write("gate.toml", bytes);
    if let Some(thresholds) = answer(gate::read_thresholds(&path)) {
        let known = known_results(scratch);
        gate::judge(&known, &thresholds, Some(&known));
    }
}

fn results(bytes: &[u8], scratch: &Scratch) {
    std::fs::create_dir_all(scratch.folder.join("results")).expect("the scratch folder takes folders");
    let folder = scratch.write_parts("results", &["results.csv", "comparison.csv"], bytes);
    let Some(results) = answer(read::read(&folder)) else { return };
    let thresholds = gate::read_thresholds(&scratch.bench_cases.join("gate.toml")).expect("the shipped file is fine");
    let known = known_results(scratch);
    gate::judge(&results, &thresholds, Some(&known));
    compare::compare(&known, &results);
}

fn merged(bytes: &[u8], scratch: &Scratch) {
    std::fs::create_dir_all(scratch.folder.join("merge")).expect("the scratch folder takes folders");
    let names = ["results.csv", "comparison.csv", "frames.csv", "timings.csv", "manifest.json"];
    let folder = scratch.write_parts("merge", &names, bytes);
    scratch.seal("merge", "manifest.json", &names[..4]);
    answer(read_back::read_run(&folder, read_back::PartEvidence::Needed));
    let Some(run) = answer(read_back::read_run(&folder, read_back::PartEvidence::Waived)) else { return };
    let part = merge::Part { folder, run };
    for films in [merge::Films::Same, merge::Films::Other] {
        if let Some(run) = answer(merge::merge(vec![part.clone(), part.clone()], films)) {
            table::ComparisonTable::all(run.track, &summary::summarise(&run));
        }
    }
}

fn scenes(bytes: &[u8], scratch: &Scratch) {
    std::fs::create_dir_all(scratch.folder.join("scenes")).expect("the scratch folder takes folders");
    scratch.write("scenes/scenes.json", bytes);
    let Some(scenes) = answer(Scenes::read(&scratch.folder.join("scenes"))) else { return };
    let small = scenes.with_small_airways(4).thinned(1000);
    for (film, before) in small.films.iter().zip(&scenes.films) {
        let vertices = |film: &FilmScene| film.airway.as_ref().map_or(0, |airway| airway.vertices());
        assert!(vertices(film) <= vertices(before));
    }
}

fn ablations(bytes: &[u8], scratch: &Scratch) {
    let path = scratch.write("ablations.toml", bytes);
    let Some(ablations) = answer(Ablations::load(&path, None)) else { return };
    for variant in ablations.ablation.iter().take(3) {
        answer(variant.method_file(&scratch.folder.join("methods")));
        answer(Case::load_changed(&scratch.bench_cases.join("case1.toml"), &variant.case));
    }
}

fn scene(bytes: &[u8], scratch: &Scratch) {
    let path = scratch.write("scene.toml", bytes);
    if let Some(scene) = answer(SceneFile::load(&path)) {
        scene.settings();
    }
}

fn surface(bytes: &[u8], extension: &str, scratch: &Scratch) {
    let Some(surface) = answer(mesh::parse(bytes, extension)) else { return };
    surface.validate().expect("a mesh that was read is valid");
    answer(surface.validate_closed());
    if bytes.len() < 1000 {
        let path = scratch.folder.join("again.ply");
        mesh::write_ply(&path, &surface, &[]).expect("the scratch folder takes files");
        same::<TriangleMesh>(answer(mesh::read(&path)), &surface);
    }
}

fn gaussians(bytes: &[u8], _: &Scratch) {
    let Some(cloud) = answer(gaussians_ply::parse(bytes)) else { return };
    let n = cloud.len();
    assert!(n <= cloud.count_in_file && cloud.sh_degree <= 3);
    assert_eq!([cloud.rotations.len(), cloud.scales.len(), cloud.opacities.len(), cloud.index.len()], [n; 4]);
    assert_eq!(cloud.sh.len(), n * 3 * (cloud.sh_degree as usize + 1).pow(2));
    let numbers = cloud.positions.as_flattened().iter().chain(cloud.scales.as_flattened());
    assert!(numbers.chain(cloud.rotations.as_flattened()).chain(&cloud.sh).all(|v| v.is_finite()));
    assert!(cloud.opacities.iter().all(|o| (0.0..=1.0).contains(o)));
}

fn transforms(bytes: &[u8], _: &Scratch) {
    let Some(transforms) = answer(Transforms::parse(bytes)) else { return };
    let text = serde_json::to_vec(&transforms).expect("transforms can be written");
    same(answer(Transforms::parse(&text)), &transforms);
}

fn read_exr(bytes: &[u8], scratch: &Scratch) {
    let Some(image) = answer(exr::decode(bytes)) else { return };
    assert_shape(&image);
    if image.data.len() < 1000 && !image.data.is_empty() {
        let path = scratch.folder.join("again.exr");
        let names: &[&str] = if image.channels == 3 { &["R", "G", "B"] } else { &["Z"] };
        exr::write(&path, &image, names).expect("the scratch folder takes files");
        same(answer(exr::read(&path)).map(|again| bits(&again)), &bits(&image));
    }
}

fn read_png(bytes: &[u8], scratch: &Scratch) {
    let Some(image) = answer(png::decode(bytes)) else { return };
    assert_shape(&image);
    if image.data.len() < 1000 {
        let path = scratch.folder.join("again.png");
        png::write_rgb(&path, &image).expect("the scratch folder takes files");
        same(answer(png::read_rgb(&path)), &image);
    }
}

/// A volume in each of its meanings: scan, label map, displacement field.
fn read_volume(bytes: &[u8], name: &str, scratch: &Scratch) {
    let path = scratch.write(name, bytes);
    if let Some(scan) = answer(volume::read_scan(&path)) {
        assert_eq!(scan.data.len(), scan.grid.count());
        let again = scratch.folder.join("again.nii.gz");
        if scan.data.len() < 1000 {
            nifti::write(&again, &scan).expect("the scratch folder takes files");
            same(answer(volume::read_scan(&again)).map(|read| read.data), &scan.data);
        }
    }
    if let Some(labels) = answer(volume::read_labels(&path)) {
        assert_eq!(labels.data.len(), labels.grid.count());
    }
    if let Some(field) = answer(volume::read_field(&path)) {
        assert!(field.data.iter().flatten().all(|v| v.is_finite()));
    }
}

fn read_depth_png(bytes: &[u8], _: &Scratch) {
    if let Some(image) = answer(depth_png::decode(bytes, 0.01)) {
        assert_shape(&image);
    }
}

fn read_npy(bytes: &[u8], scratch: &Scratch) {
    let Some(array) = answer(npy::decode(bytes)) else { return };
    assert_eq!(array.shape.iter().product::<usize>(), array.data.len());
    if array.data.len() < 1000 {
        let path = scratch.folder.join("again.npy");
        npy::write(&path, &array.shape, &array.data).expect("the scratch folder takes files");
        let again = answer(npy::read(&path)).expect("what was written is read");
        let bits = |data: &[f32]| data.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!((&again.shape, bits(&again.data)), (&array.shape, bits(&array.data)));
    }
    if let Some(plane) = answer(npy::plane(array)) {
        assert_shape(&plane);
    }
}

fn loop_result(bytes: &[u8], scratch: &Scratch) {
    let Some(result) = answer(LoopResult::read(&scratch.write("ct-loop.json", bytes))) else { return };
    let results = [result.clone(), result];
    assert!(tables::records(&results).iter().all(|row| row.len() == tables::COLUMNS.len()));
    tables::markdown(&results);
}

fn read_landmarks(bytes: &[u8], _: &Scratch) {
    if let Some(pairs) = answer(landmarks::parse(bytes)) {
        LungBox::around(&pairs);
    }
}

fn lung_box(bytes: &[u8], scratch: &Scratch) {
    answer(LungBox::read(&scratch.write("boxes.csv", bytes), "copd01"));
}

fn centerline(bytes: &[u8], scratch: &Scratch) {
    let Some(line) = answer(case_centerline::read(&scratch.write("centerline.csv", bytes))) else { return };
    let text = case_centerline::to_csv(&line);
    same(answer(case_centerline::parse(&text)), &line);
}

fn tree(bytes: &[u8], scratch: &Scratch) {
    let Some(tree) = answer(case_build::read_tree(&scratch.write("tree.toml", bytes))) else { return };
    let reachable = tree.reachable(1.1, 9);
    if !reachable.branches.is_empty() && answer(reachable.validate()).is_some() {
        reachable.to_centerline();
    }
}

/// A finish marker of a product, and a claim of a folder: what stands there is whole, damaged or held, and no more.
fn marker(bytes: &[u8], scratch: &Scratch) {
    let folder = scratch.folder.join("claimed");
    std::fs::create_dir_all(folder.join(".claim")).expect("the scratch folder takes folders");
    scratch.write(&format!("claimed/{MARKER}"), bytes);
    let state = Store::look(&scratch.folder).state("claimed", "key", Scrutiny::Content).unwrap();
    assert!(state != ProductState::Whole && state != ProductState::Absent);
    scratch.write("claimed/.claim/holder.json", bytes);
    answer(Claims::default().ask(&folder, &[]));
}

fn read_sequence(bytes: &[u8], scratch: &Scratch) {
    let names = [
        sequence::MANIFEST,
        sequence::TRANSFORMS,
        sequence::CENTERLINE,
        sequence::NOVEL_TRANSFORMS,
        sequence::TARGETS,
        sequence::TARGETS_EXPIRATION,
    ];
    let folder = scratch.write_parts("sequence", &names, bytes);
    scratch.seal("sequence", sequence::MANIFEST, &names[1..]);
    if let Some(sequence) = answer(Sequence::open(&folder)) {
        assert!(!sequence.frames.is_empty());
        answer(sequence.centerline());
        answer(sequence.image(0));
    }
}

/// A film of the clinical track: what is told, and where the targets are at every frame.
fn clinical(bytes: &[u8], scratch: &Scratch) {
    let names = [
        sequence::MANIFEST,
        sequence::TRANSFORMS,
        sequence::NOVEL_TRANSFORMS,
        sequence::TARGETS,
        sequence::TARGETS_EXPIRATION,
        sequence::TOLD_TRANSFORMS,
        sequence::TOLD_NOVEL_TRANSFORMS,
        sequence::TARGETS_BY_FRAME,
        sequence::TOLD_CORRESPONDENCE,
    ];
    let folder = scratch.write_parts("clinical", &names, bytes);
    scratch.seal("clinical", sequence::MANIFEST, &names[1..]);
    let Some(film) = answer(Sequence::open(&folder)) else { return };
    let frames = film.frames.len();
    assert!(film.given_frames().len() == frames && film.given_views().len() == film.novel_views.len());
    assert!(film.given_frames().windows(2).all(|pair| pair[0].time_s < pair[1].time_s));
    for (frame, index) in (0..frames).flat_map(|frame| (0..film.targets.len()).map(move |index| (frame, index))) {
        assert!(film.target_mm(index, frame).abs().max_element() <= 1e4);
    }
    answer(film.told_correspondence());
    answer(film.last_surface());
}

/// A folder of slices.
fn dicom(bytes: &[u8], scratch: &Scratch) {
    let folder = scratch.write_parts("dicom", &["a", "b", "c.dcm"], bytes);
    if let Some(scan) = answer(volume::read_scan(&folder)) {
        assert_eq!(scan.data.len(), scan.grid.count());
        answer(scan.grid.validate(2.0)).expect("a grid that was read is one");
    }
}

fn environments(bytes: &[u8], scratch: &Scratch) {
    std::fs::create_dir_all(scratch.folder.join("environments")).expect("the scratch folder takes folders");
    let folder = scratch.write_parts("environments", &["environment.json", "environments.json"], bytes);
    answer(read_back::read_environments(&folder, "run"));
}

/// The lines of `track --poses`.
fn live_poses(bytes: &[u8], _: &Scratch) {
    let (mut poses, mut last_s) = (LivePoses::new(bytes, Path::new("poses")), -1.0);
    while let Some((time_s, pose)) = answer(poses.next_pose()).flatten() {
        assert!(time_s > last_s && time_s <= 1e7 && rotation_error(&pose) < 0.01);
        assert!(pose.translation.abs().max_element() <= 1e4);
        last_s = time_s;
    }
}

fn http_request(bytes: &[u8], _: &Scratch) {
    match http::read_request(bytes) {
        Ok(Some(request)) => assert!(request.path.starts_with('/') && !request.host.contains(['\r', '\n'])),
        Ok(None) => assert!(bytes.len() < http::MOST_HEAD_BYTES),
        Err(status) => assert!(status != HttpStatus::Ok),
    }
}

fn participant(bytes: &[u8], scratch: &Scratch) {
    let names = [
        sequence::PARTICIPANT,
        sequence::TRANSFORMS,
        sequence::NOVEL_TRANSFORMS,
        sequence::TARGETS,
        sequence::CENTERLINE,
    ];
    let folder = scratch.write_parts("participant", &names, bytes);
    scratch.seal("participant", sequence::PARTICIPANT, &names[1..]);
    if let Some(participant) = answer(Participant::open(&folder)) {
        assert!(!participant.given_frames().is_empty() && participant.true_phase().is_none());
        answer(participant.given_centerline_mm());
        answer(participant.check());
    }
}

/// A film of which a prediction's folder needs to know the number of frames alone.
struct TinyTruth {
    camera: Camera,
    frames: Vec<FrameRecord>,
    novel_views: Vec<NovelView>,
    targets: Vec<AirwayTarget>,
}

impl TinyTruth {
    fn new() -> Self {
        let frame = |frame: usize| FrameRecord {
            time_s: frame as f64,
            phase: 0.5,
            gain: 1.0,
            white_balance: [1.0; 3],
            world_from_camera: DAffine3::IDENTITY,
        };
        TinyTruth {
            camera: Camera::pinhole(8, 8, 1.0),
            frames: (0..PREDICTED_FRAMES).map(frame).collect(),
            novel_views: vec![NovelView { frame: 1, world_from_camera: DAffine3::IDENTITY }],
            targets: vec![AirwayTarget { inspiration_mm: DVec3::ZERO, expiration_mm: DVec3::X }; 2],
        }
    }
}

impl Truth for TinyTruth {
    fn case_id(&self) -> &str {
        "case1"
    }

    fn hash(&self) -> &str {
        "0"
    }

    fn content(&self) -> &str {
        "0"
    }

    fn file_paths(&self) -> Vec<PathBuf> {
        Vec::new()
    }

    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn frames(&self) -> &[FrameRecord] {
        &self.frames
    }

    fn image(&self, _frame: usize) -> Result<Image<u8>> {
        Ok(Image::filled(8, 8, 3, 0))
    }

    fn depth_mm(&self, _frame: usize) -> Result<Image<f32>> {
        Ok(Image::filled(8, 8, 1, 1.0))
    }

    fn novel_views(&self) -> &[NovelView] {
        &self.novel_views
    }

    fn novel_image(&self, frame: usize) -> Result<Image<u8>> {
        self.image(frame)
    }

    fn novel_depth_mm(&self, frame: usize) -> Result<Image<f32>> {
        self.depth_mm(frame)
    }

    fn targets(&self) -> &[AirwayTarget] {
        &self.targets
    }

    fn mask(&self) -> Result<Option<Mask>> {
        Ok(None)
    }

    fn inspiration(&self) -> Result<TriangleMesh> {
        Ok(TriangleMesh::default())
    }

    fn expiration(&self) -> Result<TriangleMesh> {
        Ok(TriangleMesh::default())
    }
}

fn prediction(bytes: &[u8], scratch: &Scratch) {
    let names = [
        "phase.csv",
        "poses.csv",
        "timing.json",
        "prediction.json",
        "targets.csv",
        "mesh/final.ply",
        "correspondence.csv",
    ];
    let folder = scratch.write_parts("prediction", &names, bytes);
    let Some(prediction) = answer(Prediction::open(&folder, &Question::of(&TinyTruth::new()))) else { return };
    assert!(prediction.phase().is_none_or(|phases| phases.len() == PREDICTED_FRAMES));
    assert!(prediction.poses().is_none_or(|poses| poses.len() == PREDICTED_FRAMES));
    assert!(prediction.phase_sd().is_none_or(|sds| sds.len() == PREDICTED_FRAMES && sds.iter().all(|&sd| sd > 0.0)));
    assert!(prediction.time_total_s().is_none_or(|time| time > 0.0));
    if let Some(places) = answer(prediction.correspondence()).flatten() {
        assert!(places.iter().all(|place| place.is_finite()));
    }
}

fn timings(bytes: &[u8], scratch: &Scratch) {
    answer(timing::read(&scratch.write("timings.json", bytes)));
}

fn score(bytes: &[u8], scratch: &Scratch) {
    answer(files::read_json::<CellScore>(&scratch.write("score.json", bytes)));
}

/// Words that readers trip over: ends of ranges, numbers that are none, what other formats begin with.
const WORDS: &[&str] = &[
    "0",
    "-0",
    "1",
    "-1",
    "2",
    "7",
    "255",
    "256",
    "65535",
    "65536",
    "2147483647",
    "2147483648",
    "-2147483648",
    "4294967294",
    "4294967295",
    "4294967296",
    "9007199254740993",
    "9223372036854775807",
    "-9223372036854775808",
    "18446744073709551615",
    "1e-300",
    "1e-9",
    "1e9",
    "1e18",
    "1e39",
    "1e300",
    "1e309",
    "-1e300",
    "nan",
    "inf",
    "-inf",
    "0x10",
    "1_000",
    "true",
    "false",
    "\"\"",
    "\"../x\"",
    "[]",
    "{}",
    "null",
    ",",
    "\n",
    "\r\n",
    "\u{feff}",
    "\u{e9}",
];

/// A changed copy of `input`: up to four edits that know of bytes, words of digits, lines, and of `other` inputs.
pub fn mutate(input: &[u8], other: &[u8], most_bytes: usize, rng: &mut CounterRng) -> Vec<u8> {
    let mut bytes = input.to_vec();
    for _ in 0..=rng.index(4) {
        edit(&mut bytes, other, rng);
    }
    bytes.truncate(most_bytes);
    bytes
}

fn edit(bytes: &mut Vec<u8>, other: &[u8], rng: &mut CounterRng) {
    let at = rng.index(bytes.len() + 1);
    match rng.index(10) {
        0 if at < bytes.len() => bytes[at] ^= 1 << rng.index(8),
        1 if at < bytes.len() => bytes[at] = [0, 1, 0x7f, 0x80, 0xff, b'0', b'-', b'\n', b','][rng.index(9)],
        2 => bytes.truncate(at),
        3 => {
            let end = (at + rng.index(16)).min(bytes.len());
            bytes.drain(at..end);
        }
        4 => {
            // A piece once more.
            let end = (at + rng.index(64)).min(bytes.len());
            let piece = bytes[at..end].to_vec();
            let to = rng.index(bytes.len() + 1);
            bytes.splice(to..to, piece);
        }
        5 if !other.is_empty() => {
            let from = rng.index(other.len());
            let end = (from + rng.index(256)).min(other.len());
            bytes.splice(at..at, other[from..end].iter().copied());
        }
        6 => {
            // A line less.
            let start = bytes[..at].iter().rposition(|&b| b == b'\n').map_or(0, |k| k + 1);
            let end = bytes[at..].iter().position(|&b| b == b'\n').map_or(bytes.len(), |k| at + k + 1);
            bytes.drain(start..end);
        }
        // A number becomes another.
        _ => {
            let is_part = |b: &u8| b.is_ascii_digit() || b"+-.eE".contains(b);
            let Some(start) = bytes[at..].iter().position(|b| b.is_ascii_digit()).map(|k| at + k) else { return };
            let start = start - bytes[..start].iter().rev().take_while(|b| is_part(b)).count();
            let end = start + bytes[start..].iter().take_while(|b| is_part(b)).count();
            let word = WORDS[rng.index(WORDS.len())];
            bytes.splice(start..end, word.bytes());
        }
    }
}

fn tree_table(bytes: &[u8], scratch: &Scratch) {
    let path = scratch.write("tree.csv", bytes);
    let (axes, parts, anatomy) = (PatientAxes::RAS, PartChoice::Single, ExpectedAnatomy::Any);
    if let Some(tree) =
        answer(import_tree::from_table(&path, &FileMeaning { axes, scale: 1.0, parts, anatomy }, "fuzz"))
    {
        tree.validate().expect("a tree that was read is valid");
    }
}
