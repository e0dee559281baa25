//! The learned data of a tile: its models and its sums, as records, and back.
//!
//! Sums are by far the largest part, so they are copied in bulk. Invariant: every number is read back bit by bit;
//! a value that is read has passed the constructors of the model.

use std::sync::Arc;

use prost::Message as _;
use tidemap_grid::{
    fade::GroupFade,
    mask::Mask,
    observation_runs::ObservationRuns,
    observed_times::ObservedTimes,
    scan::ScanSource,
    sensor_sums::{SensorSums, SensorWeights, WeightedSums},
    sensors::Weights,
    standing::Standing,
    tile::{CellModel, Group, TileModel, TileSums},
};
use tidemap_layout::grid as layout;
use tidemap_model::{
    Component, HoursSeen, InvalidParts, LocalDay, ORDER_MAX, OrderErrors, OrderErrorsParts, OrderWatch, Periodicities,
    PhasorSum, SpectralModel,
};

use super::{
    Invalid, cell_watch,
    cells::{decode_mask, encode_mask, place},
    doubles, observation_runs, sources,
};

/// Bytes of a component.
const COMPONENT: usize = 20;
const SIGHTINGS: Invalid = "the observation times of a tile differ in number from its groups or cells";
/// The number in place of a shared sum that does not exist.
const NO_SUM: u32 = u32::MAX;
/// Flag in the number of changed cells: weighted sums follow.
const HAS_WEIGHTED: u32 = 1 << 31;

pub(crate) fn encode(model: &TileModel) -> layout::TileModel {
    let group = |(index, group): (usize, &Group)| {
        let weights = model.sensors.as_ref().map(|_| model.weights(index));
        let fade = model.sensors.as_ref().and_then(|sensors| sensors.fades.get(index));
        layout::Group {
            cells: encode_mask(group.cells),
            observations: group.observations,
            first_nanos: group.first_nanos,
            last_nanos: group.last_nanos,
            seen: if group.seen == HoursSeen::default() { Vec::new() } else { group.seen.to_bytes() },
            alpha_bits: weights.map(|weights| weights.alpha.to_bits()),
            beta_bits: weights.map(|weights| weights.beta.to_bits()),
            weight_bits: fade.map(|fade| fade.weight.to_bits()),
            day: fade.map(|fade| fade.day.0),
            sum_day: fade.map(|fade| fade.sum_day.0),
        }
    };
    let weight = |cell: usize| model.sensors.as_ref().map(|_| model.occupied_weight(cell).to_bits());
    layout::TileModel {
        groups: model.groups.iter().enumerate().map(group).collect(),
        always_occupied: encode_mask(model.always_occupied),
        cells: model.cells.iter().enumerate().map(|(at, cell)| encode_cell(cell, weight(at))).collect(),
    }
}

fn encode_cell(cell: &CellModel, occupied_weight_bits: Option<u64>) -> layout::Cell {
    let errors = cell.errors.to_parts();
    let mut components = Vec::with_capacity(cell.spectral.components().len() * COMPONENT);
    for component in cell.spectral.components() {
        components.extend(component.periodicity.to_le_bytes());
        components.extend(component.gamma_re.to_le_bytes());
        components.extend(component.gamma_im.to_le_bytes());
    }
    let mut error_sums = Vec::new();
    doubles::push(&mut error_sums, &errors.sums);
    layout::Cell {
        cell: u32::from(cell.cell),
        occupied: cell.occupied,
        mean_bits: cell.spectral.mean().to_bits(),
        observations: cell.spectral.observations(),
        components,
        order: u32::from(cell.order),
        error_sums,
        errors_last_day: errors.last_day.map(|day| day.0),
        occupied_weight_bits,
        alarm_day: cell.alarm_day.map(|day| day.0),
    }
}

pub(crate) fn decode(message: &layout::TileModel, periodicities: &Periodicities) -> Result<TileModel, String> {
    let mut observed = Mask::EMPTY;
    let mut groups = Vec::with_capacity(message.groups.len());
    for group in &message.groups {
        let cells = decode_mask(&group.cells)?;
        if !(observed & cells).is_empty() {
            return Err("a cell is in two observation groups".to_owned());
        }
        observed |= cells;
        let layout::Group { observations, first_nanos, last_nanos, .. } = *group;
        let seen = match group.seen.as_slice() {
            [] => HoursSeen::default(),
            bytes => HoursSeen::from_bytes(bytes).ok_or("the hours at which a group was observed are not 48")?,
        };
        groups.push(Group { cells, observations, first_nanos, last_nanos, seen });
    }
    let cells = message.cells.iter().map(|cell| decode_cell(cell, periodicities));
    let cells = cells.collect::<Result<Vec<_>, _>>()?;
    if !cells.is_sorted_by(|one, next| one.cell < next.cell) || cells.iter().any(|cell| !observed.contains(cell.cell)) {
        return Err("the changed cells of a tile are out of order or were never observed".to_owned());
    }
    let sensors = decode_weights(message)?.map(Box::new);
    Ok(TileModel { groups, always_occupied: decode_mask(&message.always_occupied)?, cells, sensors })
}

