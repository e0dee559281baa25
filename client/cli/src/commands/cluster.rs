//! `tidemap cluster`: the members and maps of a cluster, as all of its daemons report them, and the operations on them.
//!
//! Invariant: the exit status is the health of the cluster: 0 all is well, 1 there is a warning, 2 there is an error,
//! for example no daemon answers. Warnings and errors go to stderr, one line each.

use std::{
    process::ExitCode,
    time::{Duration, Instant},
};

use anyhow::Context as _;
use clap::{Args, Subcommand};
use tidemap_client::{Client, connection::Credentials};
use tidemap_formats::table::Cell;

use self::{
    concerns::{Severity, concerns, worst},
    view::{ClusterView, answer_of, is_writing},
};
use super::Session;
use crate::progress::status_line;

mod concerns;
mod heal;
mod rows;
mod take_in;
mod verify;
mod view;

/// The time limit for a change of the cluster.
const CHANGE_WITHIN: Duration = Duration::from_secs(60);
/// Pause between two questions whether it has happened.
const ASK_EVERY: Duration = Duration::from_millis(200);

/// The cluster cannot be reached, or does not do what was requested: the command ends with status 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct ClusterLost(pub(crate) String);

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum ClusterCommand {
    /// Shows the members of the cluster, with warnings and errors
    ///
    /// The command contacts all members. The exit status is 0 if all is well, 1 if there is a warning, and 2 if there
    /// is an error: a map has no writer, a log has forked, digests differ, or the engine or all members do not respond.
    /// Warnings and errors go to stderr.
    Status,
    /// Shows the role of each member for each map
    ///
    /// lag_records is how far the member is behind the others; heard_secs is the time since it last received the end of
    /// the shared log. digest is that of the newest generation since the member's start, and equal states whether it is
    /// the writer's. The exit status is that of `cluster status`.
    Maps,
    /// Pins a map to a member, which is to write it, and waits until it does
    ///
    /// The member must be alive and hold the map. The present writer hands the map over when the member has all of its
    /// log. The command waits 60 seconds at most.
    Move(MoveArgs),
    /// Makes a member hand over all maps that it writes and take no new ones, and waits until it writes none
    ///
    /// The member still follows the maps that it holds. The command waits 60 seconds and ends with 2 if a map has no
    /// other holder. --undo ends the drain, and so does a restart of the member.
    Drain(DrainArgs),
    /// Removes a member that no longer runs from the list of members
    ///
    /// For a machine that does not come back. The member must have been silent for 5 seconds. If its daemon starts
    /// again, it is listed again.
    Forget(ForgetArgs),
    /// Compares the logs and the newest digests of a map on all members that respond
    ///
    /// Logs are compared at a position that all of these members have. The exit status is 2 if something differs, and 1
    /// if a member does not respond or no longer keeps the records.
    Verify(VerifyArgs),
    /// Takes the observations of a map's forks into the map again, and removes forks of which it has everything
    ///
    /// A fork is records that a member set aside because the shared log does not have them. Their observations are sent
    /// to the map as from their producers, under their numbers, so that it has each of them once. Scans, traversals,
    /// sightings and reports of tasks cannot be sent again, and neither can the records after them in their sequences,
    /// or observations of a producer that has begun anew. Values are compared by a checksum only, where the map still
    /// has one. With --accept-loss the forks are removed all the same; records that the map lacks are lost. The exit
    /// status is 2 while forks are left, and 1 if a member does not respond.
    Heal(HealArgs),
}

#[derive(Debug, Args)]
pub(crate) struct MoveArgs {
    /// Name of the map
    map: String,
    /// Name of the member
    #[arg(required_unless_present = "unpin", conflicts_with = "unpin")]
    member: Option<String>,
    /// Remove the pin; the present writer stays until it is lost, drains, or no longer has to hold the map
    #[arg(long)]
    unpin: bool,
}

#[derive(Debug, Args)]
pub(crate) struct DrainArgs {
    /// Name of the member
    member: String,
    /// End the drain: the member may take maps again
    #[arg(long)]
    undo: bool,
}

#[derive(Debug, Args)]
pub(crate) struct ForgetArgs {
    /// Name of the member
    member: String,
}

#[derive(Debug, Args)]
pub(crate) struct VerifyArgs {
    /// Name of the map
    map: String,
}

#[derive(Debug, Args)]
pub(crate) struct HealArgs {
    /// Name of the map
    map: String,
    /// Remove all forks, also those with records that the map lacks; these records are lost
    #[arg(long)]
    accept_loss: bool,
    /// Show the contents of the forks; take in nothing and remove nothing
    #[arg(long, conflicts_with = "accept_loss")]
    dry_run: bool,
}

/// Runs a command. Any error ends with status 2.
pub(crate) async fn run(
    session: &Session,
    credentials: &Credentials,
    command: ClusterCommand,
) -> anyhow::Result<ExitCode> {
    let ran = match command {
        ClusterCommand::Status => status(session, credentials, false).await,
        ClusterCommand::Maps => status(session, credentials, true).await,
        ClusterCommand::Move(args) => move_map(session, credentials, args).await,
        ClusterCommand::Drain(args) => drain(session, credentials, args).await,
        ClusterCommand::Forget(args) => forget(session, args).await,
        ClusterCommand::Verify(args) => verify::run(session, credentials, &args.map).await,
        ClusterCommand::Heal(args) => heal::run(session, credentials, args).await,
    };
    ran.map_err(|error| if error.is::<ClusterLost>() { error } else { lost(error) })
}

