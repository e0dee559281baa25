//! A map, as everybody but its writer sees it.
//!
//! Invariant: reading never waits, and nothing here changes a map except by a command to its writer.

use std::sync::{Arc, mpsc};

use arc_swap::ArcSwap;
use tidemap_map::{spec::MapSpec, view::MapView};
use tidemap_store::MapId;
use tokio::sync::{oneshot, watch};

use super::protocol::{Command, Ending};

/// A map, as everybody but its writer sees it.
#[derive(Debug)]
pub struct MapHandle {
    /// Its number in the store.
    pub id: MapId,
    /// Its fixed properties.
    pub spec: Arc<MapSpec>,
    view: Arc<ArcSwap<MapView>>,
    commands: mpsc::Sender<Command>,
    saturated: watch::Receiver<bool>,
}

impl MapHandle {
    /// The handle of a map whose writer publishes to `view`, listens to `commands` and sets `saturated`.
    #[must_use]
    pub fn new(
        id: MapId,
        spec: Arc<MapSpec>,
        view: Arc<ArcSwap<MapView>>,
        commands: mpsc::Sender<Command>,
        saturated: watch::Receiver<bool>,
    ) -> Self {
        Self { id, spec, view, commands, saturated }
    }

    /// The map as it stands; never waits.
    #[must_use]
    pub fn view(&self) -> Arc<MapView> {
        self.view.load_full()
    }

    /// Sends the writer a command. `false`: the writer has stopped.
    #[must_use]
    pub fn send(&self, command: Command) -> bool {
        self.commands.send(command).is_ok()
    }

    /// Whether streams should wait, because updates do not keep up.
    #[must_use]
    pub fn saturated(&self) -> watch::Receiver<bool> {
        self.saturated.clone()
    }

    /// Stops the writer, once everything in flight is answered.
    pub async fn stop(&self, ending: Ending) {
        let (done, stopped) = oneshot::channel();
        if self.send(Command::Stop { ending, done }) {
            // An error means that the writer is gone already.
            let _ = stopped.await;
        }
    }
}
