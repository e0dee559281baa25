//! A follower that reads the groups of another daemon from its files.
