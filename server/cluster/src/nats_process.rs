//! NATS servers as child processes, for tests. They use free ports of this machine, and each has its own folder.
//!
//! TIDEMAP_NATS_SERVER names the program; otherwise it is the one that `deploy/nats-server.sh` has put into
//! `target/nats`.
//!
//! Invariant: no server and no folder outlives the value that started it.

use std::{
    fs::{self, File},
    io,
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::Duration,
};

use tempfile::TempDir;
use tokio::time::{Instant, sleep};

use crate::{
    engine::{Engine, EngineError},
    nats::{NatsCredentials, NatsEngine, NatsSettings, NatsTls},
};

/// Time limit for the servers to start and to elect leaders.
const START_PATIENCE: Duration = Duration::from_secs(60);

/// The path of `nats-server`, or the reason why there is none.
pub fn nats_server() -> Result<PathBuf, String> {
    let path = std::env::var_os("TIDEMAP_NATS_SERVER")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/nats/nats-server"), PathBuf::from);
    let missing = || format!("{} is missing: deploy/nats-server.sh fetches it", path.display());
    path.is_file().then(|| path.clone()).ok_or_else(missing)
}

struct NatsServer {
    name: String,
    port: u16,
    cluster_port: u16,
    child: Option<Child>,
}

/// Servers that form a cluster.
pub struct NatsServers {
    program: PathBuf,
    folder: TempDir,
    servers: Vec<NatsServer>,
    /// Whether the servers make messages durable before they acknowledge them.
    is_synced: bool,
    security: Option<NatsSecurity>,
}

/// The credentials with which servers and clients authenticate each other, instead of passwords without encryption.
#[derive(Clone, Debug)]
pub struct NatsSecurity {
    /// The servers' certificate and key.
    pub server: (PathBuf, PathBuf),
    /// The client's certificate, and the authority of all.
    pub client: NatsTls,
    /// The public nkey of the client.
    pub nkey: String,
    /// The file with the seed of the client's nkey.
    pub seed: PathBuf,
}

/// Ports that are free now.
fn free_ports(count: usize) -> io::Result<Vec<u16>> {
    let listeners: Vec<TcpListener> =
        (0..count).map(|_| TcpListener::bind(("127.0.0.1", 0))).collect::<io::Result<_>>()?;
    listeners.iter().map(|listener| Ok(listener.local_addr()?.port())).collect()
}

impl NatsServers {
    /// Starts some servers, which sync each message, and waits until they hold streams. `Err` contains the reason why a
    /// test that needs them is skipped. Panics if a server does not start.
    pub async fn start(count: usize) -> Result<Self, String> {
        let servers = Self::new(count, true, None)?;
        servers.wait().await;
        Ok(servers)
    }

    /// Starts servers that acknowledge before they sync.
    pub async fn start_unsynced(count: usize) -> Result<Self, String> {
        let servers = Self::new(count, false, None)?;
        servers.wait().await;
        Ok(servers)
    }

    /// Starts servers that require TLS and an nkey from their clients.
    pub async fn start_secured(count: usize, security: NatsSecurity) -> Result<Self, String> {
        let servers = Self::new(count, true, Some(security))?;
        servers.wait().await;
        Ok(servers)
    }

    fn new(count: usize, is_synced: bool, security: Option<NatsSecurity>) -> Result<Self, String> {
        let program = nats_server()?;
        let folder = TempDir::new().map_err(|error| format!("no temporary folder: {error}"))?;
        let ports = free_ports(2 * count).map_err(|error| format!("no free ports: {error}"))?;
        let server = |(index, ports): (usize, &[u16])| NatsServer {
            name: format!("nats-{index}"),
            port: ports[0],
            cluster_port: ports[1],
            child: None,
        };
        let servers = ports.chunks(2).enumerate().map(server).collect();
        let mut servers = Self { program, folder, servers, is_synced, security };
        (0..count).for_each(|index| servers.run(index));
        Ok(servers)
    }

    /// Settings to connect to all servers.
    pub fn settings(&self) -> NatsSettings {
        let Some(security) = &self.security else { return self.settings_as("tidemap") };
        let url = |server: &NatsServer| format!("tls://127.0.0.1:{}", server.port);
        let settings = NatsSettings::new(self.servers.iter().map(url).collect());
        let credentials = NatsCredentials::NkeySeed(security.seed.clone());
        NatsSettings { credentials, tls: Some(security.client.clone()), ..settings }
    }

    /// Settings of a user. The user `guest` may read, but not append.
    pub fn settings_as(&self, user: &str) -> NatsSettings {
        let url = |server: &NatsServer| format!("nats://{user}:{user}@127.0.0.1:{}", server.port);
        NatsSettings::new(self.servers.iter().map(url).collect())
    }

    /// The URL of one server.
    pub fn url(&self, index: usize) -> String {
        format!("nats://tidemap:tidemap@127.0.0.1:{}", self.servers[index].port)
    }

    /// The number of the server that has a name.
    pub fn index(&self, name: &str) -> Option<usize> {
        self.servers.iter().position(|server| server.name == name)
    }

    /// Ends a server with SIGKILL.
    pub fn kill(&mut self, index: usize) {
        if let Some(mut child) = self.servers[index].child.take() {
            // The server may have ended by itself.
            drop(child.kill());
            drop(child.wait());
        }
    }

