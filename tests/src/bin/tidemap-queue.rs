//! A robot's program that puts observations into a queue until it is killed.
//!
//! `tidemap-queue SERVER FOLDER COUNT` takes observations of the state `door` up to number COUNT, from the one behind
//! the last that the queue took. It writes `taken N` to stdout for each, and `durable` when the daemon has all.
//!
//! Invariant: observation N is at second N of the test and has the value N mod 2, in each run.

use std::{
    env,
    io::{self, Write as _},
    path::PathBuf,
    time::Duration,
};

use tidemap_client::{
    Client,
    observe::{ProducerOptions, QueueOptions, QueuedProducer},
};

/// Second 0 of the test: 2026-01-05T12:00:00Z.
const START_SECS: i64 = 1_767_614_400;
const PAUSE: Duration = Duration::from_micros(200);

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [server, folder, count] = env::args().skip(1).collect::<Vec<_>>().try_into().map_err(|_| "three arguments")?;
    let count: u64 = count.parse()?;
    let options = ProducerOptions::new("robot", "", "office");
    let queue = QueueOptions { sync_every: Duration::from_millis(50), ..QueueOptions::new(PathBuf::from(folder)) };
    let producer = QueuedProducer::open(&Client::new(&server)?, options, &queue)?;
    for number in producer.state().last + 1..=count {
        let time_nanos = (START_SECS + i64::try_from(number)?) * 1_000_000_000;
        let taken = producer.send("door", time_nanos, (number % 2) as f64)?;
        assert_eq!(taken, number, "the queue keeps its numbers");
        writeln!(io::stdout(), "taken {taken}")?;
        tokio::time::sleep(PAUSE).await;
    }
    producer.flush(Duration::from_secs(120)).await?;
    writeln!(io::stdout(), "durable")?;
    producer.close().await?;
    Ok(())
}
