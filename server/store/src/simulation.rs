//! The store on a simulated disk that loses, tears and refuses writes. The index is left out: it holds no unique data.
//!
//! Each run follows from its seed alone.

mod crash;
mod disk;
mod erasures;
mod faults;
mod machine;
