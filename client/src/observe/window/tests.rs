//! The window against simulated acknowledgements and disconnections.

use proptest::prelude::*;

use super::*;

/// A daemon that follows `observation.proto`, and does nothing else.
#[derive(Default)]
struct Daemon {
    stored: Vec<(String, i64, u64)>,
    crc: ContentCrc,
}

impl Daemon {
    fn durable(&self) -> u64 {
        self.stored.len() as u64
    }

    fn receive(&mut self, first: u64, batch: &[(String, Entry)]) {
        assert!(first <= self.durable() + 1, "a gap before {first}");
        for ((name, entry), sequence) in batch.iter().zip(first..) {
            if sequence > self.durable() {
                self.stored.push((name.clone(), entry.time_nanos, entry.value.to_bits()));
                self.crc.add(name, entry.time_nanos, entry.value);
            }
        }
    }
}

fn taken(window: &mut Window, max_count: usize, urgent: u64) -> (u64, Vec<(String, Entry)>) {
    let first = window.next_unsent();
    let batch: Vec<_> =
        window.to_send(max_count, urgent).map(|e| (window.names()[e.state as usize].to_string(), *e)).collect();
    window.sent(batch.len());
    (first, batch)
}

#[test]
fn a_first_observation_leaves_at_once_and_the_next_wait_for_company() {
    let mut window = Window::new(100, 0, 0);
    assert_eq!(window.push("a", 1, 0.0), Some(1));
    assert_eq!(taken(&mut window, 4, 0).1.len(), 1);
    for time in 2..5 {
        window.push("a", time, 0.0);
        assert!(taken(&mut window, 4, 0).1.is_empty(), "something is under way");
    }
    window.push("a", 5, 0.0);
    assert_eq!(
        taken(&mut window, 4, 0),
        (
            2,
            (2..6)
                .map(|time| ("a".to_owned(), Entry { state: 0, time_nanos: time, value: 0.0, position: None }))
                .collect()
        )
    );
    window.push("a", 6, 0.0);
    assert_eq!(taken(&mut window, 4, 6).1.len(), 1, "somebody waits for it");
    assert_eq!(window.acknowledged(6), Ok(()));
    assert_eq!((window.durable(), window.last()), (6, 6));
}

#[test]
fn a_full_window_takes_nothing_until_something_is_durable() {
    let mut window = Window::new(2, 10, 0);
    assert_eq!(
        (window.push("a", 0, 0.0), window.push("a", 0, 0.0), window.push("a", 0, 0.0)),
        (Some(11), Some(12), None)
    );
    taken(&mut window, 10, 0);
    assert_eq!(window.acknowledged(11), Ok(()));
    assert_eq!(window.push("a", 0, 0.0), Some(13));
}

#[test]
fn after_a_reconnection_sending_starts_after_what_the_daemon_has() {
    let mut window = Window::new(10, 0, 0);
    let mut daemon = Daemon::default();
    for time in 0..5 {
        window.push("a", time, 1.0);
    }
    let (first, batch) = taken(&mut window, 5, 0);
    daemon.receive(first, &batch[..3]);
    assert_eq!(window.welcomed(3, daemon.crc.value()), Ok(3), "three were durable without an acknowledgement");
    assert_eq!(window.next_unsent(), 4);
}

#[test]
fn what_the_daemon_lost_or_never_got_from_here_is_noticed() {
    let mut window = Window::new(10, 5, 77);
    window.push("a", 0, 1.0);
    assert_eq!(window.clone().welcomed(4, 0), Err(ProducerError::Lost { durable: 4, acknowledged: 5 }));
    assert_eq!(window.clone().welcomed(7, 0), Err(ProducerError::Foreign { durable: 7, sent: 6 }));
    assert_eq!(window.clone().welcomed(5, 78), Err(ProducerError::Differs { durable: 5 }));
    assert_eq!(window.clone().acknowledged(6), Err(ProducerError::Foreign { durable: 6, sent: 5 }));
    assert_eq!(window.welcomed(5, 77), Ok(0));
    assert_eq!(window.acknowledged(3), Ok(()), "an old acknowledgement changes nothing");
}

#[derive(Clone, Debug)]
enum Step {
    Push(u8),
    Send {
        max_count: usize,
        urgent: bool,
    },
    Acknowledge,
    /// The given number of sent observations arrive; then the connection breaks and a new one is made.
    Break(usize),
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        4 => any::<u8>().prop_map(Step::Push),
        4 => (1..6_usize, any::<bool>()).prop_map(|(max_count, urgent)| Step::Send { max_count, urgent }),
        2 => Just(Step::Acknowledge),
        1 => (0..6_usize).prop_map(Step::Break),
    ];
    proptest::collection::vec(step, 1..200)
}

proptest! {
    #[test]
    fn every_observation_arrives_once_and_in_order(steps in steps()) {
        let mut window = Window::new(8, 0, 0);
        let mut daemon = Daemon::default();
        let mut pushed = Vec::new();
        let mut under_way: VecDeque<(u64, Vec<(String, Entry)>)> = VecDeque::new();
        for (time, step) in (0..).zip(steps) {
            match step {
                Step::Push(seed) => {
                    let (name, value) = (format!("s{}", seed % 3), f64::from(seed) / 255.0);
                    if let Some(sequence) = window.push(&name, time, value) {
                        pushed.push((name, time, value.to_bits()));
                        prop_assert_eq!(sequence, pushed.len() as u64);
                    }
                }
                Step::Send { max_count, urgent } => {
                    let until = if urgent { window.last() } else { 0 };
                    let (first, batch) = taken(&mut window, max_count, until);
                    if !batch.is_empty() {
                        under_way.push_back((first, batch));
                    }
                }
                Step::Acknowledge => {
                    if let Some((first, batch)) = under_way.pop_front() {
                        daemon.receive(first, &batch);
                        prop_assert_eq!(window.acknowledged(daemon.durable()), Ok(()));
                    }
                }
                Step::Break(mut arrive) => {
                    for (first, batch) in under_way.drain(..) {
                        let part = arrive.min(batch.len());
                        daemon.receive(first, &batch[..part]);
                        arrive -= part;
                        if part < batch.len() {
                            break;
                        }
                    }
                    prop_assert!(window.welcomed(daemon.durable(), daemon.crc.value()).is_ok());
                }
            }
            prop_assert!(window.entries.len() <= 8);
        }
        prop_assert!(window.welcomed(daemon.durable(), daemon.crc.value()).is_ok());
        while window.durable() < window.last() {
            let last = window.last();
            let (first, batch) = taken(&mut window, 3, last);
            daemon.receive(first, &batch);
            prop_assert_eq!(window.acknowledged(daemon.durable()), Ok(()));
        }
        prop_assert_eq!(daemon.stored, pushed);
    }
}
