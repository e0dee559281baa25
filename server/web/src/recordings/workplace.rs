//! The place where a file waits for its import: a folder in the data folder for each turn.
//!
//! Invariant: the folder of a turn is removed when no import has the turn, whatever ended the last import, and only
//! then is the turn free. The disk keeps [`FREE_BYTES_KEPT`] for maps. A file must arrive at a minimum rate, so that
//! nobody keeps a turn by sending little.

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::Duration,
};

use axum::body::Body;
use http_body_util::BodyExt as _;
use rustix::fs::statvfs;
use tokio::{io::AsyncWriteExt as _, time::Instant};
use tracing::warn;

use super::{turns::Turn, upload_error::UploadError};

/// Free bytes of the disk that must remain after files are written.
const FREE_BYTES_KEPT: u64 = 1 << 30;
/// Number of bytes that arrive between two checks of the free disk space.
const CHECK_INTERVAL_BYTES: u64 = 64 << 20;
/// Maximum time until more of a file arrives.
const PAUSE: Duration = Duration::from_secs(30);
/// Maximum time of all pauses together, plus the time that the bytes that have arrived allow.
const SLACK: Duration = Duration::from_secs(30);
const BYTES_PER_SEC: u64 = 64 << 10;
/// Maximum time for a file to arrive.
const ARRIVES_WITHIN: Duration = Duration::from_secs(6 * 3600);
/// Maximum size of the name of a file, so that it fits into a label and into any folder.
const NAME_BYTES_MAX: usize = 120;
/// The folder of the file, in which the program that reads it is started.
const RECORDING: &str = "recording";

/// The name of a file as its sender gave it, without folders.
pub(super) fn file_name(given: &str) -> Result<String, UploadError> {
    let name = given.rsplit(['/', '\\']).next().unwrap_or_default().trim();
    let is_name = !name.chars().all(|character| character == '.') && !name.chars().any(char::is_control);
    if !is_name {
        return Err(UploadError::FileName(given.chars().take(NAME_BYTES_MAX).collect()));
    }
    if name.len() > NAME_BYTES_MAX {
        return Err(UploadError::LongName { bytes: name.len(), max: NAME_BYTES_MAX });
    }
    Ok(name.to_owned())
}

