//! How many looks speak for each hour of the day: its own, and those nearby by how much they tell of it.
//!
//! Invariant: more looks never make an hour less known.

use super::looks::HOURS;
use super::week_table::Hours;

/// The squared correlation of hours that are so many hours apart.
const NEAR: [f64; 4] = [1.0, 0.4, 0.18, 0.05];
/// The factor for the other kind of day: weekdays tell of weekends less.
const OTHER_KIND: f64 = 0.6;
/// One hour never tells more of another than this share.
const SHARE_MAX: f64 = 0.95;

/// The equivalent looks by hour of weekdays, then of weekends. `looks`: number of looks likewise.
pub(super) fn equivalent_looks(looks: &[Hours; 2]) -> [Hours; 2] {
    let mut equivalent = *looks;
    for (kind, hours) in equivalent.iter_mut().enumerate() {
        for (hour, known) in hours.iter_mut().enumerate() {
            for (other_kind, of_kind) in looks.iter().enumerate() {
                for (apart, &near) in NEAR.iter().enumerate() {
                    let share = if other_kind == kind { near } else { near * OTHER_KIND };
                    let mut add = |number: f64| {
                        // What so many looks tell of their own hour, and that hour of this one.
                        let share = (share * number / (number + 1.0)).min(SHARE_MAX);
                        *known += share / (1.0 - share);
                    };
                    match apart {
                        0 if other_kind == kind => {}
                        0 => add(of_kind[hour]),
                        _ => {
                            add(of_kind[(hour + apart) % HOURS]);
                            add(of_kind[(hour + HOURS - apart) % HOURS]);
                        }
                    }
                }
            }
        }
    }
    equivalent
}

/// The share of the members' answer at an hour for which so many looks speak; the smooth table has the rest.
pub(super) fn evidence(equivalent_looks: f64) -> f64 {
    let square = equivalent_looks * equivalent_looks;
    square / (square + 0.25)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_tell_of_hours_nearby_and_not_of_others() {
        let mut looks = [[0.0; HOURS]; 2];
        looks[0][12] = 30.0;
        let known = equivalent_looks(&looks);
        assert_eq!((known[0][12], known[0][20], known[1][3]), (30.0, 0.0, 0.0));
        assert!(known[0][11] > known[0][10] && known[0][10] > known[0][9] && known[0][9] > 0.0);
        assert_eq!(known[0][11], known[0][13]);
        assert!(known[1][12] > 0.5 && known[1][12] < known[0][12]);
        assert!(evidence(0.0) == 0.0 && evidence(0.5) == 0.5 && evidence(5.0) > 0.98);
    }
}
