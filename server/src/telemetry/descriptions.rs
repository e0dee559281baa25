//! What each metric means, for `/metrics`.
//!
//! Invariant: every metric has a line here; a test compares a running daemon's metrics with these lines.

use metrics::{Unit, describe_counter, describe_gauge, describe_histogram};

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
    ("tidemap_reloads_total", "Files of tokens or certificates that were read again, by what"),
    ("tidemap_reload_failures_total", "Files of tokens or certificates that could not be read again, by what"),
    ("tidemap_model_cache_hits_total", "Requests for fitted models that the cache answered"),
    ("tidemap_model_cache_misses_total", "Requests for fitted models that had to be fitted"),
    ("tidemap_connections_displaced", "Connections that made room for others, by port"),
    ("tidemap_streams_displaced_total", "Streams of observations that were silent and made room for others"),
    (
        "tidemap_connections_refused",
        "Connections refused because all others were busy, by port; those of the HTTP port come into its reserve",
    ),
    ("tidemap_connections_silent", "Connections that made no request in time, by port"),
    ("tidemap_spans_exported_total", "Spans that the collector of traces has taken; with otlp_endpoint only"),
    ("tidemap_spans_dropped_total", "Spans dropped because the collector did not take them in time"),
    ("tidemap_accept_errors", "Failures to accept a connection, such as a lack of descriptors"),
    ("tidemap_tls_handshakes_failed_total", "TLS handshakes that failed, for example of clients without a certificate"),
    ("tidemap_backups_total", "Backups made, scheduled or asked for"),
    ("tidemap_backup_failures_total", "Backups that failed, scheduled or asked for"),
];

/// Values that go up and down.
const GAUGES: &[(&str, &str)] = &[
    ("tidemap_connections", "Open connections, by port: grpc, http, or probes, the reserve of the HTTP port"),
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
    ("tidemap_damaged_files", "Files that the background check found damaged"),
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
    ("tidemap_job_progress_ratio", "Progress of the running update that has done least, 0 to 1; 1 if none runs"),
    ("tidemap_log_bytes", "Size of the logs"),
    ("tidemap_checkpoint_bytes", "Size of the checkpoints"),
    ("tidemap_disk_full", "1 if the disk was full lately"),
    ("tidemap_disk_free_bytes", "Free space of the disk with the data folder"),
    ("tidemap_disk_size_bytes", "Size of the disk with the data folder"),
    ("tidemap_index_unavailable", "1 if the index cannot be used; everything else works"),
        "tidemap_backup_age_seconds",
    ("tidemap_backup_interval_seconds", "Time from one scheduled backup to the next; with a schedule"),
    ("tidemap_build_info", "1; the labels say version and commit of the daemon, and the identity of its data folder"),
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
];

/// Describes all metrics.
pub(super) fn describe() {
    COUNTERS.iter().for_each(|&(name, text)| describe_counter!(name, text));
    GAUGES.iter().for_each(|&(name, text)| describe_gauge!(name, text));
    HISTOGRAMS.iter().for_each(|&(name, text)| describe_histogram!(name, Unit::Seconds, text));
}
