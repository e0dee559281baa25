//! Unique identities.
//!
//! Invariant: they are made from the randomness of the system.

/// 16 bytes of the system's randomness as hex: the identity of a new data folder.
pub fn random_id() -> anyhow::Result<String> {
    let random = ring::rand::generate::<[u8; 16]>(&ring::rand::SystemRandom::new());
    let bytes = random.map_err(|_| anyhow::anyhow!("the system provides no random numbers"))?.expose();
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}
