//! The recording of Stromovka gives the published figures.
