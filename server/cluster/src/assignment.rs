//! Selects the daemons that hold a map, and the order in which they may become its writer.
//!
//! Invariant: the result is a function of the names and capacities alone (rendezvous hashing). So all daemons that see
//! the same members compute the same result, and a member that joins or leaves moves few maps.

/// A daemon that may hold maps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// Name of the daemon.
    pub name: String,
    /// Capacity of the daemon: its number of maps is proportional to it; 0: it holds none.
    pub capacity: u32,
}

/// A number that depends on all bits of its input, after Steele, Lea, Flood: Fast splittable pseudorandom number
/// generators (2014), section 3.
fn mix(number: u64) -> u64 {
    let number = (number ^ number >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let number = (number ^ number >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    number ^ number >> 31
}

/// The score of a member for a map: the highest is the first. With these scores the shares are proportional to the
/// capacities (Thaler and Ravishankar 1998; weighted as by Schindelhauer and Schomaker 2005).
fn score(map: u64, candidate: &Candidate) -> f64 {
    let hash = candidate.name.bytes().fold(mix(map), |hash, byte| mix(hash ^ u64::from(byte)));
    // The number is in (0, 1).
    let uniform = ((hash >> 11) as f64 + 0.5) / (1_u64 << 53) as f64;
    f64::from(candidate.capacity) / -uniform.ln()
}

/// The candidates of a map, in the order of their scores, highest first.
#[must_use]
pub fn order(map: u64, candidates: &[Candidate]) -> Vec<String> {
    let mut scored: Vec<(f64, &Candidate)> =
        candidates.iter().filter(|candidate| candidate.capacity > 0).map(|known| (score(map, known), known)).collect();
    scored.sort_by(|(a, first), (b, second)| b.total_cmp(a).then_with(|| first.name.cmp(&second.name)));
    scored.into_iter().map(|(_, candidate)| candidate.name.clone()).collect()
}

/// The daemons that hold a map, in the order in which they may become its writer. A daemon that an operator has pinned
/// is the first while it is a candidate.
#[must_use]
pub fn holders(map: u64, candidates: &[Candidate], pinned: Option<&str>, replicas: usize) -> Vec<String> {
    let mut order = order(map, candidates);
    if let Some(at) = order.iter().position(|member| pinned == Some(member)) {
        order[..=at].rotate_right(1);
    }
    order.truncate(replicas);
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidates(capacities: &[u32]) -> Vec<Candidate> {
        let name = |index| format!("daemon-{index}");
        capacities.iter().enumerate().map(|(index, &capacity)| Candidate { name: name(index), capacity }).collect()
    }

    #[test]
    fn shares_are_proportional_to_capacities() {
        let members = candidates(&[1, 2, 1, 0]);
        let first = |name: &str| (0..4000).filter(|&map| order(map, &members)[0] == name).count();
        assert!((900..1100).contains(&first("daemon-0")), "{}", first("daemon-0"));
        assert!((1900..2100).contains(&first("daemon-1")), "{}", first("daemon-1"));
        assert_eq!(first("daemon-3"), 0);
    }

    #[test]
    fn a_pinned_member_is_the_first_holder_and_the_others_keep_their_order() {
        let members = candidates(&[1, 1, 1, 1]);
        let order = order(7, &members);
        let pinned = |name: &str, replicas| holders(7, &members, Some(name), replicas);
        assert_eq!(pinned(&order[3], 3), [&order[3], &order[0], &order[1]].map(String::clone));
        assert_eq!(pinned(&order[1], 2), [&order[1], &order[0]].map(String::clone));
        assert_eq!(pinned("gone", 3), order[..3]);
    }

    #[test]
    fn a_member_that_leaves_moves_its_own_maps_only() {
        let (all, fewer) = (candidates(&[1, 1, 1]), candidates(&[1, 1]));
        for map in 0..500 {
            let before = order(map, &all);
            let expected: Vec<String> = before.into_iter().filter(|name| name != "daemon-2").collect();
            assert_eq!(order(map, &fewer), expected);
        }
    }
}
