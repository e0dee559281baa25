//! OctoMap's occupancy trees: `.bt` files with free and occupied leaves, and `.ot` files with log-odds; a writer of
//! `.bt` files.
//!
//! A tree is 16 levels deep; its root covers 65536 cells along each side, with the map's origin in the middle. Child i
//! of a node is the upper half along x if bit 0 of i is set, along y with bit 1, along z with bit 2. Numbers are
//! little-endian.
//!
//! - `.bt`: a node is two bytes, two bits for each child, the lowest bits for child 0: 0 unknown, 1 a free leaf, 2 an
//!   occupied leaf, 3 a child with children; then the nodes of those, in order.
//! - `.ot`: a node is its log-odds as float, in a ColorOcTree its colour in three bytes, a byte with a bit for each
//!   child, then the children, in order.
//!
//! Invariant: leaves do not overlap, none is smaller than a cell, and every one has finite log-odds.

#[cfg(test)]
mod tests;
mod write;

use super::{
    CELLS_MAX,
    error::{FilePlace, FormatError, shown_start},
    text::{Line, Lines},
};

pub use write::write;

const BINARY_START: &str = "# Octomap OcTree binary file";
const FULL_START: &str = "# Octomap OcTree file";

/// Levels below the root.
const DEPTH: u32 = 16;
/// Cells from the root's lower corner to the origin.
const CENTRE: i32 = 1 << (DEPTH - 1);

/// Log-odds of a free leaf of a `.bt` file: OctoMap's default clamping threshold.
pub const FREE_LOG_ODDS: f32 = -2.0;
/// Log-odds of an occupied leaf of a `.bt` file.
pub const OCCUPIED_LOG_ODDS: f32 = 3.5;

/// The tree of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct OctoMap {
    /// Length of a cell's side.
    pub resolution_m: f64,
    /// The known parts of space, in the order of the file.
    pub leaves: Vec<Leaf>,
}

/// A cube of cells with one value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leaf {
    /// Index of its lowest cell; the cell (0, 0, 0) has its lower corner at the origin.
    pub min_cell: [i32; 3],
    /// Cells along a side: a power of two.
    pub size_cells: u32,
    /// Whether the leaf is occupied: log-odds of 0 or more.
    pub occupied: bool,
    /// Logarithm of the odds that it is occupied.
    pub log_odds: f32,
}

/// Reads a `.bt` or `.ot` file.
pub fn read(bytes: &[u8]) -> Result<OctoMap, FormatError> {
    let binary = bytes.starts_with(BINARY_START.as_bytes());
    if !binary && !bytes.starts_with(FULL_START.as_bytes()) {
        return Err(FormatError::value(
            FilePlace::Byte(0),
            "the start of the file",
            shown_start(bytes),
            format!("{BINARY_START:?} (.bt) or {FULL_START:?} (.ot)"),
        ));
    }
    let mut lines = Lines::new(bytes);
    let header = header(&mut lines, binary)?;
    let mut reader = TreeReader {
        bytes: lines.rest(),
        at: lines.at(),
        nodes: 0,
        leaves: Vec::new(),
        colour_bytes: header.colour_bytes,
    };
    if header.nodes > 0 {
        reader.nodes = 1;
        if binary {
            reader.binary_node([0; 3], 0)?;
        } else {
            reader.full_node([0; 3], 0)?;
        }
    }
    if !reader.bytes.is_empty() {
        return Err(FormatError::trailing(
            reader.at,
            reader.bytes.len() as u64,
            format!("a tree of {} nodes", reader.nodes),
        ));
    }
    // Like OctoMap, check the size of binary files only.
    if binary && reader.nodes != header.nodes {
        let right = format!("{}, the number of nodes that follow", reader.nodes);
        return Err(FormatError::value(header.nodes_at, "size", header.nodes, right));
    }
    Ok(OctoMap { resolution_m: header.resolution_m, leaves: reader.leaves })
}

struct TreeHeader {
    resolution_m: f64,
    nodes: u64,
    nodes_at: FilePlace,
    colour_bytes: usize,
}

