//! The meaning of each metric, for `/metrics`, and the counters that exist before their first event.
//!
//! Invariant: every metric has a line here; a test compares a running daemon's metrics with these lines. A counter
//! begins at 0: a counter that appears at 1 has no increase, and no alert rings for its first event.

use metrics::{Unit, counter, describe_counter, describe_gauge, describe_histogram, histogram};

use crate::access::table;

/// Counters that only grow, since the start of the daemon.
const COUNTERS: &[(&str, &str)] = &[
    ("tidemap_observations_total", "Observations acknowledged"),
    ("tidemap_scans_total", "Scans acknowledged"),
    ("tidemap_refused_total", "Observations and scans refused"),
    ("tidemap_updates_total", "Updates published"),
    ("tidemap_update_failures_total", "Updates that failed"),
    ("tidemap_save_failures_total", "Checkpoints that could not be saved; each save is tried again"),
    ("tidemap_requests_total", "Requests that ended, by method and gRPC code; streams of observations are not counted"),
    ("tidemap_requests_refused", "Requests refused because too many were under way, or waited to be computed"),
    ("tidemap_data_mismatches_total", "Streams that ended because a producer sent other content under a known number"),
    ("tidemap_denied_total", "Requests refused for lack of a token, role or map, by reason"),
    ("tidemap_foreign_requests_total", "HTTP requests refused because a page of another origin sent them"),
    ("tidemap_revoked_requests_total", "Requests that ended because their token was revoked"),
    ("tidemap_reloads_total", "Files of tokens or certificates that were read again, by kind"),
    ("tidemap_reload_failures_total", "Files of tokens or certificates that could not be read again, by kind"),
    ("tidemap_model_cache_hits_total", "Requests for trained models that the cache answered"),
    ("tidemap_model_cache_misses_total", "Requests for models that had to be trained"),
    ("tidemap_connections_displaced", "Connections that made room for others, by port"),
    ("tidemap_streams_displaced_total", "Streams of observations that were silent and made room for others"),
    (
        "tidemap_connections_refused",
        "Connections refused because all others were busy, by port; those of the HTTP port come into its reserve",
    ),
    ("tidemap_connections_silent", "Connections that made no request in time, by port"),
    (
        "tidemap_replies_ended_total",
        "Replies of the HTTP port that were not read: ended after a time, ended to make room, or refused, by reason",
    ),
    ("tidemap_accept_errors", "Failures to accept a connection, such as a lack of descriptors"),
    ("tidemap_tls_handshakes_failed_total", "TLS handshakes that failed, for example of clients without a certificate"),
    ("tidemap_backups_total", "Backups made, scheduled or requested"),
    ("tidemap_backup_failures_total", "Backups that failed, scheduled or requested"),
    (
        "tidemap_cluster_digests_equal_total",
        "Updates that have made the same bits as the writer's; only of maps whose log daemons share",
    ),
    (
        "tidemap_cluster_divergence_total",
        "Updates that have made other bits than the writer's; only of maps whose log daemons share",
    ),
    (
        "tidemap_cluster_forks_total",
        "Forks set aside, without those of one group; only of maps whose log daemons share",
    ),
    (
        "tidemap_cluster_healed_records_total",
        "Records appended to a shared log again, because the engine had lost them",
    ),
    ("tidemap_cluster_takeovers_total", "Times that this daemon began to write a map whose log daemons share"),
    (
        "tidemap_cluster_depositions_total",
        "Times that this daemon ceased to write a map: it handed the map over, or could not renew its lease in time",
    ),
    ("tidemap_cluster_passed_requests_total", "Requests passed on to the daemon that writes the map"),
    (
        "tidemap_cluster_pass_failures_total",
        "Requests that could not be passed on: the writer was not known, did not respond, or was lost meanwhile",
    ),
    ("tidemap_spans_exported_total", "Spans that the collector of traces has accepted; with otlp_endpoint only"),
    (
        "tidemap_spans_dropped_total",
        "Spans dropped because the collector did not accept them in time; with otlp_endpoint only",
    ),
];