    /// Starts a server that was killed, with the content of its disk.
    pub fn run(&mut self, index: usize) {
        let server = &self.servers[index];
        let base = self.folder.path().join(&server.name);
        fs::create_dir_all(&base).unwrap_or_else(|error| panic!("{}: {error}", base.display()));
        let config = base.join("nats.conf");
        fs::write(&config, self.config(index, &base)).unwrap_or_else(|error| panic!("{}: {error}", config.display()));
        let log = File::options().create(true).append(true).open(base.join("log"));
        let log = log.unwrap_or_else(|error| panic!("{}: {error}", base.display()));
        let child = Command::new(&self.program)
            .arg("-c")
            .arg(&config)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .unwrap_or_else(|error| panic!("{} does not start: {error}", self.program.display()));
        self.servers[index].child = Some(child);
    }

    /// Saves the content of the disks of the servers, which do not run.
    pub fn save(&self) {
        self.servers.iter().for_each(|server| self.copy(&server.name, "data", "image"));
    }

    /// Sets the disks of the servers, which do not run, back to the saved content.
    pub fn set_back(&self) {
        self.servers.iter().for_each(|server| self.copy(&server.name, "image", "data"));
    }

    fn copy(&self, server: &str, from: &str, to: &str) {
        let base = self.folder.path().join(server);
        // The folder may not exist.
        drop(fs::remove_dir_all(base.join(to)));
        let status = Command::new("cp").arg("-a").arg(base.join(from)).arg(base.join(to)).status();
        assert!(status.is_ok_and(|status| status.success()), "cp {from} {to} in {}", base.display());
    }

    /// Sends a signal such as `STOP` or `CONT`.
    pub fn signal(&self, index: usize, signal: &str) {
        if let Some(child) = &self.servers[index].child {
            let status = Command::new("kill").arg(format!("-{signal}")).arg(child.id().to_string()).status();
            assert!(status.is_ok_and(|status| status.success()), "kill -{signal}");
        }
    }

    /// The log of a server.
    pub fn log(&self, index: usize) -> String {
        fs::read_to_string(self.folder.path().join(&self.servers[index].name).join("log")).unwrap_or_default()
    }

    /// Waits until the servers hold a stream of as many replicas as there are servers.
    async fn wait(&self) {
        let deadline = Instant::now() + START_PATIENCE;
        while let Err(error) = self.hold_a_stream().await {
            if Instant::now() > deadline {
                let logs: Vec<String> = (0..self.servers.len()).map(|index| self.log(index)).collect();
                panic!("the servers do not start: {error}\n{}", logs.join("\n"));
            }
            sleep(Duration::from_millis(100)).await;
        }
    }

    async fn hold_a_stream(&self) -> Result<(), EngineError> {
        let mut settings = self.settings();
        "ready".clone_into(&mut settings.cluster);
        let engine = NatsEngine::connect(settings).await?;
        engine.create_stream("ready", self.servers.len()).await?;
        engine.delete_stream("ready").await
    }

    fn config(&self, index: usize, base: &Path) -> String {
        let server = &self.servers[index];
        let (name, port, cluster_port) = (&server.name, server.port, server.cluster_port);
        let sync = if self.is_synced { "always" } else { "2m" };
        let route = |server: &NatsServer| format!("\"nats://127.0.0.1:{}\"", server.cluster_port);
        let routes = self.servers.iter().map(route).collect::<Vec<_>>().join(", ");
        let cluster = if self.servers.len() > 1 {
            format!("cluster {{ name: tidemap, listen: \"127.0.0.1:{cluster_port}\", routes: [{routes}] }}\n")
        } else {
            String::new()
        };
        let (tls, user) = self.security.as_ref().map_or_else(Default::default, |security| {
            let (certificate, key) = &security.server;
            let authority = security.client.authority.as_deref().unwrap_or(Path::new(""));
            let (certificate, key, authority) = (certificate.display(), key.display(), authority.display());
            let tls = format!(
                "tls {{ cert_file: \"{certificate}\", key_file: \"{key}\", ca_file: \"{authority}\", verify: true }}\n"
            );
            (tls, format!("{{ nkey: {} }}\n", security.nkey))
        });
        format!(
            "{tls}\
             server_name: {name}\n\
             listen: \"127.0.0.1:{port}\"\n\
             max_payload: 2MB\n\
             jetstream {{ store_dir: \"{store}\", sync_interval: {sync}, max_file_store: 4GB }}\n\
             {cluster}\
             system_account: SYS\n\
             accounts {{\n\
               SYS {{\n\
                 users: [{{ user: sys, password: sys }}]\n\
                 exports: [{{ service: \"$SYS.REQ.SERVER.PING.VARZ\", response_type: stream }}]\n\
               }}\n\
               TIDEMAP {{\n\
                 jetstream: enabled\n\
                 users: [\n\
                   {user}\
                   {{ user: tidemap, password: tidemap }}\n\
                   {{ user: guest, password: guest, permissions: {{ publish: {{ deny: [\"tidemap.>\"] }} }} }}\n\
                 ]\n\
                 imports: [{{ service: {{ account: SYS, subject: \"$SYS.REQ.SERVER.PING.VARZ\" }} }}]\n\
               }}\n\
             }}\n",
            store = base.join("data").display(),
        )
    }
}

impl Drop for NatsServers {
    fn drop(&mut self) {
        (0..self.servers.len()).for_each(|index| self.kill(index));
    }
}
