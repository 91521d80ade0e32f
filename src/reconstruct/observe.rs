//! From a sequence to what a method may see of it: the one place where the truth is held back.

use crate::base::{Error, Result};
use crate::simulate::sequence::Sequence;

use super::{Access, Observation};

/// Reads what `access` asks for and nothing else. `seed` is that of the method's own randomness.
pub fn observe(sequence: &Sequence, access: Access, seed: u64) -> Result<Observation> {
    if sequence.frames.is_empty() {
        return Err(Error::input("the sequence has no frames").at(&sequence.root));
    }
    let frames = &sequence.frames;
    Ok(Observation {
        camera: sequence.camera,
        world_from_camera: frames.iter().map(|f| f.world_from_camera).collect(),
        time_s: frames.iter().map(|f| f.time_s).collect(),
        images: (0..frames.len()).map(|frame| sequence.image(frame)).collect::<Result<_>>()?,
        inspiration: sequence.inspiration()?,
        expiration: if access.expiration_mesh { Some(sequence.expiration()?) } else { None },
        first_depth_mm: if access.first_depth { Some(sequence.depth_mm(0)?) } else { None },
        true_phase: access.true_phase.then(|| frames.iter().map(|f| f.phase).collect()),
        seed,
    })
}
