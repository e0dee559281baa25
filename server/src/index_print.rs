//! `tidemapd index DIR [MAP]`: prints the index of a data folder that no daemon uses.
//!
//! Invariant: the data folder is not changed. The exit status is 0 where the index has a whole generation of every map,
//! 1 where it lacks one, and 2 where nothing can be printed.

use std::{io::Write, path::Path, process::ExitCode};

use tidemap_map::{
    snapshot::{MapSnapshot, StateSnapshot},
    spec::MapSpec,
};
use tidemap_store::{IndexContents, IndexedRows};

const CACHE_BYTES: u64 = 64 << 20;

/// Prints the index of a folder; with `map`, the rows of that map.
pub(crate) fn run(directory: &Path, map: Option<&str>) -> ExitCode {
    let contents = match IndexContents::open(directory, CACHE_BYTES) {
        Ok(contents) => contents,
        Err(error) => return refuse(&error.to_string()),
    };
    // A reader that goes away is no error.
    let mut out = std::io::stdout().lock();
    let printed = match map {
        None => print_maps(&contents, &mut out),
        Some(name) => match contents.maps.iter().find(|(_, spec, _)| spec.name.as_str() == name) {
            None => {
                let known: Vec<&str> = contents.maps.iter().map(|(_, spec, _)| spec.name.as_str()).collect();
                return refuse(&format!("map {name:?} does not exist; maps here: {}", known.join(", ")));
            }
            Some((id, spec, rows)) => match contents.published(*id, spec) {
                Some(published) => print_rows(&published, spec, &mut out),
                None => {
                    eprintln!("tidemapd: map {name:?}: {}", shown(rows));
                    return ExitCode::from(1);
                }
            },
        },
    };
    let is_whole = |rows: &IndexedRows| matches!(rows, IndexedRows::Whole { .. });
    let lacks_one = map.is_none() && contents.maps.iter().any(|(.., rows)| !is_whole(rows));
    if printed.is_err() || lacks_one { ExitCode::from(1) } else { ExitCode::SUCCESS }
}

fn refuse(text: &str) -> ExitCode {
    eprintln!("tidemapd: {text}");
    ExitCode::from(2)
}

/// The reason why there is no whole generation, for people.
fn shown(rows: &IndexedRows) -> String {
    match rows {
        IndexedRows::Whole { .. } => "whole".to_owned(),
        IndexedRows::Nothing => "no generation yet".to_owned(),
        IndexedRows::Unfinished => "a save was cut off; the next start writes it again".to_owned(),
        IndexedRows::Damaged(reason) => format!("damaged: {reason}; the next start writes it again"),
    }
}

fn print_maps(contents: &IndexContents, out: &mut impl Write) -> std::io::Result<()> {
    let width = contents.maps.iter().map(|(_, spec, _)| spec.name.as_str().len()).max().unwrap_or(0).max(3);
    writeln!(out, "{:width$}  generation  states  tiles    rows       bytes  index", "map")?;
    for (id, spec, rows) in &contents.maps {
        let published = contents.published(*id, spec);
        let states = published.as_ref().map_or(0, |published| published.states.len());
        let tiles = published.as_ref().and_then(|published| published.grid.as_ref()).map_or(0, |grid| grid.tiles.len());
        let (generation, records, bytes) = match rows {
            IndexedRows::Whole { generation, records, bytes } => (*generation, *records, *bytes),
            _ => (0, 0, 0),
        };
        let name = spec.name.as_str();
        let index = shown(rows);
        writeln!(out, "{name:width$}  {generation:>10}  {states:>6}  {tiles:>5}  {records:>6}  {bytes:>10}  {index}")?;
    }
    writeln!(out, "{} bytes on the disk", contents.disk_bytes)
}

/// The rows of one map: its states, then its tiles.
fn print_rows(published: &MapSnapshot, spec: &MapSpec, out: &mut impl Write) -> std::io::Result<()> {
    writeln!(out, "generation {} of map {}", published.generation, spec.name.as_str())?;
    let site = &published.site;
    let topology = site.topology();
    let (locations, nodes, edges) = (site.locations().len(), topology.nodes().len(), topology.edges().len());
    writeln!(out, "site: {locations} locations, {nodes} nodes, {edges} edges")?;
    writeln!(out, "state  kind  mean  model  order  components  learned  last")?;
    for state in &published.states {
        print_state(state, out)?;
    }
    let Some(grid) = &published.grid else { return Ok(()) };
    writeln!(out, "tile  known  learned  changed  components")?;
    for (index, tile) in grid.tiles.iter().enumerate() {
        let place = tile.index;
        let known = tile.known.count();
        match grid.models.get(index).map(|model| model.get()).transpose() {
            Ok(model) => {
                let model = model.unwrap_or_default();
                let components: usize = model.cells.iter().map(|cell| cell.spectral.components().len()).sum();
                let (learned, changed) = (model.observed().count(), model.cells.len());
                writeln!(out, "{}/{}/{}  {known}  {learned}  {changed}  {components}", place.x, place.y, place.z)?;
            }
            Err(error) => writeln!(out, "{}/{}/{}  {known}  {error}", place.x, place.y, place.z)?,
        }
    }
    Ok(())
}

fn print_state(state: &StateSnapshot, out: &mut impl Write) -> std::io::Result<()> {
    let model = &state.model;
    let last = state.persistence.last().map_or_else(|| "-".to_owned(), |(_, value)| value.to_string());
    writeln!(
        out,
        "{}  {}  {:.4}  {}  {}  {}  {}  {last}",
        state.name.as_str(),
        state.kind.name(),
        model.spectral().mean(),
        model.choice().name(),
        model.order(),
        model.spectral().components().len(),
        model.accumulator().observations(),
    )
}
