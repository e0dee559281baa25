//! The daemons that can answer each RPC, where daemons share maps. This is the only place that states this.
//!
//! Invariant: each method that a port serves has one row; a test compares the rows with the table of roles.

/// The daemons that can answer the requests of a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The daemon that received the request.
    Anywhere,
    /// Each daemon that holds the map and has not fallen behind.
    Reader,
    /// The daemon that writes the map.
    Writer,
    /// The daemon that has the job.
    Job,
}

/// The methods by path.
const PLACES: &[(&str, Place)] = &[
    ("/grpc.health.v1.Health/Check", Place::Anywhere),
    ("/grpc.health.v1.Health/Watch", Place::Anywhere),
    ("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo", Place::Anywhere),
    ("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo", Place::Anywhere),
    // Each daemon can change the list of maps that they share.
    ("/tidemap.v1.MapService/CreateMap", Place::Anywhere),
    ("/tidemap.v1.MapService/GetMap", Place::Reader),
    // The answer lists the maps that the daemon holds.
    ("/tidemap.v1.MapService/ListMaps", Place::Anywhere),
    ("/tidemap.v1.MapService/DeleteMap", Place::Anywhere),
    ("/tidemap.v1.MapService/AddState", Place::Writer),
    ("/tidemap.v1.MapService/ListStates", Place::Reader),
    ("/tidemap.v1.MapService/SetCharger", Place::Writer),
    ("/tidemap.v1.MapService/SetLocation", Place::Writer),
    ("/tidemap.v1.MapService/DeleteLocation", Place::Writer),
    ("/tidemap.v1.MapService/ListLocations", Place::Reader),
    ("/tidemap.v1.MapService/SetNoGo", Place::Writer),
    ("/tidemap.v1.MapService/DeleteNoGo", Place::Writer),
    ("/tidemap.v1.MapService/ListNoGo", Place::Reader),
    ("/tidemap.v1.ObservationService/Observe", Place::Writer),
    ("/tidemap.v1.ObservationService/Report", Place::Writer),
    // This method may learn from its answer.
    ("/tidemap.v1.ObservationService/ClassifyActivity", Place::Writer),
    ("/tidemap.v1.QueryService/PredictStates", Place::Reader),
    ("/tidemap.v1.QueryService/EvaluateStates", Place::Reader),
    ("/tidemap.v1.QueryService/DescribeModel", Place::Reader),
    ("/tidemap.v1.QueryService/PredictGrid", Place::Reader),
    ("/tidemap.v1.QueryService/Reconstruct", Place::Reader),
    ("/tidemap.v1.QueryService/FindAnomalies", Place::Reader),
    ("/tidemap.v1.QueryService/ListSurprises", Place::Reader),
    ("/tidemap.v1.QueryService/WatchAnomalies", Place::Reader),
    ("/tidemap.v1.QueryService/PredictFlow", Place::Reader),
    ("/tidemap.v1.QueryService/PredictPositions", Place::Reader),
    ("/tidemap.v1.QueryService/PredictAtPlaces", Place::Reader),
    ("/tidemap.v1.QueryService/ListCellAlarms", Place::Reader),
    ("/tidemap.v1.ExplorationService/GetInformation", Place::Reader),
    ("/tidemap.v1.ExplorationService/EvaluateViews", Place::Reader),
    ("/tidemap.v1.ExplorationService/PlanTour", Place::Reader),
    ("/tidemap.v1.ExplorationService/PlanDay", Place::Reader),
    ("/tidemap.v1.ExplorationService/PlanSlot", Place::Reader),
    ("/tidemap.v1.ExplorationService/ReportVisit", Place::Writer),
    ("/tidemap.v1.ExplorationService/ListReachability", Place::Reader),
    ("/tidemap.v1.TaskService/SetTask", Place::Writer),
    ("/tidemap.v1.TaskService/RemoveTask", Place::Writer),
    ("/tidemap.v1.TaskService/ListTasks", Place::Reader),
    ("/tidemap.v1.TaskService/KeepPlan", Place::Writer),
    ("/tidemap.v1.TaskService/GetPlan", Place::Reader),
    ("/tidemap.v1.TaskService/ReportTask", Place::Writer),
    ("/tidemap.v1.TaskService/ListTaskWeeks", Place::Reader),
    ("/tidemap.v1.TopologyService/LoadTopology", Place::Writer),
    ("/tidemap.v1.TopologyService/EditTopology", Place::Writer),
    ("/tidemap.v1.TopologyService/GetTopology", Place::Reader),
    ("/tidemap.v1.TopologyService/ListFailures", Place::Reader),
    ("/tidemap.v1.LandmarkService/AddLandmarks", Place::Writer),
    ("/tidemap.v1.LandmarkService/ListLandmarks", Place::Reader),
    ("/tidemap.v1.LandmarkService/RemoveLandmarks", Place::Writer),
    ("/tidemap.v1.LandmarkService/PredictLandmarks", Place::Reader),
    ("/tidemap.v1.LandmarkService/Localise", Place::Reader),
    ("/tidemap.v1.RouteService/PlanRoute", Place::Reader),
    ("/tidemap.v1.RouteService/PlanPolicy", Place::Reader),
    ("/tidemap.v1.RouteService/PredictEdges", Place::Reader),
    ("/tidemap.v1.SearchService/PlanSearch", Place::Reader),
    ("/tidemap.v1.SearchService/PredictPresence", Place::Reader),
    ("/tidemap.v1.SearchService/NextJoint", Place::Reader),
    ("/tidemap.v1.MaintenanceService/RunUpdate", Place::Writer),
    ("/tidemap.v1.MaintenanceService/GetJob", Place::Job),
    ("/tidemap.v1.MaintenanceService/ListJobs", Place::Anywhere),
    ("/tidemap.v1.MaintenanceService/WatchJob", Place::Job),
    ("/tidemap.v1.MaintenanceService/GetUpdateReport", Place::Job),
    ("/tidemap.v1.MaintenanceService/GetStatistics", Place::Reader),
    // Only the writer knows which producers have open streams.
    ("/tidemap.v1.MaintenanceService/ListProducers", Place::Writer),
    ("/tidemap.v1.MaintenanceService/ForgetProducer", Place::Writer),
    ("/tidemap.v1.MaintenanceService/CreateBackup", Place::Anywhere),
    ("/tidemap.v1.MaintenanceService/Erase", Place::Writer),
    // Each member reports its own state and data.
    ("/tidemap.v1.ClusterService/GetClusterStatus", Place::Anywhere),
    ("/tidemap.v1.ClusterService/MoveMap", Place::Anywhere),
    ("/tidemap.v1.ClusterService/GetLogPoint", Place::Anywhere),
    ("/tidemap.v1.ClusterService/DiscardFork", Place::Anywhere),
    ("/tidemap.v1.ClusterService/ReadFork", Place::Anywhere),
    ("/tidemap.v1.ClusterService/Drain", Place::Anywhere),
    ("/tidemap.v1.ClusterService/ForgetMember", Place::Anywhere),
    ("/tidemap.v1.PeerService/FetchMap", Place::Anywhere),
];

