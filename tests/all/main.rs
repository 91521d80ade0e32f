//! One binary of integration tests, so that they link once.

mod layering;
mod reference;
mod render;
