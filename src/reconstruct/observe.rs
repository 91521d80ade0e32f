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
    let observation = Observation {
        camera: sequence.camera,
        world_from_camera: match access.poses {
            PoseAccuracy::True => poses,
            PoseAccuracy::Rough => rough_poses(&poses, &time_s, seed),
        },
        time_s,
        images: images.into_iter().collect::<Result<_>>()?,
        mask: sequence.mask()?,
        inspiration: sequence.inspiration()?,
        expiration: if access.expiration_mesh { Some(sequence.registered_expiration()?) } else { None },
        first_depth_mm: if access.first_depth { Some(sequence.depth_mm(0)?) } else { None },
        true_phase: access.true_phase.then(|| frames.iter().map(|f| f.phase).collect()),
        seed,
    };
    observation.validate(access)?;
    Ok(observation)
}
