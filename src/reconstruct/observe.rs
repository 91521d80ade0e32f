//! From a sequence to the inputs of a method (images, times, camera, poses, one CT; more only on request): the one
//! place where the truth is held back.

use glam::DAffine3;
use rayon::prelude::*;

use crate::base::{Image, Result};
use crate::simulate::sequence::Sequence;

use super::contract::{Access, Observation, PoseAccuracy};
use super::rough_poses::rough_poses;

/// Reads what `access` asks for, and nothing else.
pub fn observe(sequence: &Sequence, access: Access, seed: u64) -> Result<Observation> {
    let frames = &sequence.frames;
    let images: Vec<Result<Image<u8>>> = (0..frames.len()).into_par_iter().map(|i| sequence.image(i)).collect();
    let poses: Vec<DAffine3> = frames.iter().map(|f| f.world_from_camera).collect();
    let time_s: Vec<f64> = frames.iter().map(|f| f.time_s).collect();
    let given = match access.poses {
        PoseAccuracy::True => poses.clone(),
        PoseAccuracy::Rough => rough_poses(&poses, &time_s, seed),
    };
    // A second camera is known relative to the first: it is off by as much.
    let mut novel_pose = vec![None; frames.len()];
    for view in &sequence.novel_views {
        novel_pose[view.frame] = Some(given[view.frame] * poses[view.frame].inverse() * view.world_from_camera);
    }
    let observation = Observation {
        camera: sequence.camera,
        world_from_camera: given,
        novel_pose,
        time_s,
        images: images.into_iter().collect::<Result<_>>()?,
        mask: sequence.mask()?,
        inspiration: sequence.inspiration()?,
        expiration: if access.expiration_mesh { Some(sequence.registered_expiration()?) } else { None },
        centerline_mm: sequence.centerline()?.points.iter().map(|point| point.position_mm).collect(),
        breathing_period_s: sequence.breathing_period_s,
        targets_mm: sequence.targets.iter().map(|target| target.inspiration_mm).collect(),
        first_depth_mm: if access.first_depth { Some(sequence.depth_mm(0)?) } else { None },
        true_phase: access.true_phase.then(|| frames.iter().map(|f| f.phase).collect()),
        seed,
    };
    observation.validate(access)?;
    Ok(observation)
}
