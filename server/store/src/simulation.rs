//! The store on a simulated disk that loses, tears and refuses: everything but the index, which is never the authority.
//!
//! Each run follows from its seed alone.

mod crash;
mod disk;
mod faults;
mod machine;
