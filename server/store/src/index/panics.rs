//! sled panics where it meets damage: a panic in it is an error here.
//!
//! Invariant: only panics inside [`catch`] are caught, and only their message is kept from the standard error.

use std::{
    any::Any,
    cell::Cell,
    panic::{self, AssertUnwindSafe},
    sync::Once,
};

thread_local! {
    static IS_QUIET: Cell<bool> = const { Cell::new(false) };
}

static INSTALL: Once = Once::new();

/// Runs `action`; a panic becomes its message.
pub(super) fn catch<T>(action: impl FnOnce() -> T) -> Result<T, String> {
    INSTALL.call_once(|| {
        let previous = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            // What is repaired is reported; a backtrace would look like a crash of the daemon.
            if !IS_QUIET.get() {
                previous(info);
            }
        }));
    });
    IS_QUIET.set(true);
    // Whoever gets the error drops everything that `action` has touched.
    let result = panic::catch_unwind(AssertUnwindSafe(action));
    IS_QUIET.set(false);
    result.map_err(|payload| message(&*payload))
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
        assert_eq!(catch(|| panic!("page {}", 3)), Err::<(), _>("sled panicked: page 3".to_owned()));
        assert_eq!(catch(|| panic!("page")), Err::<(), _>("sled panicked: page".to_owned()));
    }
}
