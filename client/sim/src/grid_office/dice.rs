//! Random numbers of the grid office, keyed by topic, thing and day, so that they can be drawn in any order.
//!
//! Invariant: equal keys give equal draws on every machine and with every version of every library: integers, and
//! floats made by addition and multiplication only. The stream of an earlier benchmark can be generated again.

/// The subject of a draw.
#[derive(Clone, Copy, Debug)]
pub(crate) enum DiceTopic {
    Habits = 1,
    Group,
    Leave,
    Sick,
    PersonDay,
    MeetingDay,
    Cleaner,
    LeftChair,
    ThingDay,
    ThingHabit,
    Parcel,
    Edges,
    CellWeight,
    Flicker,
}

/// A source of draws: SplitMix64.
#[derive(Clone, Debug)]
pub(crate) struct Dice(u64);

fn mixed(value: u64) -> u64 {
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

impl Dice {
    /// The draws for the `index`-th thing of a topic on the day with number `day`.
    pub(crate) fn new(seed: u64, topic: DiceTopic, index: u32, day: i32) -> Self {
        let what = u64::from(index) | (topic as u64) << 32;
        let key = mixed(mixed(seed.wrapping_add(0x9e37_79b9_7f4a_7c15)) ^ what);
        Self(mixed(key ^ u64::from(day.cast_unsigned())))
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mixed(self.0)
    }

    /// An integer below `bound`, which is at least 1.
    pub(crate) fn below(&mut self, bound: u32) -> u32 {
        (((self.next() >> 32) * u64::from(bound)) >> 32) as u32
    }

    /// An integer in `from..to`; `from` if the range is empty.
    pub(crate) fn between(&mut self, from: i32, to: i32) -> i32 {
        from + self.below((to - from).max(1).unsigned_abs()).cast_signed()
    }

    /// True in `percent` of 100 cases.
    pub(crate) fn chance(&mut self, percent: u32) -> bool {
        self.below(100) < percent
    }

    /// A number in 0..1.
    pub(crate) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A draw around `mean` with standard deviation `spread`, at most 3.5 standard deviations away.
    pub(crate) fn around(&mut self, mean: i32, spread: i32) -> i32 {
        // The sum of four uniform draws is close to a normal distribution, and bounded.
        let bell: i64 = (0..4).map(|_| i64::from(self.between(-spread, spread + 1))).sum();
        mean + (bell * 866 / 1000) as i32
    }
}
