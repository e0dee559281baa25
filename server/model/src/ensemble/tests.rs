//! What an ensemble learns of simulated habits.
