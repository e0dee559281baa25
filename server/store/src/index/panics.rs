//! sled panics on damaged data; here such a panic becomes an error.
//!
//! Invariant: only panics inside [`catch`] are caught, and only their messages are not printed on stderr.

use std::{
    any::Any,
    cell::Cell,
    panic::{self, AssertUnwindSafe},
    sync::Once,
};

use crate::failure::ReadFailure;

thread_local! {
    static IS_QUIET: Cell<bool> = const { Cell::new(false) };
}

static INSTALL: Once = Once::new();

/// Runs `action`; a panic becomes a failure with its message.
pub(super) fn catch<T>(action: impl FnOnce() -> T) -> Result<T, ReadFailure> {
    INSTALL.call_once(|| {
        let previous = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            // The caller shows the error; a backtrace would seem to be a crash of the daemon.
            if !IS_QUIET.get() {
                previous(info);
            }
        }));
    });
    IS_QUIET.set(true);
    // The caller that gets the error drops everything that `action` has changed.
    let result = panic::catch_unwind(AssertUnwindSafe(action));
    IS_QUIET.set(false);
    result.map_err(|payload| ReadFailure::of_text(message(&*payload)))
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(|&text| text.to_owned());
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned());
    format!("sled panicked: {}", text.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_its_message() {
        assert_eq!(catch(|| 7), Ok(7));
        assert_eq!(catch(|| panic!("page {}", 3)), Err::<(), _>("sled panicked: page 3".into()));
        assert_eq!(catch(|| panic!("page")), Err::<(), _>("sled panicked: page".into()));
    }
}