/// Decodes the weights of readings; `None` if all readings are of the sensor of the map.
fn decode_weights(message: &layout::TileModel) -> Result<Option<SensorWeights>, Invalid> {
    const PARTLY: Invalid = "the weights of readings are missing for some groups or cells of a tile, or are not finite";
    let parts = || {
        let groups = message.groups.iter().flat_map(|group| [group.alpha_bits, group.beta_bits]);
        groups.chain(message.cells.iter().map(|cell| cell.occupied_weight_bits))
    };
    if parts().all(|part| part.is_none()) {
        return Ok(None);
    }
    let number = |bits: Option<u64>| bits.map(f64::from_bits).filter(|number| number.is_finite()).ok_or(PARTLY);
    let group =
        |group: &layout::Group| Ok(Weights { alpha: number(group.alpha_bits)?, beta: number(group.beta_bits)? });
    Ok(Some(SensorWeights {
        groups: message.groups.iter().map(group).collect::<Result<_, Invalid>>()?,
        occupied: message.cells.iter().map(|cell| number(cell.occupied_weight_bits)).collect::<Result<_, _>>()?,
        fades: decode_fades(message)?,
    }))
}

/// Decodes the fading of the groups; empty without a half-life.
fn decode_fades(message: &layout::TileModel) -> Result<Vec<GroupFade>, Invalid> {
    if message.groups.iter().all(|group| (group.weight_bits, group.day, group.sum_day) == (None, None, None)) {
        return Ok(Vec::new());
    }
    let fade = |group: &layout::Group| {
        let weight = group.weight_bits.map(f64::from_bits).filter(|weight| (0.0..=f64::MAX).contains(weight))?;
        Some(GroupFade { weight, day: LocalDay(group.day?), sum_day: LocalDay(group.sum_day?) })
    };
    let fades: Option<Vec<GroupFade>> = message.groups.iter().map(fade).collect();
    fades.ok_or("the fading is missing for some groups of a tile, or a weight is not a number from 0 up")
}

fn decode_cell(message: &layout::Cell, periodicities: &Periodicities) -> Result<CellModel, String> {
    let invalid = |error: InvalidParts| error.to_string();
    let (components, rest) = message.components.as_chunks::<COMPONENT>();
    let components: Vec<Component> = components.iter().map(decode_component).collect();
    if !rest.is_empty() || components.iter().any(|part| part.periodicity as usize >= periodicities.len()) {
        return Err("the components of a cell are not valid".to_owned());
    }
    let mut sums = Vec::with_capacity(ORDER_MAX + 1);
    doubles::take(&message.error_sums, &mut sums);
    let errors = OrderErrorsParts {
        sums: sums.try_into().map_err(|_| "the sums of errors are not 16")?,
        last_day: message.errors_last_day.map(LocalDay),
    };
    let order = u8::try_from(message.order).ok().filter(|&order| usize::from(order) <= ORDER_MAX);
    Ok(CellModel {
        cell: place(message.cell)?,
        occupied: message.occupied,
        spectral: SpectralModel::from_parts(f64::from_bits(message.mean_bits), message.observations, components)
            .map_err(invalid)?,
        order: order.ok_or("the order of a cell is too high")?,
        errors: OrderErrors::from_parts(errors).map_err(invalid)?,
        alarm_day: message.alarm_day.map(LocalDay),
    })
}

fn decode_component(bytes: &[u8; COMPONENT]) -> Component {
    let eight = |from: usize| bytes[from..from + 8].try_into().map_or(f64::NAN, f64::from_le_bytes);
    let periodicity = bytes[..4].try_into().map_or(u32::MAX, u32::from_le_bytes);
    Component { periodicity, gamma_re: eight(4), gamma_im: eight(12) }
}

