//! Checks whether the client of an open stream is still there. Another stream of its key sends this probe before it
//! takes over.
//!
//! Invariant: only a reply of the client, or a stream that does not read now, counts as a sign of life. A probe never
//! changes the probed stream.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use tokio::{
    sync::{mpsc, watch},
    time::{Instant, timeout_at},
};

/// Time limit for a client to reply to a probe; after it the client counts as gone. It is a little less than the two
/// seconds that the wire promises, so that the waiting stream is served within them.
const ANSWER_WITHIN: Duration = Duration::from_millis(1900);
/// Time for which a reply counts.
const FRESH_FOR: Duration = Duration::from_millis(100);
/// Maximum number of probes that wait to be sent.
const QUESTIONS: usize = 4;

/// The time at which a stream can receive replies.
#[derive(Clone, Copy, Debug)]
enum Reception {
    /// The stream has read everything that has arrived since this time.
    Since(Instant),
    /// The stream waits for the daemon, and reads later.
    Later,
}

type SharedReception = Arc<Mutex<Reception>>;

fn lock(reception: &SharedReception) -> MutexGuard<'_, Reception> {
    reception.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Probes the client of a stream. Clones probe the same client.
#[derive(Clone, Debug)]
pub struct Probe {
    questions: mpsc::Sender<()>,
    answered: watch::Receiver<Option<Instant>>,
    reception: SharedReception,
}

impl PartialEq for Probe {
    /// Whether both probe the same stream.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.reception, &other.reception)
    }
}

/// The side of the probed stream.
#[derive(Debug)]
pub struct Probed {
    answered: watch::Sender<Option<Instant>>,
    reception: SharedReception,
}

/// A probe, the side of its stream, and the receiver of the probes that the stream has to pass on to its client.
pub fn probe() -> (Probe, Probed, mpsc::Receiver<()>) {
    let (questions, probes) = mpsc::channel(QUESTIONS);
    let (answered, answers) = watch::channel(None);
    let reception = Arc::new(Mutex::new(Reception::Since(Instant::now())));
    (Probe { questions, answered: answers, reception: Arc::clone(&reception) }, Probed { answered, reception }, probes)
}

impl Probed {
    /// Records that the client has replied.
    pub fn answer(&self) {
        self.answered.send_replace(Some(Instant::now()));
    }

    /// Sets whether the stream waits for the daemon, so that it cannot read a reply.
    pub fn pause(&self, is_paused: bool) {
        let mut reception = lock(&self.reception);
        *reception = match *reception {
            _ if is_paused => Reception::Later,
            Reception::Later => Reception::Since(Instant::now()),
            since @ Reception::Since(_) => since,
        };
    }
}

impl Probe {
    /// Whether the client is still there.
    pub async fn is_alive(&self) -> bool {
        if self.answered.borrow().is_some_and(|at| at.elapsed() < FRESH_FOR) {
            return true;
        }
        let mut answered = self.answered.clone();
        answered.borrow_and_update();
        // The channel is full: others have sent a probe, and the same reply counts.
        let _ = self.questions.try_send(());
        let mut since = Instant::now();
        loop {
            match timeout_at(since + ANSWER_WITHIN, answered.changed()).await {
                Ok(Ok(())) => return true,
                // The stream has ended meanwhile.
                Ok(Err(_)) => return false,
                Err(_) => {}
            }
            match *lock(&self.reception) {
                Reception::Later => return true,
                // The stream has waited meanwhile: the client gets the full time from the end of this wait.
                Reception::Since(later) if later > since => since = later,
                Reception::Since(_) => return false,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_client_is_there_if_it_answers_or_cannot_be_probed() {
        let (client_probe, probed, mut questions) = probe();
        let asking = client_probe.clone();
        let answer = tokio::spawn(async move { asking.is_alive().await });
        questions.recv().await.expect("a question");
        probed.answer();
        assert!(answer.await.expect("no panic"));
        assert!(client_probe.is_alive().await, "it has just responded");
        assert!(questions.try_recv().is_err(), "and is not probed again");

        let [silent, paused, ended] = [(); 3].map(|()| probe());
        paused.1.pause(true);
        drop(ended.1);
        assert!(silent.0 == silent.0.clone() && silent.0 != paused.0);
        let found = tokio::join!(silent.0.is_alive(), paused.0.is_alive(), ended.0.is_alive());
        assert_eq!(found, (false, true, false));
        paused.1.pause(false);
        assert!(!paused.0.is_alive().await);
    }
}
