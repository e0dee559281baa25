//! Names of the labels of categorical states.
//!
//! Invariant: `STATE/LABEL` has two plain names, and its label is no axis of a vector or an angle, so that the name
//! alone shows that the state is a label of STATE.

use tidemap_model::{ANGLE_AXES, Dimensions};

use super::{InvalidName, RESERVED, StateName, check, shown};

impl StateName {
    /// Name of the state of one label of a categorical state with this name: `STATE/LABEL`, 128 characters in all.
    ///
    /// # Errors
    /// [`InvalidName`], with what is wrong with the label.
    pub fn label(&self, label: &str) -> Result<Self, InvalidName> {
        self.check_vector()?;
        Self::new(label)?;
        let name = format!("{}/{label}", self.0);
        check(&name)?;
        if split_label(&name).is_none() {
            return Err(InvalidName::Axis(shown(label)));
        }
        Ok(Self(name.into()))
    }

    /// Checks a whole name, `STATE/LABEL`.
    ///
    /// # Errors
    /// [`InvalidName`], with what is wrong.
    pub fn labelled(name: &str) -> Result<Self, InvalidName> {
        let (state, label) = name.split_once('/').ok_or_else(|| InvalidName::NoLabel(shown(name)))?;
        Self::new(state)?.label(label)
    }

    /// Checks a name like [`StateName::stored`]; also accepts the name of a label.
    ///
    /// # Errors
    /// [`InvalidName`], with what is wrong.
    pub fn stored_or_label(name: &str) -> Result<Self, InvalidName> {
        Self::stored(name).or_else(|error| Self::labelled(name).map_err(|_| error))
    }

    /// If this is the name of a label: the name of its state, and the label.
    #[must_use]
    pub fn as_label(&self) -> Option<(&str, &str)> {
        split_label(&self.0)
    }
}

/// `STATE/LABEL` as state and label.
fn split_label(name: &str) -> Option<(&str, &str)> {
    let (state, label) = name.split_once('/')?;
    let is_axis = Dimensions::axis(label).is_some() || ANGLE_AXES.contains(&label);
    (!is_axis && !label.contains('/') && !RESERVED.contains(&state)).then_some((state, label))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_recognised_by_their_names() {
        let activity = StateName::new("activity").expect("valid");
        let sleep = activity.label("sleep").expect("valid");
        assert_eq!((sleep.as_str(), sleep.as_label()), ("activity/sleep", Some(("activity", "sleep"))));
        assert_eq!(StateName::labelled("activity/sleep"), Ok(sleep));
        assert_eq!(activity.as_label(), None);
        for other in ["anna/x", "heading/cos", "node/a/b", "edge/a/b", "speed/a/b"] {
            assert_eq!(StateName::stored(other).expect("valid").as_label(), None, "{other}");
        }
    }

    #[test]
    fn what_is_no_label_is_refused() {
        for bad in ["activity", "activity/x", "activity/sin", "activity/", "activity/a/b", "node/a", "/a", "a/b\nc"] {
            assert!(StateName::labelled(bad).is_err(), "{bad}");
        }
        let long = format!("{}/{}", "a".repeat(100), "b".repeat(28));
        assert!(matches!(StateName::labelled(&long), Err(InvalidName::TooLong { .. })));
        assert!(StateName::labelled(&long[..128]).is_ok());
    }
}