/// Counters with a label, and the values of the label that are known before an event.
const LABELLED: &[(&str, &str, &[&str])] = &[
    (
        "tidemap_denied_total",
        "reason",
        &[
            "NO_TOKEN",
            "UNKNOWN_TOKEN",
            "EXPIRED_TOKEN",
            "NEEDS_ROLE",
            "NEEDS_ALL_MAPS",
            "NOT_FOR_MAP",
            "NOT_FOR_PRODUCER",
            "READ_ONLY",
            "UNKNOWN_METHOD",
        ],
    ),
    ("tidemap_reloads_total", "what", &["tokens", "certificates"]),
    ("tidemap_reload_failures_total", "what", &["tokens", "certificates"]),
    ("tidemap_replies_ended_total", "reason", &["unread", "room", "refused"]),
    ("tidemap_connections_displaced", "port", &["grpc", "http", "probes", "imports"]),
    ("tidemap_connections_refused", "port", &["grpc", "http", "probes", "imports"]),
    ("tidemap_connections_silent", "port", &["grpc", "http", "probes", "imports"]),
];

/// Codes of requests that are counted from 0 on: success, and the codes for faults of the daemon.
const CODES: [&str; 5] = ["OK", "INTERNAL", "DATA_LOSS", "UNKNOWN", "UNAVAILABLE"];

/// This metric is written by its own module, because its labels come and go.
pub const PRODUCER_SILENT: &str = "tidemap_producer_silent_seconds";

/// Values that go up and down.
const GAUGES: &[(&str, &str)] = &[
    (
        "tidemap_connections",
        "Open connections, by port: grpc, http, probes, the reserve of the HTTP port, or imports of recordings",
    ),
    ("tidemap_streams", "Open streams of observations"),
    ("tidemap_requests", "Requests under way"),
    ("tidemap_computing_requests", "Requests that compute now"),
    ("tidemap_tokens", "Tokens of the file, expired ones included"),
    (
        "tidemap_certificate_expiry_seconds",
        "Time at which the daemon's certificate ends, seconds since 1970; with TLS only",
    ),
    ("tidemap_maps", "Maps"),
    ("tidemap_maps_unavailable", "Maps that are set aside because their files are damaged"),
    ("tidemap_damaged_files", "Files that a start or the background check found damaged or missing"),
    ("tidemap_lists_lost", "Lists of what must exist that are lost; what they cover is refused"),
    ("tidemap_losses_accepted", "Losses that were accepted with tidemapd check --accept-loss"),
    ("tidemap_maps_not_saved", "Maps whose last checkpoint could not be saved"),
    ("tidemap_states", "Named states of all maps"),
    ("tidemap_observations", "Observations of all maps"),
    ("tidemap_pending_observations", "Observations that no update has learned yet"),
    (
        "tidemap_generation_age_seconds",
        "Time since the cut of the last update, of the map where it is longest; 0 without maps that have pending observations",
    ),
    ("tidemap_jobs_running", "Updates that run"),
    ("tidemap_jobs_waiting", "Updates that wait for another of the same map"),
    ("tidemap_updates_waiting_turn", "Updates that wait for their turn among those of other maps"),
    (
        "tidemap_waiting_rows",
        "Rows of changes or events that an update has left to the next, because they mean too many readings",
    ),
    ("tidemap_job_progress_ratio", "Progress of the running update with the least progress, 0 to 1; 1 if none runs"),
    ("tidemap_log_bytes", "Size of the logs"),
    ("tidemap_checkpoint_bytes", "Size of the checkpoints"),
    ("tidemap_disk_full", "1 if the disk was full recently"),
    ("tidemap_disk_free_bytes", "Free space of the disk with the data folder"),
    ("tidemap_disk_size_bytes", "Size of the disk with the data folder"),
    ("tidemap_index_unavailable", "1 if the index cannot be used; everything else works"),
    (
        "tidemap_backup_age_seconds",
        "Age of the newest complete scheduled backup, +Inf if there is none; with a schedule",
    ),
    ("tidemap_backup_interval_seconds", "Time from one scheduled backup to the next; with a schedule"),
    (
        "tidemap_producer_silent_seconds",
        "Time since the last message of a producer, of those that sent within 7 days and are silent for longest",
    ),
    (
        "tidemap_cluster_maps",
        "Maps of the cluster that this daemon holds, or whose writer it knows; 0 without a cluster",
    ),
    ("tidemap_cluster_maps_written", "Maps of the cluster that this daemon writes"),
    ("tidemap_cluster_maps_followed", "Maps of the cluster that this daemon holds and does not write"),
    (
        "tidemap_cluster_replicas_in_trouble",
        "Maps of the cluster that this daemon holds and that `tidemap cluster status` lists as in trouble on it",
    ),
    (
        "tidemap_cluster_lag_records",
        "Records of a shared log that this daemon knows of and does not have yet, of the map where they are the most",
    ),
    (
        "tidemap_cluster_heard_age_seconds",
        "Time since this daemon received the end of a shared log, of the map where it is longest; +Inf if it never did",
    ),
    ("tidemap_cluster_members", "Members of the cluster as this daemon sees them, by state: alive or gone"),
    ("tidemap_cluster_engine_unavailable", "1 if the engine of the cluster does not respond to this daemon"),
    (
        "tidemap_cluster_forks",
        "Forks that are set aside on this daemon, by groups of records: 1, or more, which is FORKED",
    ),
    ("tidemap_build_info", "1; the labels have version and commit of the daemon, and the identity of its data folder"),
    ("tidemap_fdatasyncs", "Calls of fdatasync since the start"),
    ("tidemap_fdatasync_p50_secs", "Median of the last fdatasync calls, seconds"),
    ("tidemap_fdatasync_p99_secs", "99th centile of the last fdatasync calls, seconds"),
    ("process_resident_memory_bytes", "Resident memory of the process"),
    ("process_open_fds", "Open descriptors of the process"),
    ("process_max_fds", "Maximum number of open descriptors of the process"),
];

