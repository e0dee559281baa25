//! The components of a spectral model, and the choice of the strongest of a spectrum.
//!
//! Invariant: the kept components are in descending order of power, up to rounding; of components with equal power the
//! one with the longest period comes first.

use crate::{ORDER_MAX, Periodicities};

/// Powers that differ by less than this share are equal: they are sums over equal readings in another order.
const ROUNDING: f64 = 1e-9;

/// One periodic component γ_k of a state's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Component {
    /// Index k of the periodicity, from 0.
    pub periodicity: u32,
    /// Real part of γ_k.
    pub gamma_re: f64,
    /// Imaginary part of γ_k.
    pub gamma_im: f64,
}

impl Component {
    /// The amplitude 2|γ_k|.
    pub fn amplitude(&self) -> f64 {
        2.0 * libm::hypot(self.gamma_re, self.gamma_im)
    }

    /// Phase at local civil time 1970-01-01T00:00, in radians from -π to π: arg γ_k.
    pub fn phase_rad(&self) -> f64 {
        libm::atan2(self.gamma_im, self.gamma_re)
    }
}

/// The at most [`ORDER_MAX`] strongest of the components offered so far.
pub(super) struct Strongest {
    /// The powers, descending; 0 where there is no component yet, so that only more than 0 is kept.
    powers: [f64; ORDER_MAX],
    components: [Component; ORDER_MAX],
    count: usize,
}

impl Strongest {
    pub(super) fn new() -> Strongest {
        let none = Component { periodicity: 0, gamma_re: 0.0, gamma_im: 0.0 };
        Strongest { powers: [0.0; ORDER_MAX], components: [none; ORDER_MAX], count: 0 }
    }

    /// A component is kept only if its power |γ|² is above this.
    #[inline(always)]
    pub(super) fn to_beat(&self) -> f64 {
        self.powers[ORDER_MAX - 1]
    }

    /// Keeps a component if it is strong enough. Components must be offered in ascending order of periodicity.
    #[inline]
    pub(super) fn offer(&mut self, power: f64, component: Component) {
        if power > self.to_beat() {
            let mut place = self.count.min(ORDER_MAX - 1);
            while place > 0 && self.powers[place - 1] < power {
                self.powers[place] = self.powers[place - 1];
                self.components[place] = self.components[place - 1];
                place -= 1;
            }
            self.powers[place] = power;
            self.components[place] = component;
            self.count = (self.count + 1).min(ORDER_MAX);
        }
    }

    /// The kept components, strongest first; of components that are equal within rounding the longest period first.
    pub(super) fn into_components(mut self, periodicities: &Periodicities) -> Vec<Component> {
        let period_secs = |component: &Component| periodicities.period_secs(component.periodicity as usize);
        let mut from = 0;
        while from < self.count {
            let least = self.powers[from] * (1.0 - ROUNDING);
            let equal = self.powers[from..self.count].iter().take_while(|&&power| power >= least).count();
            // The sort is stable: of equal periods, the one that was offered first stays first.
            self.components[from..from + equal].sort_by(|one, next| period_secs(next).total_cmp(&period_secs(one)));
            from += equal;
        }
        self.components[..self.count].to_vec()
    }
}