/// Encodes the sums of a tile as bytes: the number of sums, the shared sums, the weighted sums, the sums of the changed
/// cells, and the observation times of the cells. `shared`: the numbers of the shared sums of the tile, in order.
pub(crate) fn encode_sums(shared: &[u32], sums: &TileSums, out: &mut Vec<u8>) -> Result<(), Invalid> {
    if shared.len() < sums.groups.len() {
        return Err("a shared sum has no number");
    }
    if (sums.times.len(), sums.watches.len()) != (sums.groups.len(), sums.cells.len()) {
        return Err(SIGHTINGS);
    }
    let has_weighted = sums.sensors.as_ref().map(|sensors| sensors.groups.iter().map(Option::is_some));
    push_head(out, shared, sums.groups.len(), sums.cells.len(), has_weighted);
    for cell in &sums.cells {
        doubles::push(out, cell.as_slice());
    }
    let sightings = layout::Sightings {
        days: observation_runs::encode(&sums.runs)?,
        times: sums.times.iter().map(|times| cell_watch::encode_times(times)).collect(),
        watches: sums.watches.iter().map(cell_watch::encode_watch).collect(),
        standing: sums.standing.sources().iter().map(encode_standing).collect(),
    };
    let message = sightings.encode_to_vec();
    let length = u32::try_from(message.len()).map_err(|_| "the runs of a tile are too many")?;
    out.extend(length.to_le_bytes());
    out.extend(message);
    Ok(())
}

fn encode_standing(&(source, cells): &(ScanSource, Mask)) -> layout::Standing {
    layout::Standing { source: sources::number(source), cells: encode_mask(cells) }
}

fn decode_standing(message: &layout::Standing) -> Result<(ScanSource, Mask), Invalid> {
    Ok((sources::source(message.source)?, decode_mask(&message.cells)?))
}

/// Appends the number of sums, and the numbers of the shared sums.
fn push_head(
    out: &mut Vec<u8>,
    shared: &[u32],
    groups: usize,
    cells: usize,
    has_weighted: Option<impl Iterator<Item = bool>>,
) {
    let (groups, weighted) = shared.split_at(groups.min(shared.len()));
    out.clear();
    // A tile has at most 512 of each.
    out.extend((groups.len() as u32).to_le_bytes());
    out.extend((cells as u32 | if has_weighted.is_some() { HAS_WEIGHTED } else { 0 }).to_le_bytes());
    out.extend(groups.iter().flat_map(|shared| shared.to_le_bytes()));
    let mut numbers = weighted.as_chunks::<2>().0.iter();
    for has_weighted in has_weighted.into_iter().flatten() {
        let pair = if has_weighted { numbers.next().copied() } else { None }.unwrap_or([NO_SUM; 2]);
        out.extend(pair.iter().flat_map(|number| number.to_le_bytes()));
    }
}

/// The sums of a tile as bytes.
pub(crate) struct EncodedSums<'bytes> {
    /// Numbers of the shared sums of the tile: one for each group, then two for each group that has weighted sums.
    pub(crate) shared: Vec<u32>,
    /// Number of groups.
    pub(crate) groups: usize,
    /// Whether each group has weighted sums; `None` if none has.
    weighted: Option<Vec<bool>>,
    /// Sums of the changed cells.
    cells: &'bytes [u8],
    /// Observation times of the cells.
    sightings: Sightings,
    /// The message of `sightings` as bytes, with its length before it.
    sightings_bytes: &'bytes [u8],
}

/// The observation times of the cells of a tile, the support and change alarm of each changed cell, and the cells that
/// each source of scans last read as occupied.
#[derive(Clone)]
struct Sightings {
    runs: ObservationRuns,
    times: Vec<Arc<ObservedTimes>>,
    watches: Vec<OrderWatch>,
    standing: Standing,
}

impl Sightings {
    /// Decodes the observation times of a tile with this number of groups and of changed cells.
    fn decode(bytes: &[u8], groups: usize, cells: usize) -> Result<Sightings, Invalid> {
        let message = layout::Sightings::decode(bytes).map_err(|_| "the runs of a tile are not a message")?;
        if (message.times.len(), message.watches.len()) != (groups, cells) {
            return Err(SIGHTINGS);
        }
        Ok(Sightings {
            runs: observation_runs::decode(&message.days)?,
            times: message.times.iter().map(cell_watch::decode_times).collect::<Result<_, _>>()?,
            watches: message.watches.iter().map(cell_watch::decode_watch).collect::<Result<_, _>>()?,
            standing: Standing::from_sources(message.standing.iter().map(decode_standing).collect::<Result<_, _>>()?)
                .map_err(|_| "the sources of a tile do not ascend, or one has no cell")?,
        })
    }
}

