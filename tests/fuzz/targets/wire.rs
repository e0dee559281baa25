//! Requests of the wire: counted while they are encoded, decoded, and converted to the domain, as the daemon does it.
//! The first byte selects the kind of the request.
#![no_main]

use prost::Message;
use tidemap_grid::spec::GridSpec;
use tidemap_proto::{
    bounds,
    convert::{
        anomaly, cells, columns, exploration, map, query, reports, route,
        scans::{ScanDecoder, ScanLimits, scans_from_wire},
        search, site, topology, vectors,
    },
    v1,
};

/// The request, if its elements may be decoded.
fn decode<M: Message + Default>(name: &str, bytes: &[u8]) -> Option<M> {
    bounds::check(name, bytes).ok()?;
    M::decode(bytes).ok()
}

fn observe(request: v1::ObserveRequest) {
    use v1::observe_request::Message as Up;
    match request.message {
        Some(Up::Batch(batch)) => {
            if let Some(observations) = batch.observations {
                let _ = vectors::new_shapes(&observations);
                let _ = columns::decode(observations);
            }
        }
        Some(Up::Scans(batch)) => {
            let limits = ScanLimits { batch_scans: 64, points: 10_000, tiles: 1_000 };
            let mut decoder = ScanDecoder::new(Some(&GridSpec::new(0.1)), limits);
            if scans_from_wire(batch).is_ok_and(|message| decoder.begin(message).is_ok()) {
                while let Ok(Some(_)) = decoder.next_scan() {}
            }
        }
        Some(Up::Reports(batch)) => drop(reports::reports_from_wire(&batch)),
        Some(Up::Hello(_) | Up::Alive(_)) | None => {}
    }
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((first, bytes)) = bytes.split_first() else { return };
    match first % 12 {
        0..=3 => drop(decode("ObserveRequest", bytes).map(observe)),
        4 => drop(decode("CreateMapRequest", bytes).map(|request| map::spec_from_request(request, 0))),
        5 => {
            drop(decode::<v1::LoadTopologyRequest>("LoadTopologyRequest", bytes).map(|r| topology::load_from_wire(&r)))
        }
        6 => drop(
            decode::<v1::PlanTourRequest>("PlanTourRequest", bytes).map(|r| exploration::tour_question_from_wire(&r)),
        ),
        7 => drop(decode::<v1::PlanRouteRequest>("PlanRouteRequest", bytes).map(|r| route::route_from_wire(&r))),
        8 => drop(decode::<v1::PlanSearchRequest>("PlanSearchRequest", bytes).map(|r| search::search_from_wire(&r))),
        9 => drop(decode::<v1::PredictGridRequest>("PredictGridRequest", bytes).map(|r| cells::question_from_wire(&r))),
        10 => drop(decode::<v1::PredictStatesRequest>("PredictStatesRequest", bytes).map(|r| {
            let _ = anomaly::judge_from_wire("model", r.model);
            query::states_from_wire(r)
        })),
        _ => drop(decode::<v1::Point>("Point", bytes).map(|point| site::point_from_wire("point", point))),
    }
});
