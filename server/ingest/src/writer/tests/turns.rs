//! Two daemons that write a map in turn, while the other follows.

use super::{
    follower_file::{observe, prepare, scan, shown, spec},
    replicas::{Replica, SharedMemory, compared},
    scans::picture,
    *,
};

/// A daemon with its side of the log.
struct Side {
    replica: Replica,
    log: Arc<SharedMemory>,
}

impl Side {
    fn open(dir: &Path, name: &str) -> Self {
        let log = Arc::new(SharedMemory::default());
        let own = Some(Arc::clone(&log) as Arc<dyn EventLog>);
        let replica = Replica::open_with(&dir.join(name), &spec(), own, |context| context.max_states = 40);
        Self { replica, log }
    }

    /// Follows the other daemon up to the end of its log.
    async fn follow(&self, other: &Side) {
        let known = self.log.events().len();
        let events = other.log.events().into_iter().skip(known).map(|(_, event)| event).collect();
        self.replica.send_events(self.log.append_elsewhere(events)).await.expect("applied");
    }
}

#[tokio::test]
async fn daemons_that_write_in_turn_hold_the_same() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let sides = ["a", "b"].map(|name| Side::open(dir.path(), name));
    // Each turn shows new tiles, and sends more data of the same producers.
    for turn in 1..=4 {
        let [writer, follower] = if turn % 2 == 1 { [&sides[0], &sides[1]] } else { [&sides[1], &sides[0]] };
        follower.replica.follow("other");
        writer.replica.write(turn);
        if turn == 1 {
            prepare(&writer.replica).await;
        }
        observe(&writer.replica, turn).await;
        scan(&writer.replica, "scanner", turn).await;
        let before = writer.replica.handle.position();
        writer.replica.update();
        writer.replica.reaches(before + 2).await;
        // There is no update between these scans and those of the next writer.
        let last = scan(&writer.replica, "another", turn).await;
        follower.follow(writer).await;
        compared(&follower.replica, turn, true).await;
        let (written, followed) = (shown(&writer.replica, turn).await, shown(&follower.replica, turn).await);
        assert_eq!(written, followed);
        assert_eq!(written.generation, turn);
        let (tiles, ..) = picture(&follower.replica.handle);
        assert!(last.iter().all(|shown| tiles.contains(shown)), "the map shows what was seen last: {tiles:?}");
    }
    for side in sides {
        side.replica.stop().await;
    }
}