impl EncodedSums<'_> {
    /// Checks the lengths and every number.
    pub(crate) fn new<'bytes>(
        bytes: &'bytes [u8],
        periodicities: &Periodicities,
    ) -> Result<EncodedSums<'bytes>, Invalid> {
        const LENGTH: Invalid = "the sums of a tile do not have their length";
        let (counts, rest) = bytes.split_first_chunk::<8>().ok_or(LENGTH)?;
        let number = |bytes: [u8; 4]| u32::from_le_bytes(bytes) as usize;
        let (groups, changed) =
            (number(counts.as_chunks::<4>().0[0]), u32::from_le_bytes(counts.as_chunks::<4>().0[1]));
        let (changed, has_weighted) = ((changed & !HAS_WEIGHTED) as usize, changed & HAS_WEIGHTED != 0);
        let fits = |length: Option<usize>, rest: &[u8]| length.filter(|&length| length <= rest.len()).ok_or(LENGTH);
        let (shared, rest) = rest.split_at(fits(groups.checked_mul(4), rest)?);
        let pairs = if has_weighted { groups } else { 0 };
        let (pairs, rest) = rest.split_at(fits(pairs.checked_mul(8), rest)?);
        let (cells, sightings_bytes) = rest.split_at(fits(changed.checked_mul(16 * periodicities.len()), rest)?);
        let sightings = match sightings_bytes.split_first_chunk::<4>() {
            Some((&length, message)) if number(length) == message.len() => Sightings::decode(message, groups, changed)?,
            _ => return Err(LENGTH),
        };
        if !doubles::are_finite(cells) {
            return Err("a sum is not finite");
        }
        let numbers = |bytes: &[u8]| -> Vec<u32> {
            bytes.as_chunks::<4>().0.iter().map(|&four| u32::from_le_bytes(four)).collect()
        };
        let (mut shared, pairs) = (numbers(shared), numbers(pairs));
        let (pairs, _) = pairs.as_chunks::<2>();
        if pairs.iter().any(|pair| pair.contains(&NO_SUM) && *pair != [NO_SUM; 2]) {
            return Err("a group has one weighted sum without the other");
        }
        let weighted = has_weighted.then(|| pairs.iter().map(|pair| !pair.contains(&NO_SUM)).collect());
        shared.extend(pairs.as_flattened().iter().filter(|&&number| number != NO_SUM));
        Ok(EncodedSums { shared, groups, weighted, cells, sightings, sightings_bytes })
    }

    /// Number of changed cells.
    pub(crate) fn cells(&self, periodicities: &Periodicities) -> usize {
        self.cells.len() / (16 * periodicities.len()).max(1)
    }

    /// Decodes the sums. `groups`: the shared sums, in the order of [`EncodedSums::shared`].
    pub(crate) fn decode(
        &self,
        mut groups: Vec<Arc<PhasorSum>>,
        periodicities: &Periodicities,
    ) -> Result<TileSums, InvalidParts> {
        let mut numbers = Vec::with_capacity(2 * periodicities.len());
        let cells = self.cells.chunks_exact(16 * periodicities.len().max(1)).map(|bytes| {
            doubles::take(bytes, &mut numbers);
            PhasorSum::from_slice(periodicities, &numbers)
        });
        let mut weighted = groups.split_off(groups.len().min(self.groups)).into_iter();
        let mut next = |has_weighted: &bool| {
            let pair = if *has_weighted { weighted.next().zip(weighted.next()) } else { None };
            pair.map(|(alpha, beta)| WeightedSums { alpha, beta })
        };
        let sensors = self.weighted.as_ref();
        let sensors = sensors.map(|known| Box::new(SensorSums { groups: known.iter().map(&mut next).collect() }));
        let cells = cells.collect::<Result<_, _>>()?;
        let Sightings { runs, times, watches, standing } = self.sightings.clone();
        Ok(TileSums { groups, cells, runs, times, watches, standing, sensors })
    }

    /// Writes these sums again, with other numbers for the shared sums.
    pub(crate) fn encode_again(&self, shared: &[u32], periodicities: &Periodicities, out: &mut Vec<u8>) {
        let has_weighted = self.weighted.as_ref().map(|weighted| weighted.iter().copied());
        push_head(out, shared, self.groups, self.cells(periodicities), has_weighted);
        out.extend_from_slice(self.cells);
        out.extend_from_slice(self.sightings_bytes);
    }
}

/// Decodes a shared sum.
pub(crate) fn decode_shared(bytes: &[u8], periodicities: &Periodicities) -> Result<PhasorSum, String> {
    if !bytes.len().is_multiple_of(8) {
        return Err("a shared sum does not have its length".to_owned());
    }
    let mut numbers = Vec::new();
    doubles::take(bytes, &mut numbers);
    PhasorSum::from_slice(periodicities, &numbers).map_err(|error| error.to_string())
}
