//! The role that each RPC needs. This is the only place that states this.
//!
//! Invariant: each method that a port serves has one row; a test compares the rows with the descriptors. A method
//! without a row is refused.

use super::Role::{self, Admin, Observer, Operator, Planner};

/// The permission that a method needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// No permission: the method reveals nothing about maps.
    Open,
    /// Any valid token. What the method shows is limited to the token's maps.
    Token,
    /// A token with this role, or one that includes it.
    Role(Role),
    /// A token with this role, or one that includes it, for all maps: the method acts on the daemon as a whole.
    AllMaps(Role),
    /// The secret of the cluster: the method is for the other daemons.
    Peer,
}

const fn role(role: Role) -> Need {
    Need::Role(role)
}

/// The method of streams of observations.
pub const OBSERVE: &str = "/tidemap.v1.ObservationService/Observe";
/// The method that creates maps.
pub const CREATE_MAP: &str = "/tidemap.v1.MapService/CreateMap";

/// The methods by path.
const TABLE: &[(&str, Need)] = &[
    ("/grpc.health.v1.Health/Check", Need::Open),
    ("/grpc.health.v1.Health/Watch", Need::Token),
    ("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo", Need::Token),
    ("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo", Need::Token),
    // Maps and their content. Producers read the settings of a map before they send to it.
    (CREATE_MAP, role(Admin)),
    ("/tidemap.v1.MapService/GetMap", Need::Token),
    ("/tidemap.v1.MapService/ListMaps", Need::Token),
    ("/tidemap.v1.MapService/DeleteMap", role(Admin)),
    ("/tidemap.v1.MapService/AddState", role(Observer)),
    ("/tidemap.v1.MapService/ListStates", Need::Token),
    ("/tidemap.v1.MapService/SetCharger", role(Operator)),
    ("/tidemap.v1.MapService/SetLocation", role(Operator)),
    ("/tidemap.v1.MapService/DeleteLocation", role(Operator)),
    ("/tidemap.v1.MapService/ListLocations", Need::Token),
    ("/tidemap.v1.MapService/SetNoGo", role(Operator)),
    ("/tidemap.v1.MapService/DeleteNoGo", role(Operator)),
    ("/tidemap.v1.MapService/ListNoGo", Need::Token),
    (OBSERVE, role(Observer)),
    ("/tidemap.v1.ObservationService/Report", role(Observer)),
    // A request to learn from the answer needs the observer, too.
    ("/tidemap.v1.ObservationService/ClassifyActivity", role(Planner)),
    ("/tidemap.v1.QueryService/PredictStates", role(Planner)),
    ("/tidemap.v1.QueryService/EvaluateStates", role(Planner)),
    ("/tidemap.v1.QueryService/DescribeModel", role(Planner)),
    ("/tidemap.v1.QueryService/PredictGrid", role(Planner)),
    ("/tidemap.v1.QueryService/Reconstruct", role(Planner)),
    ("/tidemap.v1.QueryService/FindAnomalies", role(Planner)),
    ("/tidemap.v1.QueryService/ListSurprises", role(Planner)),
    ("/tidemap.v1.QueryService/WatchAnomalies", role(Planner)),
    ("/tidemap.v1.QueryService/PredictFlow", role(Planner)),
    ("/tidemap.v1.QueryService/PredictPositions", role(Planner)),
    ("/tidemap.v1.QueryService/PredictAtPlaces", role(Planner)),
    ("/tidemap.v1.QueryService/ListCellAlarms", role(Planner)),
    ("/tidemap.v1.ExplorationService/GetInformation", role(Planner)),
    ("/tidemap.v1.ExplorationService/EvaluateViews", role(Planner)),
    ("/tidemap.v1.ExplorationService/PlanTour", role(Planner)),
    ("/tidemap.v1.ExplorationService/PlanDay", role(Planner)),
    ("/tidemap.v1.ExplorationService/PlanSlot", role(Planner)),
    ("/tidemap.v1.ExplorationService/ReportVisit", role(Observer)),
    ("/tidemap.v1.ExplorationService/ListReachability", role(Planner)),
    ("/tidemap.v1.TaskService/SetTask", role(Operator)),
    ("/tidemap.v1.TaskService/RemoveTask", role(Operator)),
    ("/tidemap.v1.TaskService/ListTasks", role(Planner)),
    ("/tidemap.v1.TaskService/KeepPlan", role(Operator)),
    ("/tidemap.v1.TaskService/GetPlan", role(Planner)),
    ("/tidemap.v1.TaskService/ReportTask", role(Observer)),
    ("/tidemap.v1.TaskService/ListTaskWeeks", role(Planner)),
    ("/tidemap.v1.TopologyService/LoadTopology", role(Operator)),
    ("/tidemap.v1.TopologyService/EditTopology", role(Operator)),
    ("/tidemap.v1.TopologyService/GetTopology", role(Planner)),
    ("/tidemap.v1.TopologyService/ListFailures", role(Planner)),
    ("/tidemap.v1.LandmarkService/AddLandmarks", role(Operator)),
    ("/tidemap.v1.LandmarkService/ListLandmarks", role(Planner)),
    ("/tidemap.v1.LandmarkService/RemoveLandmarks", role(Operator)),
    ("/tidemap.v1.LandmarkService/PredictLandmarks", role(Planner)),
    ("/tidemap.v1.LandmarkService/Localise", role(Planner)),
    ("/tidemap.v1.RouteService/PlanRoute", role(Planner)),
    ("/tidemap.v1.RouteService/PlanPolicy", role(Planner)),
    ("/tidemap.v1.RouteService/PredictEdges", role(Planner)),
    ("/tidemap.v1.SearchService/PlanSearch", role(Planner)),
    ("/tidemap.v1.SearchService/PredictPresence", role(Planner)),
    ("/tidemap.v1.SearchService/NextJoint", role(Planner)),
    // A token does not see jobs of maps that it is not for. Producers of recordings follow the updates of their maps.
    ("/tidemap.v1.MaintenanceService/RunUpdate", role(Operator)),
    ("/tidemap.v1.MaintenanceService/GetJob", Need::Token),
    ("/tidemap.v1.MaintenanceService/ListJobs", Need::Token),
    ("/tidemap.v1.MaintenanceService/WatchJob", Need::Token),
    ("/tidemap.v1.MaintenanceService/GetUpdateReport", Need::Token),
    ("/tidemap.v1.MaintenanceService/GetStatistics", role(Planner)),
    ("/tidemap.v1.MaintenanceService/ListProducers", role(Planner)),
    ("/tidemap.v1.MaintenanceService/ForgetProducer", role(Operator)),
    ("/tidemap.v1.MaintenanceService/CreateBackup", Need::AllMaps(Admin)),
    ("/tidemap.v1.MaintenanceService/Erase", role(Admin)),
    // Maps that the token is not for are not shown.
    ("/tidemap.v1.ClusterService/GetClusterStatus", role(Planner)),
    ("/tidemap.v1.ClusterService/MoveMap", role(Admin)),
    ("/tidemap.v1.ClusterService/GetLogPoint", role(Planner)),
    ("/tidemap.v1.ClusterService/DiscardFork", role(Admin)),
    ("/tidemap.v1.ClusterService/ReadFork", role(Admin)),
    ("/tidemap.v1.ClusterService/Drain", Need::AllMaps(Admin)),
    ("/tidemap.v1.ClusterService/ForgetMember", Need::AllMaps(Admin)),
    ("/tidemap.v1.PeerService/FetchMap", Need::Peer),
];

