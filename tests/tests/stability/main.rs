//! What must hold still: points ([`points`]), and each known way in which a method fails, within its bound ([`modes`]).

mod modes;
mod points;
