//! `ours-nav`: live navigation where nothing that is told is exact (`docs/navigation.md`). One state of knowledge
//! ([`NavigationState`](crate::reconstruct::estimate::navigation::NavigationState)) takes in each told pose and each
//! picture; targets are stated in the camera's axes with a covariance of all that is unknown. It has no map: pictures are
//! compared with the CT's wall under the scope's lamp.

mod method;
mod tracker;

pub use method::OursNav;