/// The permission that the method of a path needs; `None` if there is no such method.
pub fn need(path: &str) -> Option<Need> {
    TABLE.iter().find(|(method, _)| *method == path).map(|(_, need)| *need)
}

/// All methods.
pub fn methods() -> impl Iterator<Item = &'static str> {
    TABLE.iter().map(|(method, _)| *method)
}

/// The method of a path for metrics: its name from the table, so that the number of names is bounded.
pub fn method_name(path: &str) -> &'static str {
    TABLE.iter().find(|(method, _)| *method == path).map_or("unknown", |(method, _)| method)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use prost::Message as _;
    use prost_types::FileDescriptorSet;

    use super::*;

    /// The paths of all methods that a port serves, from the descriptors of its services.
    fn served() -> BTreeSet<String> {
        let sets = [
            tidemap_proto::v1::DESCRIPTORS,
            tonic_health::pb::FILE_DESCRIPTOR_SET,
            tonic_reflection::pb::v1::FILE_DESCRIPTOR_SET,
            tonic_reflection::pb::v1alpha::FILE_DESCRIPTOR_SET,
        ];
        let mut paths = BTreeSet::new();
        for set in sets {
            for file in FileDescriptorSet::decode(set).expect("descriptors").file {
                for service in &file.service {
                    for method in &service.method {
                        paths.insert(format!("/{}.{}/{}", file.package(), service.name(), method.name()));
                    }
                }
            }
        }
        paths
    }

    #[test]
    fn every_method_has_one_row_and_every_row_a_method() {
        let rows: BTreeSet<String> = TABLE.iter().map(|(path, _)| (*path).to_owned()).collect();
        assert_eq!(rows.len(), TABLE.len(), "no method has two rows");
        let served = served();
        let missing: Vec<&String> = served.difference(&rows).collect();
        assert!(missing.is_empty(), "add these methods to this table, with the role that they need: {missing:?}");
        let rest: Vec<&String> = rows.difference(&served).collect();
        assert!(rest.is_empty(), "these methods are gone: {rest:?}");
        assert!(served.len() > 40, "{served:?}");
    }

    /// Methods whose requests name no map, and which show or change only the data of the token's maps.
    const LIMITED_TO_MAPS: [&str; 9] = [
        "ListMaps",
        "Observe",        // its Hello names the map
        "EvaluateStates", // its first message names the map
        "GetJob",
        "ListJobs",
        "WatchJob",
        "GetUpdateReport",
        "GetStatistics", // without a map it needs all
        "GetClusterStatus",
    ];

    #[test]
    fn what_acts_on_the_whole_daemon_needs_all_maps() {
        let set = FileDescriptorSet::decode(tidemap_proto::v1::DESCRIPTORS).expect("descriptors");
        let messages: Vec<_> = set.file.iter().flat_map(|file| &file.message_type).collect();
        let mut of_daemon = Vec::new();
        for service in set.file.iter().flat_map(|file| &file.service) {
            for method in &service.method {
                let name = method.input_type().rsplit('.').next().unwrap_or_default();
                let request = messages.iter().find(|message| message.name() == name).expect("a request");
                let is_map = |field: &str| field == "map" || (field == "name" && method.name().ends_with("Map"));
                let names_a_map = request.field.iter().any(|field| is_map(field.name()));
                let path = format!("/tidemap.v1.{}/{}", service.name(), method.name());
                let is_for_peers = need(&path) == Some(Need::Peer);
                if !LIMITED_TO_MAPS.contains(&method.name()) && !names_a_map && !is_for_peers {
                    of_daemon.push(path);
                }
            }
        }
        let needing: Vec<String> =
            TABLE.iter().filter(|(_, need)| matches!(need, Need::AllMaps(_))).map(|(path, _)| (*path).into()).collect();
        assert_eq!(of_daemon, needing, "a method that names no map needs a token for all maps");
        assert!(needing.contains(&"/tidemap.v1.MaintenanceService/CreateBackup".to_owned()));
    }

    #[test]
    fn only_health_is_open() {
        let open: Vec<&str> = TABLE.iter().filter(|(_, need)| *need == Need::Open).map(|(path, _)| *path).collect();
        assert_eq!(open, ["/grpc.health.v1.Health/Check"]);
        assert_eq!(need("/tidemap.v1.MapService/Elsewhere"), None);
    }
}
