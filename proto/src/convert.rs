//! Conversions (in progress).
