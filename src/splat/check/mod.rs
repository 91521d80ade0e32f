pub mod gradient_check;
pub mod tube;