/// An error that ends the command with status 2.
fn lost(error: anyhow::Error) -> anyhow::Error {
    error.context(ClusterLost("the cluster".to_owned()))
}

fn exit(severity: Severity) -> ExitCode {
    ExitCode::from(severity as u8)
}

async fn status(session: &Session, credentials: &Credentials, of_maps: bool) -> anyhow::Result<ExitCode> {
    let view = ClusterView::ask(&session.client, credentials).await?;
    if of_maps {
        session.print(&rows::MAP_COLUMNS, rows::maps(&view))?;
    } else {
        session.print(&rows::MEMBER_COLUMNS, rows::members(&view))?;
    }
    let concerns = concerns(&view);
    for (severity, text) in &concerns {
        status_line(&format!("{}: {text}", severity.word()));
    }
    Ok(exit(worst(&concerns)))
}

/// Waits for something to be true of the cluster.
async fn wait_for<T>(what: &str, mut check: impl AsyncFnMut() -> anyhow::Result<Option<T>>) -> anyhow::Result<T> {
    let begun = Instant::now();
    loop {
        let seen = check().await;
        match seen {
            Ok(Some(found)) => return Ok(found),
            // A daemon may be slow to answer for a moment.
            Ok(None) | Err(_) if begun.elapsed() < CHANGE_WITHIN => tokio::time::sleep(ASK_EVERY).await,
            Ok(None) => anyhow::bail!("{what} within {} seconds: see tidemap cluster status", CHANGE_WITHIN.as_secs()),
            Err(error) => return Err(error),
        }
    }
}

async fn move_map(session: &Session, credentials: &Credentials, args: MoveArgs) -> anyhow::Result<ExitCode> {
    let begun = Instant::now();
    session.client.move_map(&args.map, args.member.as_deref()).await?;
    let columns = ["map", "writer", "epoch", "secs"];
    let Some(member) = args.member else {
        status_line(&format!("map {} is no longer pinned; its present writer stays", args.map));
        return session.print(&columns, []);
    };
    let client = member_client(&session.client, credentials, &member).await?;
    let epoch = wait_for(&format!("{member} did not become the writer of map {}", args.map), async || {
        let answer = answer_of(&client, false).await?;
        let replica = answer.maps.into_iter().find(|map| map.map == args.map).and_then(|map| map.replica);
        Ok(replica.filter(is_writing).map(|replica| replica.epoch))
    })
    .await?;
    let secs = Cell::Secs(i64::try_from(begun.elapsed().as_nanos()).unwrap_or(i64::MAX));
    session.print(&columns, [vec![Cell::Text(args.map), Cell::Text(member), epoch.into(), secs]])
}

/// A client of a member, by the address that it reports.
async fn member_client(client: &Client, credentials: &Credentials, member: &str) -> anyhow::Result<Client> {
    let status = answer_of(client, false).await?;
    let found = status.members.iter().find(|known| known.name == member);
    let address = found.map(|known| known.address.clone()).with_context(|| {
        let known: Vec<&str> = status.members.iter().map(|known| known.name.as_str()).collect();
        format!("{member:?} is no member of the cluster; members: {}", known.join(", "))
    })?;
    Ok(if status.member == member { client.clone() } else { Client::with_credentials(&address, credentials)? })
}

async fn forget(session: &Session, args: ForgetArgs) -> anyhow::Result<ExitCode> {
    session.client.forget_member(&args.member).await?;
    let left = answer_of(&session.client, false).await?.members.into_iter().map(|member| member.name);
    let left = left.filter(|name| *name != args.member);
    session.print(&["member"], left.map(|name| vec![Cell::Text(name)]))
}

async fn drain(session: &Session, credentials: &Credentials, args: DrainArgs) -> anyhow::Result<ExitCode> {
    let client = member_client(&session.client, credentials, &args.member).await?;
    let written = async || -> anyhow::Result<Vec<String>> {
        let maps = answer_of(&client, false).await?.maps.into_iter();
        Ok(maps.filter(|map| map.replica.as_ref().is_some_and(is_writing)).map(|map| map.map).collect())
    };
    let before = written().await?;
    client.drain(args.undo).await?;
    if args.undo {
        status_line(&format!("{} may take maps again", args.member));
        return session.print(&["map", "writer"], []);
    }
    wait_for(&format!("{} did not hand over all of its maps", args.member), async || {
        Ok(written().await?.is_empty().then_some(()))
    })
    .await?;
    // A member that takes a map appears as its writer after it has taken it.
    let writers = wait_for("not all maps have a writer", async || {
        let view = ClusterView::ask(&session.client, credentials).await?;
        let writers: Vec<Option<String>> = before.iter().map(|map| view.writer(map)).collect();
        Ok(writers.into_iter().collect::<Option<Vec<String>>>())
    })
    .await?;
    let row = |(map, writer): (String, String)| vec![Cell::Text(map), Cell::Text(writer)];
    session.print(&["map", "writer"], before.into_iter().zip(writers).map(row))
}