/// Reads the lines of the header, including `data`.
fn header(lines: &mut Lines<'_>, binary: bool) -> Result<TreeHeader, FormatError> {
    let (mut id, mut size, mut resolution): (Option<Line<'_>>, Option<Line<'_>>, Option<Line<'_>>) = (None, None, None);
    let missing = |lines: &Lines<'_>, key| {
        FormatError::missing(FilePlace::Line(lines.number()), key, "the header has id, size, res and, as its end, data")
    };
    loop {
        let line = lines.next_line()?.ok_or_else(|| missing(lines, "data"))?;
        match line.words().next() {
            Some("id") => id = Some(line),
            Some("size") => size = Some(line),
            Some("res") => resolution = Some(line),
            Some("data") => break,
            // Comments, and keys of other versions.
            _ => {}
        }
    }
    let id = id.ok_or_else(|| missing(lines, "id"))?;
    let size = size.ok_or_else(|| missing(lines, "size"))?;
    let resolution = resolution.ok_or_else(|| missing(lines, "res"))?;
    let colour_bytes = match id.words().nth(1) {
        // The nodes of binary files are the same for all kinds of trees.
        Some(_) if binary => 0,
        // Early versions wrote 1.
        Some("OcTree" | "1") => 0,
        Some("ColorOcTree") => 3,
        other => {
            let right = "OcTree or ColorOcTree; other trees can be read as .bt files, which OctoMap makes of them";
            return Err(id.wrong("id", other.unwrap_or_default(), right));
        }
    };
    let nodes = size.parse("size", size.words().nth(1), "the number of nodes")?;
    let word = resolution.words().nth(1);
    let right = "the side of a cell in metres, a positive number";
    let resolution_m: f64 = resolution.parse("res", word, right)?;
    if !(resolution_m.is_finite() && resolution_m > 0.0) {
        return Err(resolution.wrong("res", word.unwrap_or_default(), right));
    }
    Ok(TreeHeader { resolution_m, nodes, nodes_at: size.place(), colour_bytes })
}

/// Reads the nodes of a file; the recursion is as deep as the tree.
struct TreeReader<'a> {
    bytes: &'a [u8],
    at: u64,
    nodes: u64,
    leaves: Vec<Leaf>,
    colour_bytes: usize,
}

impl<'a> TreeReader<'a> {
    fn take<const N: usize>(&mut self, what: &str) -> Result<&'a [u8; N], FormatError> {
        let Some((taken, rest)) = self.bytes.split_first_chunk() else {
            return Err(FormatError::cut_off(self.at, what, N as u64, self.bytes.len() as u64));
        };
        self.bytes = rest;
        self.at += N as u64;
        Ok(taken)
    }

    fn leaf(&mut self, corner: [u32; 3], depth: u32, log_odds: f32) -> Result<(), FormatError> {
        if self.leaves.len() as u64 >= CELLS_MAX {
            let place = FilePlace::Byte(self.at);
            return Err(FormatError::too_many(place, "the number of leaves", CELLS_MAX + 1, CELLS_MAX));
        }
        // Keys are below 65536.
        let min_cell = corner.map(|key| key as i32 - CENTRE);
        let size_cells = 1 << (DEPTH - depth);
        self.leaves.push(Leaf { min_cell, size_cells, occupied: log_odds >= 0.0, log_odds });
        Ok(())
    }

    /// A node with children, in a binary file.
    fn binary_node(&mut self, corner: [u32; 3], depth: u32) -> Result<(), FormatError> {
        let place = FilePlace::Byte(self.at);
        let children = u16::from_le_bytes(*self.take("a node of the tree")?);
        // Only the root of an empty tree has no children.
        if children == 0 && depth > 0 {
            let right = "different from 0: its parent declares that it has children";
            return Err(FormatError::value(place, "a node", children, right));
        }
        let kind = |child: u32| (children >> (2 * child)) & 3;
        for child in 0..8 {
            self.nodes += u64::from(kind(child) != 0);
            match kind(child) {
                1 => self.leaf(child_corner(corner, depth, child), depth + 1, FREE_LOG_ODDS)?,
                2 => self.leaf(child_corner(corner, depth, child), depth + 1, OCCUPIED_LOG_ODDS)?,
                3 if depth + 1 == DEPTH => return Err(too_deep(place)),
                _ => {}
            }
        }
        for child in (0..8).filter(|&child| kind(child) == 3) {
            self.binary_node(child_corner(corner, depth, child), depth + 1)?;
        }
        Ok(())
    }

    /// A node with or without children, in a full file.
    fn full_node(&mut self, corner: [u32; 3], depth: u32) -> Result<(), FormatError> {
        let place = FilePlace::Byte(self.at);
        let log_odds = f32::from_le_bytes(*self.take("a node of the tree")?);
        if !log_odds.is_finite() {
            return Err(FormatError::value(place, "the log-odds of a node", log_odds, "a finite number"));
        }
        for _ in 0..self.colour_bytes {
            self.take::<1>("the colour of a node")?;
        }
        let [children] = *self.take("the children of a node")?;
        if children == 0 {
            return self.leaf(corner, depth, log_odds);
        }
        if depth == DEPTH {
            return Err(too_deep(place));
        }
        for child in (0..8).filter(|&child| children >> child & 1 == 1) {
            self.nodes += 1;
            self.full_node(child_corner(corner, depth, child), depth + 1)?;
        }
        Ok(())
    }
}

fn too_deep(place: FilePlace) -> FormatError {
    FormatError::value(place, "the depth of the tree", format!("more than {DEPTH}"), format!("at most {DEPTH}"))
}

/// The lower corner of a child of a node that is above the lowest level.
fn child_corner(corner: [u32; 3], depth: u32, child: u32) -> [u32; 3] {
    let half = 1 << (DEPTH - 1 - depth);
    [0, 1, 2].map(|axis| corner[axis as usize] + half * ((child >> axis) & 1))
}