/// The daemons that can answer the requests of a path; a method that does not exist is refused by any daemon.
pub fn place(path: &str) -> Place {
    PLACES.iter().find(|(method, _)| *method == path).map_or(Place::Anywhere, |(_, place)| *place)
}

#[cfg(test)]
mod tests {
    use tidemap_proto::map_of::names_a_map;

    use super::*;
    use crate::access::{
        Role,
        table::{Need, methods, need},
    };

    #[test]
    fn every_method_has_one_row() {
        let rows: Vec<&str> = PLACES.iter().map(|(path, _)| *path).collect();
        let known: Vec<&str> = methods().collect();
        assert_eq!(rows, known, "add these methods to this table, with where they can be served");
    }

    #[test]
    fn a_method_that_depends_on_a_map_names_one() {
        // Members answer for themselves, also where a request names a map.
        for (path, place) in PLACES.iter().filter(|(path, _)| !path.contains(".ClusterService/")) {
            let depends = matches!(place, Place::Reader | Place::Writer);
            assert_eq!(depends, names_a_map(path), "{path}");
        }
    }

    #[test]
    fn what_planners_may_not_do_is_done_by_the_writer() {
        for (path, place) in PLACES.iter().filter(|(_, place)| *place == Place::Reader) {
            let is_for_reading = matches!(need(path), Some(Need::Token | Need::Role(Role::Planner)));
            assert!(is_for_reading, "{path} is no question, and not for {place:?}");
        }
    }
}
