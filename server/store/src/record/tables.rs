//! The tables of a site: data that people and robots enter besides observations, as rows on the disk, and back.
//!
//! A checkpoint, the index and a digest hold the rows of all tables one after another; the log holds edits, each of one
//! table. The code for them iterates over [`TABLES`] and names no single table. Invariant: written rows are read back
//! bit by bit.

use prost::Message;
use tidemap_layout::site as layout;
use tidemap_map::site::{Site, SiteEdit};

use super::Invalid;

mod charger;
pub(super) mod failures;
pub(crate) mod landmarks;
mod locations;
mod no_go;
mod reachability;
pub(crate) mod tasks;
pub(crate) mod topology;

/// A table of a site. A new table gets an implementation in a file of its own, and a row in [`TABLES`].
pub(crate) trait StoredTable {
    /// The number of the table on the disk, which is never given to another table.
    const NUMBER: u32;
    /// A row of the table.
    type Row: Message + Default;
    /// A change of the table; `()` for a table that only observations change.
    type Edit: Message + Default;

    /// The number of rows of this table of a site.
    fn count(site: &Site) -> usize;

    /// The rows of this table of a site, in the order in which [`StoredTable::restore`] takes them.
    fn rows(site: &Site) -> impl Iterator<Item = Self::Row>;

    /// Adds these rows, at least one, to the site. The site already has the tables before this one in [`TABLES`].
    /// `states`: number of states of the map.
    fn restore(site: Site, rows: Vec<Self::Row>, states: usize) -> Result<Site, String>;

    /// Encodes a change of this table; `None` if the edit changes another table.
    fn encode_edit(edit: &SiteEdit) -> Option<Self::Edit>;

    /// Decodes a change from the log.
    fn decode_edit(edit: Self::Edit) -> Result<SiteEdit, Invalid>;
}

/// A [`StoredTable`] as a value.
struct SiteTable {
    number: u32,
    count: fn(&Site) -> usize,
    rows: fn(&Site) -> Box<dyn Iterator<Item = Vec<u8>> + '_>,
    restore: fn(Site, &[layout::TableRow], usize) -> Result<Site, String>,
    encode_edit: fn(&SiteEdit) -> Option<Vec<u8>>,
    decode_edit: fn(&[u8]) -> Result<SiteEdit, Invalid>,
}

impl SiteTable {
    const fn of<T: StoredTable + 'static>() -> SiteTable {
        SiteTable {
            number: T::NUMBER,
            count: T::count,
            rows: |site| Box::new(T::rows(site).map(|row| row.encode_to_vec())),
            restore: |site, rows, states| {
                let row = |row: &layout::TableRow| T::Row::decode(&row.row[..]);
                let rows = rows.iter().map(row).collect::<Result<_, _>>();
                T::restore(site, rows.map_err(|_| format!("a row of table {} is garbled", T::NUMBER))?, states)
            },
            encode_edit: |edit| T::encode_edit(edit).map(|edit| edit.encode_to_vec()),
            decode_edit: |edit| T::decode_edit(T::Edit::decode(edit).map_err(|_| "a change of a table is garbled")?),
        }
    }
}

/// All tables, ascending by number. A new table gets the next number, which is never used again.
const TABLES: [SiteTable; 8] = [
    SiteTable::of::<charger::Charger>(),
    SiteTable::of::<locations::Locations>(),
    SiteTable::of::<no_go::NoGo>(),
    SiteTable::of::<reachability::ReachedCells>(),
    SiteTable::of::<topology::TopologicalMap>(),
    SiteTable::of::<failures::FailedTraversals>(),
    SiteTable::of::<tasks::Tasks>(),
    SiteTable::of::<landmarks::LandmarkPlaces>(),
];

/// The number of rows that [`rows`] returns.
pub(crate) fn count(site: &Site) -> usize {
    TABLES.iter().map(|table| (table.count)(site)).sum()
}

/// The rows of all tables of a site; none for an empty site.
pub(crate) fn rows(site: &Site) -> impl Iterator<Item = layout::TableRow> {
    TABLES.iter().flat_map(move |table| (table.rows)(site).map(|row| layout::TableRow { table: table.number, row }))
}

/// The site of these rows, in a map with `states` states.
pub(crate) fn site(rows: &[layout::TableRow], states: usize) -> Result<Site, String> {
    let mut site = Site::default();
    let mut tables = TABLES.iter();
    for of_table in rows.chunk_by(|one, next| one.table == next.table) {
        let number = of_table.first().map_or(0, |row| row.table);
        let table = tables.find(|table| table.number == number);
        let table = table.ok_or_else(|| format!("rows of table {number}, which is unknown or out of order"))?;
        site = (table.restore)(site, of_table, states)?;
    }
    Ok(site)
}

/// The record of an edit.
pub(super) fn encode_edit(edit: &SiteEdit) -> Result<layout::SiteEdit, Invalid> {
    let encoded = |table: &SiteTable| Some(layout::SiteEdit { table: table.number, edit: (table.encode_edit)(edit)? });
    TABLES.iter().find_map(encoded).ok_or("an edit changes no table that is stored")
}

/// The edit of a record.
pub(super) fn decode_edit(message: &layout::SiteEdit) -> Result<SiteEdit, Invalid> {
    let table = TABLES.iter().find(|table| table.number == message.table);
    (table.ok_or("an edit is of an unknown table")?.decode_edit)(&message.edit)
}

/// Applies an edit while a table is restored.
fn restored(mut site: Site, edit: &SiteEdit, states: usize) -> Result<Site, String> {
    site.apply(edit, states).map_err(|error| error.to_string())?;
    Ok(site)
}

fn encode_position([x_m, y_m]: [f64; 2]) -> layout::Position {
    layout::Position { x_bits: x_m.to_bits(), y_bits: y_m.to_bits() }
}

fn decode_position(message: &layout::Position) -> [f64; 2] {
    [message.x_bits, message.y_bits].map(f64::from_bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_have_ascending_numbers() {
        assert!(TABLES.iter().is_sorted_by(|one, next| one.number < next.number));
    }

    #[test]
    fn rows_of_an_unknown_table_or_out_of_order_are_refused() {
        let mut full = Site::default();
        full.apply(&SiteEdit::Charger(Some([1.0, -0.0])), 0).expect("valid");
        let rows: Vec<_> = rows(&full).collect();
        assert_eq!((rows.len(), count(&full)), (1, 1));
        assert_eq!(site(&rows, 0).as_ref(), Ok(&full));
        let other = layout::TableRow { table: 99, row: Vec::new() };
        assert!(site(&[rows[0].clone(), other], 0).is_err());
        let twice = [rows[0].clone(), layout::TableRow { table: 8, row: Vec::new() }, rows[0].clone()];
        assert!(site(&twice, 0).is_err());
        assert!(decode_edit(&layout::SiteEdit { table: 99, edit: Vec::new() }).is_err());
    }
}
