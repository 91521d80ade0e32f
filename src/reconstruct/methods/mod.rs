//! The methods, one file or folder each.

pub mod bridgesplat;
pub mod bridgesplat_nomesh;
pub mod ours;
pub mod ours_gn;
pub mod ours_nav;
pub mod ours_nomesh;
#[cfg(test)]
mod tests;
pub mod virtual_rows;
