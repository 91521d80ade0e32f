//! One binary of integration tests, so that they link once.

mod layering;