/// Durations.
const HISTOGRAMS: &[(&str, &str)] = &[
    ("tidemap_request_duration_seconds", "From the arrival of a request to the end of its reply, by method"),
    (
        "tidemap_acknowledgement_seconds",
        "From a batch of observations to its acknowledgement, which is sent when it is durable",
    ),
    (
        "tidemap_cluster_append_seconds",
        "From an append to a shared log to its outcome: the engine has it on a majority of its servers, or refuses it",
    ),
];

/// The meaning of a gauge.
pub fn meaning(gauge: &str) -> &'static str {
    GAUGES.iter().find(|(name, _)| *name == gauge).map_or("", |(_, text)| text)
}

/// Begins all counters at 0, and the histograms that alerts use.
fn begin() {
    let is_labelled = |name: &str| LABELLED.iter().any(|(labelled, ..)| *labelled == name);
    // Requests have two labels. The exporter of traces, if there is one, begins its own.
    let elsewhere = ["tidemap_requests_total", "tidemap_spans_exported_total", "tidemap_spans_dropped_total"];
    for (name, _) in COUNTERS.iter().filter(|(name, _)| !elsewhere.contains(name) && !is_labelled(name)) {
        counter!(*name).increment(0);
    }
    for (name, label, values) in LABELLED {
        values.iter().for_each(|value| counter!(*name, *label => *value).increment(0));
    }
    for method in table::methods() {
        for code in CODES {
            counter!("tidemap_requests_total", "method" => method, "code" => code).increment(0);
        }
        let _ = histogram!("tidemap_request_duration_seconds", "method" => method);
    }
    for name in ["tidemap_acknowledgement_seconds", "tidemap_cluster_append_seconds"] {
        let _ = histogram!(name);
    }
}

/// Describes all metrics, and begins those that count.
pub(super) fn describe() {
    begin();
    COUNTERS.iter().for_each(|&(name, text)| describe_counter!(name, text));
    GAUGES.iter().for_each(|&(name, text)| describe_gauge!(name, text));
    HISTOGRAMS.iter().for_each(|&(name, text)| describe_histogram!(name, Unit::Seconds, text));
}
