//! Settings: defaults, then the config file, then `TIDEMAP_…` in the environment, then flags; the later win.
//!
//! Invariant: loaded settings are complete and checked; an unknown key in the file is an error that names it.

pub mod cluster;
pub mod config_text;
mod flags;
pub mod instructions;
mod offline;
mod protection;
pub mod unknown;
#[cfg(test)]
mod wrong_values;

use std::path::PathBuf;

use anyhow::bail;
use figment::{
    Figment,
    providers::{Env, Format as _, Serialized, Toml},
};
use serde::{Deserialize, Serialize};
use tidemap_store::is_store_id;

use crate::{connections::tls::TlsFiles, telemetry, telemetry::LogFormat};
use cluster::ClusterSettings;
pub use flags::Flags;
pub use offline::{BackupCommand, OfflineCommand};
use protection::MissingProtection;
pub use protection::is_local;

/// A setting in the form that the example config shows.
#[derive(Debug)]
struct Setting {
    key: &'static str,
    /// The meaning of the setting, in the lines of the code.
    meaning: &'static [&'static str],
    /// The least and the greatest value, if the setting is a limited number.
    range: Option<(u64, u64)>,
}

/// Declares [`Settings`]: sections with the meaning, the type, the default, and the least and the greatest allowed
/// value of each key. The example config is made from the same text.
macro_rules! settings {
    ($($section:literal {
        $($(#[doc = $meaning:literal])* $key:ident: $type:ty = $default:expr $(, $min:expr, $max:expr)?;)*
    })*) => {
        /// All settings; the keys of the config file.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct Settings {
            $($($(#[doc = $meaning])* pub $key: $type,)*)*
            /// The section `[cluster]`; `None`: the daemon is alone.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub cluster: Option<ClusterSettings>,
        }

        /// The sections of the config file, with their settings.
        const SECTIONS: &[(&str, &[Setting])] = &[$(($section, &[$(Setting {
            key: stringify!($key),
            meaning: &[$($meaning),*],
            range: settings!(@range $($min, $max)?),
        }),*])),*];

        impl Default for Settings {
            fn default() -> Self {
                Self { $($($key: $default,)*)* cluster: None }
            }
        }

        impl Settings {
            fn check_ranges(&self) -> anyhow::Result<()> {
                $($($(check_range(stringify!($key), self.$key as u64, $min, $max)?;)?)*)*
                Ok(())
            }
        }
    };
    (@range) => { None };
    (@range $min:expr, $max:expr) => { Some(($min, $max)) };
}

settings! {
    "folder" {
        /// Folder of all data. One daemon at a time; a second one refuses to start. The systemd unit sets it to
        /// /var/lib/tidemap.
        data_dir: PathBuf = PathBuf::from("./tidemap-data");
        /// Identity that the data folder must have: the daemon refuses to start on another folder, and on an empty one,
        /// such as the place of a disk that is not mounted. Empty: any folder. The daemon writes the id of a new folder
        /// to its log; tidemapd check prints it.
        expect_store_id: String = String::new();
    }
    "ports" {
        /// Address of the gRPC port. Port 0 picks a free port; the line `listening grpc=HOST:PORT http=HOST:PORT` on
        /// stdout names it.
        listen: String = "127.0.0.1:7435".to_owned();
        /// Address of the HTTP port: the page, JSON, health and metrics.
        http_listen: String = "127.0.0.1:7436".to_owned();
        /// Host names by which browsers may reach the HTTP port where no tokens are configured, besides localhost and
        /// addresses, so that pages of other origins cannot send requests to it (DNS rebinding).
        http_hosts: Vec<String> = Vec::new();
        /// Let everybody who reaches the HTTP port change data, where no tokens are configured. Without it, the port is
        /// for reading.
        http_write: bool = false;
        /// A Unix socket on which gRPC is served as well, for clients of this machine (tidemap --server unix:PATH);
        /// empty: none.
        socket: PathBuf = PathBuf::new();
        /// Permissions of the Unix socket. Every user who may write to it may connect; 0o660 lets the daemon's group
        /// connect.
        socket_mode: u32 = 0o600, 0, 0o777;
    }
    "security: see the page Security of the guide" {
        /// The certificate of the gRPC port, and of the HTTP port beyond this machine, in PEM form, with those of the
        /// authorities between it and the root; empty: no TLS. It is read again when it changes.
        tls_certificate: PathBuf = PathBuf::new();
        /// The private key of the certificate, in PEM form, without a password. It is read again when it changes.
        tls_key: PathBuf = PathBuf::new();
        /// Authorities of clients, in PEM form. If set, each client of the gRPC port must present a certificate of one
        /// of them.
        tls_client_ca: PathBuf = PathBuf::new();
        /// The file of the tokens that clients must have, as `tidemapd token` writes it; empty: everybody who reaches
        /// the port may do everything. It is read again when it changes. The daemon must own the file, and nobody else
        /// may read it.
        tokens_file: PathBuf = PathBuf::new();
        /// Listen on other addresses than this machine's without TLS or without tokens.
        allow_insecure_remote: bool = false;
    }
    "log, on stderr" {
        /// Format of the log: "text" for people, "json" for one object a line.
        log_format: LogFormat = LogFormat::Text;
        /// Filter of the log: error, warn, info, debug, trace, or a filter such as "info,tidemap_ingest=debug".
        log_level: String = "info".to_owned();
    }
    "metrics: see the page Alerts of the guide" {
        /// Maximum number of producers whose silence is a metric of its own, all maps together: of those that sent
        /// within 7 days, the ones that are silent for longest; 0: none.
        metrics_max_producers: usize = 100, 0, 10_000;
    }
    "traces: see the page Traces of the guide" {
        /// Receiver of the spans of requests, updates, erasures, checkpoints and commits of the log: a collector of
        /// OpenTelemetry that accepts OTLP over gRPC without TLS, as http://HOST:PORT; empty: no spans are made. The
        /// daemon also works while the collector is not reachable: spans that it does not accept are dropped and
        /// counted.
        otlp_endpoint: String = String::new();
        /// Share of traces that are recorded, 0 to 1. A request with a trace context (the header traceparent) is
        /// recorded if its context requires it.
        trace_ratio: f64 = 1.0;
    }
    "limits" {
        /// Maximum number of maps.
        max_maps: usize = 256, 1, 10_000;
        /// Maximum number of states of a map. A state takes 4 to 7 KB of memory while it is served, and two to three
        /// times as much while an update runs.
        max_states_per_map: usize = 100_000, 1, 16_000_000;
        /// Maximum number of tiles of the occupancy grid of a map: 8x8x8 cells each, 8x8 in a flat grid.
        max_tiles_per_map: usize = 200_000, 1, 8_000_000;
        /// Maximum number of producer keys (producer and label) of a map.
        max_producers_per_map: usize = 10_000, 1, 1_000_000;
        /// Maximum number of producer keys of a map that one client has introduced: the holder of a token, or an
        /// address without one, except this machine's addresses.
        max_producers_per_client: usize = 5_000, 1, 1_000_000;
        /// Maximum number of observations of one message.
        max_batch_observations: usize = 4096, 1, 65_536;
        /// Maximum number of scans of one message.
        max_batch_scans: usize = 1024, 1, 65_536;
        /// Maximum number of points or rays of one scan. A scan that spans messages waits in memory, with 12 bytes per
        /// point.
        max_scan_points: usize = 1_000_000, 1, 100_000_000;
        /// Maximum number of tiles of one scan, and of one stream's table of tiles. A tile of the table takes about 350
        /// bytes.
        max_scan_tiles: usize = 65_536, 1, 100_000;
        /// Maximum size of one message, in bytes.
        max_message_bytes: usize = 1 << 20, 4096, 16 << 20;
        /// Maximum number of bytes that one stream has sent and that are not durable yet. A faster robot waits.
        max_stream_buffer_bytes: usize = 1 << 20, 4096, 1 << 30;
        /// Maximum number of bytes that all streams have sent and that are not durable yet. From
        /// max_stream_buffer_bytes to 4294967296.
        max_buffer_bytes: usize = 64 << 20;
        /// Maximum number of bytes of the tables of tiles and unfinished scans of all streams.
        max_stream_tables_bytes: usize = 256 << 20, 1 << 20, 1 << 36;
        /// Maximum number of connections of the gRPC port. Beyond that, one that makes no requests makes room; if all
        /// are busy, the new one is closed.
        max_connections: usize = 4096, 8, 1_000_000;
        /// Maximum number of connections of one client address.
        max_connections_per_client: usize = 2048, 1, 1_000_000;
        /// Maximum number of requests under way, besides streams of observations and watches of anomalies.
        max_requests: usize = 384, 1, 100_000;
        /// Maximum number of requests under way of one client: the holder of a token, or an address without one.
        max_requests_per_client: usize = 128, 1, 100_000;
        /// Maximum number of open streams of observations. Beyond that, the one that was silent for longest makes room,
        /// if it was silent for stream_idle_secs and all that it sent is acknowledged; else the new one is refused.
        max_streams: usize = 1024, 1, 100_000;
        /// Maximum number of open streams of observations of one client: the holder of a token, or an address without
        /// one, except this machine's addresses. Raise it where a whole fleet has one token or one address.
        max_streams_per_client: usize = 512, 1, 100_000;
        /// Time for which a stream of observations must be silent before it may make room for another, in seconds.
        /// While there is room, no stream has to end.
        stream_idle_secs: u64 = 60, 1, 31_536_000;
        /// Maximum number of observations of a map that wait for the nightly update. Above this an update runs early;
        /// above twice this, including those of a running update, streams wait. An observation takes 24 to 48 bytes of
        /// memory.
        max_pending_observations: u64 = 4_000_000, 1000, 1 << 32;
        /// Maximum number of changes of the grid of a map that wait for the nightly update: scans, and cells that
        /// differ from the scan before. Above this an update runs early; above twice this, streams wait. A change takes
        /// 8 to 16 bytes of memory.
        max_pending_changes: u64 = 16_000_000, 1000, 1 << 32;
        /// Update each map at its local midnight. Without it, a map is updated on request (tidemap update), at the
        /// midnights of imported data, and when too much is pending.
        update_at_midnight: bool = true;
        /// Maximum number of predictions (states x times) of one request.
        max_predictions: u64 = 10_000_000, 1, 1 << 40;
        /// Maximum number of models that are trained on request and cached, all maps together, and that evaluations
        /// hold at once (each holds those of one state). A model takes 100 bytes to 10 KB, a histogram 16 bytes per
        /// bin.
        max_trained_models: usize = 4000, 1, 1_000_000;
        /// Maximum number of observations that one model is trained on. The training takes some 100 bytes for each
        /// while it runs.
        max_training_readings: u64 = 2_000_000, 1, 1 << 32;
        /// Maximum number of open watches of anomalies. A watched map keeps what its watchers have not read yet, at
        /// most 5 MB, and the models of the previous generation.
        max_watches: usize = 64, 1, 100_000;
        /// Maximum number of open watches of anomalies of one client: the holder of a token, or an address without one,
        /// except this machine's addresses.
        max_watches_per_client: usize = 16, 1, 100_000;
        /// Maximum size of one recording that is sent to the HTTP port, to be imported, in bytes; 0: none is accepted.
        /// It is in the data folder until it is imported.
        max_upload_bytes: u64 = 4 << 30, 0, 1 << 44;
        /// Maximum number of grid cells of one plan of exploration. A cell takes about 20 bytes while the plan is made.
        max_plan_cells: u64 = 1 << 24, 1, 1 << 32;
        /// Maximum work of views in one request: viewpoints x times x cells that the rays of one view pass (about
        /// 400,000 for a view of 4 m with cells of 0.1 m).
        max_view_work: u64 = 200_000_000_000, 1, 1 << 60;
    }
    "work and storage" {
        /// Number of threads of updates, all maps together; 0: half the processors, at least one.
        update_threads: usize = 0, 0, 1024;
        /// Vector instructions of the models: "best" of this processor, or scalar, neon, avx2, avx512, to find a fault.
        /// All produce equal results.
        instruction_set: String = instructions::BEST.to_owned();
        /// Size at which a log segment is closed and the next one begun, in bytes.
        segment_bytes: u64 = 64 << 20, 1 << 16, 1 << 32;
        /// Size of the cache of the index of models, in bytes.
        index_cache_bytes: u64 = 64 << 20, 1 << 20, 1 << 36;
        /// Number of checkpoints that are kept of each map.
        checkpoints_kept: usize = 2, 1, 100;
        /// Memory for the learned models of a map's tiles, in bytes. Other tiles are read from the newest checkpoint.
        tile_cache_bytes: u64 = 1 << 30, 1 << 20, 1 << 44;
        /// Memory for the sums of a map's states, in bytes. Other sums are read from the newest checkpoint by the next
        /// update.
        spectrum_cache_bytes: u64 = 64 << 20, 0, 1 << 44;
        /// Rate at which the data folder is read again in the background, to find damage early, in bytes a second; 0:
        /// never.
        scrub_bytes_per_sec: u64 = 4 << 20, 0, 1 << 40;
        /// Pause between two such rounds, and before the first, in seconds.
        scrub_every_secs: u64 = 21_600, 1, 31_536_000;
    }
    "backups: see the page Backup and restore of the guide" {
        /// The folder of backups, as an absolute path, best on another disk. Requests for a backup (tidemap backup
        /// create) write below it and nowhere else. Empty: only programs of this machine may request a backup, into any
        /// folder, and only while there is no tokens_file.
        backup_dir: PathBuf = PathBuf::new();
        /// Time from one scheduled backup to the next, in seconds (86400 is a day); 0: none is scheduled. It requires
        /// backup_dir.
        backup_every_secs: u64 = 0, 0, 31_536_000;
        /// Number of scheduled backups that are kept. Older ones are removed when a new one is complete.
        backups_kept: usize = 7, 1, 10_000;
    }
}

fn check_range(key: &str, value: u64, min: u64, max: u64) -> anyhow::Result<()> {
    if !(min..=max).contains(&value) {
        bail!("setting {key} is {value}: it must be between {min} and {max}");
    }
    Ok(())
}

impl Settings {
    /// Merges all sources and checks the result.
    ///
    /// # Errors
    /// A missing or malformed file, an unknown key, or a value out of range; the error names the key.
    pub fn load(flags: &Flags) -> anyhow::Result<Self> {
        let defaults = Self::default();
        let mut figment = Figment::from(Serialized::defaults(&defaults));
        if let Some(path) = &flags.config {
            if !path.is_file() {
                bail!("config file {} does not exist", path.display());
            }
            figment = figment.merge(Toml::file_exact(path));
        }
        let keys: Vec<String> = Figment::from(Serialized::defaults(&defaults))
            .extract::<std::collections::BTreeMap<String, figment::value::Value>>()
            .map(|map| map.into_keys().collect())
            .unwrap_or_default();
        let keys: Vec<&str> = keys.iter().map(String::as_str).collect();
        // These settings differ between the daemons of a cluster.
        let of_cluster = Env::prefixed("TIDEMAP_CLUSTER_").only(&["member", "advertise", "servers"]);
        let of_cluster = of_cluster.map(|key| format!("cluster.{key}").into());
        let settings: Self = figment
            .merge(Env::prefixed("TIDEMAP_").only(&keys))
            .merge(of_cluster)
            .merge(Serialized::defaults(flags))
            .extract()
            .map_err(unknown::in_words)?;
        settings.check()?;
        Ok(settings)
    }

    /// The files of TLS, if it is configured.
    pub fn tls_files(&self) -> Option<TlsFiles> {
        let named = |path: &PathBuf| Some(path.clone()).filter(|path| !path.as_os_str().is_empty());
        Some(TlsFiles {
            certificate: named(&self.tls_certificate)?,
            key: named(&self.tls_key)?,
            client_ca: named(&self.tls_client_ca),
            advertised: self.cluster.as_ref().and_then(ClusterSettings::tls_host),
        })
    }

    fn check_tls(&self) -> anyhow::Result<()> {
        let is_empty = |path: &PathBuf| path.as_os_str().is_empty();
        for (set, key, other, missing) in [
            (&self.tls_certificate, "tls_certificate", &self.tls_key, "tls_key"),
            (&self.tls_key, "tls_key", &self.tls_certificate, "tls_certificate"),
            (&self.tls_client_ca, "tls_client_ca", &self.tls_certificate, "tls_certificate"),
        ] {
            if !is_empty(set) && is_empty(other) {
                bail!("setting {key} is {:?}, and {missing} is not set: TLS needs both", set.display().to_string());
            }
        }
        Ok(())
    }

    /// Checks the host names. A name that is invalid would fit no request, and its page would not be shown.
    fn check_host_names(&self) -> anyhow::Result<()> {
        let is_of_name = |character: char| character.is_ascii_alphanumeric() || matches!(character, '-' | '.' | '_');
        let is_wrong = |name: &&String| name.is_empty() || !name.chars().all(is_of_name);
        let Some(wrong) = self.http_hosts.iter().find(is_wrong) else { return Ok(()) };
        bail!(
            "setting http_hosts has {wrong:?}: it must be a host name without scheme and port, for example maps.example.org"
        );
    }

    fn check_backups(&self) -> anyhow::Result<()> {
        let folder = &self.backup_dir;
        if folder.as_os_str().is_empty() {
            if self.backup_every_secs > 0 {
                let every = self.backup_every_secs;
                bail!("setting backup_every_secs is {every}, and backup_dir is not set: name the folder of backups");
            }
        } else if !folder.is_absolute() {
            bail!("setting backup_dir is {:?}: it must be an absolute path", folder.display().to_string());
        }
        Ok(())
    }

    /// Checks that the buffer of one stream fits into the buffer of all streams.
    fn check_buffers(&self) -> anyhow::Result<()> {
        let (one, all, default) = (self.max_stream_buffer_bytes, self.max_buffer_bytes, Self::default());
        if one > all && one != default.max_stream_buffer_bytes {
            bail!(
                "setting max_stream_buffer_bytes is {one}: it must be at most max_buffer_bytes, which is {all} for all \
                 streams together. Set a larger max_buffer_bytes, too"
            );
        }
        check_range("max_buffer_bytes", all as u64, one as u64, 4 << 30)
    }

    fn check(&self) -> anyhow::Result<()> {
        self.check_ranges()?;
        self.check_tls()?;
        self.check_backups()?;
        instructions::chosen(&self.instruction_set)?;
        telemetry::check_log_level(&self.log_level)?;
        self.check_host_names()?;
        self.cluster.as_ref().map_or(Ok(()), |cluster| cluster.check(&self.listen, self.tls_files().is_some()))?;
        if !self.expect_store_id.is_empty() && !is_store_id(&self.expect_store_id) {
            let found = &self.expect_store_id;
            bail!("setting expect_store_id is {found:?}: it must be 32 lower-case hexadecimal digits, or empty");
        }
        telemetry::traces::check(&self.otlp_endpoint, self.trace_ratio)?;
        self.check_buffers()?;
        for (key, address) in [("listen", &self.listen), ("http_listen", &self.http_listen)] {
            if address.rsplit_once(':').is_none_or(|(_, port)| port.parse::<u16>().is_err()) {
                bail!("setting {key} is {address:?}: it must be HOST:PORT, for example 127.0.0.1:7435");
            }
            if let Some(missing) = self.missing_protection()
                && !is_local(address)
                && !self.allow_insecure_remote
            {
                bail!(
                    "setting {key} is {address:?}, which is reachable from beyond this machine, without {missing}: {}. \
                     {}, listen on 127.0.0.1, or set --allow-insecure-remote",
                    missing.consequence(),
                    missing.remedy()
                );
            }
        }
        Ok(())
    }

    /// The protection that a port beyond this machine lacks, if there is such a port.
    pub fn missing_protection(&self) -> Option<MissingProtection> {
        let is_exposed = !is_local(&self.listen) || !is_local(&self.http_listen);
        let (tls, tokens) = (self.tls_files().is_some(), !self.tokens_file.as_os_str().is_empty());
        match (tls, tokens) {
            _ if !is_exposed => None,
            (true, true) => None,
            (true, false) => Some(MissingProtection::Tokens),
            (false, true) => Some(MissingProtection::Tls),
            (false, false) => Some(MissingProtection::Both),
        }
    }

    /// The number of update threads.
    pub fn update_threads(&self) -> usize {
        match self.update_threads {
            0 => std::thread::available_parallelism().map_or(1, |n| n.get().div_ceil(2)),
            threads => threads,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn load(file: &str, flags: Flags) -> Result<Settings, String> {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("tidemapd.toml");
        std::fs::write(&path, file).expect("written");
        Settings::load(&Flags { config: Some(path), ..flags }).map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn flags_win_over_the_file_and_the_file_over_defaults() {
        let flags = Flags { listen: Some("127.0.0.1:1".to_owned()), ..Flags::default() };
        let settings = load("listen = '127.0.0.1:2'\nmax_maps = 7", flags).expect("valid");
        assert_eq!(settings.listen, "127.0.0.1:1");
        assert_eq!(settings.max_maps, 7);
        assert_eq!(settings.http_listen, "127.0.0.1:7436");
    }

    #[test]
    fn mistakes_name_the_key() {
        for (file, word) in [
            ("lisen = '127.0.0.1:2'", "lisen"),
            ("max_maps = 0", "max_maps"),
            ("max_maps = 'many'", "max_maps"),
            ("listen = 'here'", "listen"),
            ("listen = '0.0.0.0:7435'", "allow-insecure-remote"),
            ("log_format = 'xml'", "log_format"),
            ("log_level = 'inf'", "log_level"),
            ("log_level = 'tidemapd=inf'", "log_level"),
            ("log_level = ''", "log_level"),
            ("http_hosts = ['https://maps.example.org']", "http_hosts"),
            ("http_hosts = ['maps.example.org:7436']", "http_hosts"),
            ("http_hosts = ['']", "http_hosts"),
            ("otlp_endpoint = 'localhost:4317'", "otlp_endpoint"),
            ("otlp_endpoint = 'https://collector:4317'", "otlp_endpoint"),
            ("trace_ratio = 1.5", "trace_ratio"),
            ("trace_ratio = nan", "trace_ratio"),
            ("instruction_set = 'sse2'", "instruction_set"),
            ("backup_dir = 'saved'", "backup_dir"),
            ("backup_every_secs = 60", "backup_dir"),
            ("expect_store_id = 'mine'", "expect_store_id"),
            ("[cluster]\nmember = 'a'", "servers"),
            ("[cluster]\nservers = ['nats://a:4222']", "member"),
            ("listen = '127.0.0.1:0'\n[cluster]\nservers = ['nats://a:4222']\nmember = 'a'", "cluster.advertise"),
            ("[cluster]\nservers = ['nats://a:4222']\nmember = 'a b'", "cluster.member"),
            ("[cluster]\nservers = []\nmember = 'a'", "cluster.servers"),
            ("[cluster]\nservers = ['nats://a:4222']\nmember = 'a'\nengine_replicas = 2", "engine_replicas"),
            ("[cluster]\nservers = ['nats://a:4222']\nmember = 'a'\nlease = 2", "lease"),
            ("[cluster]\nservers = ['nats://a:4222']\nmember = 'a'\nadvertise = 'a:1'", "cluster.advertise"),
            ("[cluster]\nservers = ['nats://a:4222']\nmember = 'a'\nadvertise = 'https://a:1'", "cluster.peer_ca"),
            (
                "tls_certificate = 'c'\ntls_key = 'k'\n[cluster]\nservers = ['nats://a:4222']\nmember = 'a'",
                "tls_certificate is set",
            ),
        ] {
            let error = load(file, Flags::default()).expect_err(file);
            assert!(error.contains(word), "{file}: {error}");
        }
        assert!(load("listen = '0.0.0.0:7435'\nallow_insecure_remote = true", Flags::default()).is_ok());
        let cluster = "servers = ['nats://a:4222']\nmember = 'a'\nadvertise = 'https://a:1'\npeer_ca = 'c'";
        let files = "tls_certificate = 'c'\ntls_key = 'k'";
        assert!(load(&format!("{files}\n[cluster]\n{cluster}"), Flags::default()).is_ok());
    }

    #[test]
    fn beyond_this_machine_there_must_be_tls_and_tokens() {
        let tls = "tls_certificate = 'c'\ntls_key = 'k'\n";
        let tokens = "tokens_file = 't'\n";
        for port in ["listen", "http_listen"] {
            for address in ["0.0.0.0:1", "[::]:1", "192.168.0.7:1", "robot.local:1", "127.0.0.1.example.org:1"] {
                let line = format!("{port} = '{address}'\n");
                for (rest, missing) in
                    [("", "without TLS and tokens"), (tls, "without tokens"), (tokens, "without TLS")]
                {
                    let error = load(&format!("{line}{rest}"), Flags::default()).expect_err("refused");
                    assert!(error.contains(missing) && error.contains(port), "{error}");
                    let allowed = format!("{line}{rest}allow_insecure_remote = true");
                    assert!(load(&allowed, Flags::default()).is_ok());
                }
                assert!(load(&format!("{line}{tls}{tokens}"), Flags::default()).is_ok());
            }
        }
        for address in ["127.0.0.2:1", "[::1]:1", "localhost:1"] {
            assert!(load(&format!("listen = '{address}'"), Flags::default()).is_ok(), "{address}");
        }
    }

    /// Any bytes are settings or an error, never a panic. The bytes are drawn with a linear congruential generator.
    #[test]
    fn a_garbled_config_file_is_an_error() {
        let sound = "data_dir = './d'\nlisten = '127.0.0.1:2'\nmax_maps = 7\nlog_format = 'json'\nhttp_write = true\n";
        let mut state = 1_u64;
        let mut draw = |below: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % below
        };
        let (mut valid, mut refused) = (0, 0);
        for _ in 0..1_000 {
            let mut bytes = sound.as_bytes().to_vec();
            for _ in 0..=draw(4) {
                let at = draw(bytes.len().max(1));
                if bytes.is_empty() {
                    break;
                }
                match draw(4) {
                    0 => bytes[at] ^= 1 << draw(8),
                    1 => drop(bytes.remove(at)),
                    2 => bytes.insert(at, [b'\'', b'"', b'=', b'[', b'9', b'-', 0, 255][draw(8)]),
                    _ => bytes.truncate(at.max(1)),
                }
            }
            let dir = tempfile::tempdir().expect("temporary folder");
            let path = dir.path().join("tidemapd.toml");
            std::fs::write(&path, bytes).expect("written");
            match Settings::load(&Flags { config: Some(path), ..Flags::default() }) {
                Ok(_) => valid += 1,
                Err(_) => refused += 1,
            }
        }
        assert!(valid > 10 && refused > 100, "{valid} {refused}");
    }

    #[test]
    fn a_missing_config_file_is_named() {
        let missing = Flags { config: Some("/nonexistent/tidemapd.toml".into()), ..Flags::default() };
        assert!(format!("{:#}", Settings::load(&missing).expect_err("missing")).contains("/nonexistent"));
    }
}
