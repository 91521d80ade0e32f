pub mod dual;
pub mod real;
pub mod sh;
