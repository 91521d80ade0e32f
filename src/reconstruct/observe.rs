//! From a film to the inputs of a method (images, times, camera, poses, one CT; more only on request): the one
//! place where the truth is held back.

use glam::DAffine3;
use rayon::prelude::*;

use crate::base::{Error, Image, Result};
use crate::simulate::participant::Given;

use super::contract::{Access, Observation, PoseAccuracy};
use super::rough_poses::rough_poses;

/// Reads what `access` asks for, and nothing else, from a film or a participant's folder: the same of both.
///
/// Errors: those of reading; the true phase, where the truth is elsewhere.
pub fn observe(film: &dyn Given, access: Access, seed: u64) -> Result<Observation> {
    observe_frames(film, access, seed, film.given_frames().len())
}

/// [`observe`] with the first frame alone: what is known before a scope moves on.
///
/// Errors: as there.
pub fn observe_first(film: &dyn Given, access: Access, seed: u64) -> Result<Observation> {
    observe_frames(film, access, seed, 1)
}

/// The poses that a method is given of a film's frames.
pub fn given_poses(film: &dyn Given, access: Access, seed: u64) -> Vec<DAffine3> {
    let frames = film.given_frames();
    let poses: Vec<DAffine3> = frames.iter().map(|f| f.world_from_camera).collect();
    match access.poses {
        PoseAccuracy::True => poses,
        PoseAccuracy::Rough => {
            let time_s: Vec<f64> = frames.iter().map(|f| f.time_s).collect();
            rough_poses(&poses, &time_s, seed)
        }
    }
}

fn observe_frames(film: &dyn Given, access: Access, seed: u64, count: usize) -> Result<Observation> {
    let mut given = given_poses(film, access, seed);
    given.truncate(count);
    let mut frames = film.given_frames();
    frames.truncate(count);
    let images: Vec<Result<Image<u8>>> = (0..frames.len()).into_par_iter().map(|i| film.given_image(i)).collect();
    let poses: Vec<DAffine3> = frames.iter().map(|f| f.world_from_camera).collect();
    let time_s: Vec<f64> = frames.iter().map(|f| f.time_s).collect();
    // A second camera is known relative to the first: it is off by as much.
    let mut novel_pose = vec![None; frames.len()];
    for view in film.given_views().iter().filter(|view| view.frame < frames.len()) {
        novel_pose[view.frame] = Some(given[view.frame] * poses[view.frame].inverse() * view.world_from_camera);
    }
    let mut true_phase = if access.true_phase { film.true_phase() } else { None };
    if access.true_phase && true_phase.is_none() {
        return Err(Error::input("this method is told the true phase, which a participant's folder does not hold"));
    }
    true_phase.iter_mut().for_each(|phases| phases.truncate(count));
    let observation = Observation {
        camera: film.given_camera(),
        world_from_camera: given,
        poses_are_measured: film.given_poses_are_measured(),
        novel_pose,
        time_s,
        images: images.into_iter().collect::<Result<_>>()?,
        mask: film.given_mask()?,
        inspiration: film.given_inspiration()?,
        expiration: if access.expiration_mesh { Some(film.given_expiration()?) } else { None },
        centerline_mm: film.given_centerline_mm()?,
        breathing_period_s: film.given_period_s(),
        targets_mm: film.planned_targets_mm(),
        first_depth_mm: if access.first_depth { Some(film.first_depth_mm()?) } else { None },
        true_phase,
        seed,
    };
    observation.validate(access)?;
    Ok(observation)
}
