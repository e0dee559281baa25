//! The store's behaviour, from the outside where that is possible.

mod bit_flips;
mod damage;
pub(crate) mod example;
mod golden;
mod life;
mod round_trip;
mod torn_tail;