/// Free bytes of the disk that has a folder, or will have it. If the system does not report them, there is no bound.
fn free_bytes(folder: &Path) -> u64 {
    let disk = statvfs(folder).or_else(|_| statvfs(folder.parent().unwrap_or(folder)));
    disk.map_or(u64::MAX, |disk| disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Checks that the disk of a folder has room for this number of bytes.
///
/// # Errors
/// The disk has too little room.
pub(super) fn check_room(folder: &Path, bytes: u64) -> Result<(), UploadError> {
    let free = free_bytes(folder);
    if free < bytes.saturating_add(FREE_BYTES_KEPT) {
        return Err(UploadError::NoRoom { free, kept: FREE_BYTES_KEPT });
    }
    Ok(())
}

/// Removes a folder with all its content.
///
/// # Errors
/// The folder cannot be removed.
pub(super) fn empty(folder: &Path) -> io::Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Does work on the disk, off the async threads.
async fn on_disk<T: Send + 'static>(work: impl FnOnce() -> io::Result<T> + Send + 'static) -> io::Result<T> {
    tidemap_base::task::blocking(work).await.unwrap_or_else(|error| Err(io::Error::other(error)))
}

/// The place of one import. The folder is emptied when this is dropped.
#[derive(Debug)]
pub(super) struct Workplace {
    folder: PathBuf,
    file: String,
    turn: Option<Turn>,
}

impl Workplace {
    /// Makes the place for a file of this name.
    ///
    /// # Errors
    /// The disk failed.
    pub(super) async fn make(uploads: &Path, file: &str, turn: Turn) -> io::Result<Self> {
        let (turns, folder) = (turn.turns().clone(), uploads.join(turn.number().to_string()));
        let place = Self { folder, file: file.to_owned(), turn: Some(turn) };
        let (folder, made) = (place.folder.clone(), place.recording_folder());
        on_disk(move || {
            // Work that was abandoned may have left files since.
            empty(&folder)?;
            // The last import that ends removes the folder of all.
            turns.still(|| fs::create_dir_all(made))
        })
        .await?;
        Ok(place)
    }

    /// The memory that the program may take, in bytes.
    pub(super) fn memory(&self) -> u64 {
        self.turn.as_ref().map_or(0, Turn::memory)
    }

    /// The folder that holds nothing but the file.
    pub(super) fn recording_folder(&self) -> PathBuf {
        self.folder.join(RECORDING)
    }

    /// The folder of everything else, which is `..` from the folder of the file.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Name of the file.
    pub(super) fn file(&self) -> &str {
        &self.file
    }

    /// Writes a file as it arrives, and returns its size.
    ///
    /// # Errors
    /// The file is too large or empty, does not arrive, or the disk has no room.
    pub(super) async fn receive(&self, mut body: Body, max_bytes: u64) -> Result<u64, UploadError> {
        let mut file = tokio::fs::File::create_new(self.recording_folder().join(&self.file)).await?;
        let (mut received, mut checked_at) = (0_u64, 0);
        let began = Instant::now();
        loop {
            let (due, late) = due(began, received);
            let Some(frame) = tokio::time::timeout_at(due, body.frame()).await.map_err(|_| late)? else { break };
            let Ok(data) = frame.map_err(|_| UploadError::Broken)?.into_data() else { continue };
            received += data.len() as u64;
            if received > max_bytes {
                return Err(UploadError::TooLarge { max: max_bytes });
            }
            if received - checked_at >= CHECK_INTERVAL_BYTES {
                checked_at = received;
                check_room(&self.folder, 0)?;
            }
            self.written(file.write_all(&data).await)?;
        }
        self.written(file.flush().await)?;
        if received == 0 { Err(UploadError::Empty) } else { Ok(received) }
    }

    fn written(&self, done: io::Result<()>) -> Result<(), UploadError> {
        match done {
            Err(error) if error.kind() == io::ErrorKind::StorageFull => {
                Err(UploadError::NoRoom { free: free_bytes(&self.folder), kept: FREE_BYTES_KEPT })
            }
            done => Ok(done?),
        }
    }

    /// Empties the place, and frees the turn for the next import.
    pub(super) async fn clear(mut self) {
        if let Some(turn) = self.turn.take() {
            let folder = self.folder.clone();
            drop(tidemap_base::task::blocking(move || remove(&folder, turn)).await);
        }
    }
}

/// The time by which more of a file has to arrive, whose first byte arrived at `began`, and the error if it does not.
fn due(began: Instant, received: u64) -> (Instant, UploadError) {
    let pause = (Instant::now() + PAUSE, UploadError::Late { secs: PAUSE.as_secs() });
    let paced = began + SLACK + Duration::from_secs(received / BYTES_PER_SEC);
    let slow = (paced, UploadError::Slow { kib_per_sec: BYTES_PER_SEC >> 10 });
    let long = (began + ARRIVES_WITHIN, UploadError::Long { hours: ARRIVES_WITHIN.as_secs() / 3600 });
    let first = if slow.0 < pause.0 { slow } else { pause };
    if long.0 < first.0 { long } else { first }
}

fn remove(folder: &Path, turn: Turn) {
    if let Err(error) = empty(folder) {
        warn!(%error, folder = %folder.display(), "a file that was imported is still there; the next start removes it");
    }
    // The parent folder stays while others have a place in it.
    let _ = turn.turns().still(|| folder.parent().map(fs::remove_dir));
    drop(turn);
}

impl Drop for Workplace {
    fn drop(&mut self) {
        let Some(turn) = self.turn.take() else { return };
        let folder = std::mem::take(&mut self.folder);
        // A daemon that stops has no threads for this any more; the next start empties the place.
        if tokio::runtime::Handle::try_current().is_ok() {
            drop(tidemap_base::task::blocking(move || remove(&folder, turn)));
        }
    }
}

#[cfg(test)]
mod tests {
    use tidemap_base::connections::Peer;
    use tokio_stream::StreamExt as _;

    use super::{super::turns::Turns, *};

    #[test]
    fn a_file_name_has_no_folder_and_is_a_name() {
        for (given, name) in [
            ("drive.bag", "drive.bag"),
            ("../../etc/passwd", "passwd"),
            ("C:\\logs\\a b.mcap", "a b.mcap"),
            (" halle-über.db3 ", "halle-über.db3"),
            ("-rf", "-rf"),
            (".hidden", ".hidden"),
        ] {
            assert_eq!(file_name(given).expect(given), name);
        }
        for given in ["", ".", "..", "...", "a/", "a/..", "\\", "a\nb", "a\0b", " "] {
            assert!(matches!(file_name(given), Err(UploadError::FileName(_))), "{given:?}");
        }
        assert!(matches!(file_name(&"ü".repeat(61)), Err(UploadError::LongName { bytes: 122, .. })));
    }

    fn turn() -> Turn {
        let map = tidemap_map::name::MapName::new("flat").expect("a name");
        Turns::default().take(&map, Peer::Local, None).expect("a turn")
    }

    #[tokio::test]
    async fn a_place_is_empty_before_the_next_has_its_turn() {
        let data = tempfile::tempdir().expect("a folder");
        let folder = data.path().join("uploads");
        for is_dropped in [true, false] {
            assert!(!folder.exists());
            let turn = turn();
            let turns = turn.turns().clone();
            let place = Workplace::make(&folder, "a.bag", turn).await.expect("a place");
            assert_eq!(place.receive(Body::from("bytes"), 5).await.expect("taken"), 5);
            assert_eq!(fs::read(folder.join("0/recording/a.bag")).expect("there"), b"bytes");
            if is_dropped {
                drop(place);
            } else {
                place.clear().await;
            }
            while turns.any() {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        }
        assert!(!folder.exists());
        let place = Workplace::make(&folder, "a.bag", turn()).await.expect("a place");
        assert!(matches!(place.receive(Body::from("bytes!"), 5).await, Err(UploadError::TooLarge { max: 5 })));
    }

    #[tokio::test(start_paused = true)]
    async fn a_file_that_trickles_is_refused_and_a_slow_one_is_taken() {
        let data = tempfile::tempdir().expect("a folder");
        let folder = data.path().join("uploads");
        let sent = |piece: usize, every: Duration, count: usize| {
            let pieces = tokio_stream::iter(0..count).throttle(every);
            Body::from_stream(pieces.map(move |_| Ok::<_, std::convert::Infallible>(vec![7; piece])))
        };
        for (body, is_taken) in [
            (sent(1, Duration::from_secs(20), 100), false),
            (sent(60 << 10, Duration::from_secs(1), 1000), false),
            (sent(70 << 10, Duration::from_secs(1), 1000), true),
            (sent(3 << 20, Duration::from_secs(40), 10), false),
            (sent(2 << 20, Duration::from_secs(25), 10), true),
        ] {
            let place = Workplace::make(&folder, "a.bag", turn()).await.expect("a place");
            let received = place.receive(body, u64::MAX).await;
            match received {
                Ok(_) => assert!(is_taken),
                Err(error) => {
                    assert!(!is_taken && matches!(error, UploadError::Slow { .. } | UploadError::Late { .. }));
                }
            }
            place.clear().await;
        }
    }
}
