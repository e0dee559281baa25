//! The options that every command has, and the session that they make: a client, and the form of results.
//!
//! Invariant: `tidemap` and `tidemap-bench` have the same.

use std::{fs, path::PathBuf, process::ExitCode, time::Duration};

use anyhow::Context as _;
use clap::Args;
use tidemap_client::{Client, connection::Credentials};
use tidemap_formats::table::{self, Cell, Format, TableWriter, TimeStyle};
use tidemap_model::Zone;
use tidemap_terminal::{
    failure::{UsageError, usage},
    output::{self, TimeArg, default_format, format_parser},
};

use super::Subject;

/// Heading of the options that every command has.
const GLOBAL: &str = "Options of every command";

/// The options that every command has.
#[derive(Debug, Args)]
pub struct ConnectionArgs {
    /// Address of the daemon, HOST:PORT, http://HOST:PORT, https://HOST:PORT or unix:PATH
    #[arg(long, global = true, help_heading = GLOBAL, hide_short_help = true, display_order = 100, env = "TIDEMAP_SERVER", value_name = "URL", default_value = "http://127.0.0.1:7435")]
    server: String,
    /// File that holds the token to present to the daemon
    #[arg(long, global = true, help_heading = GLOBAL, hide_short_help = true, display_order = 101, env = "TIDEMAP_TOKEN_FILE", value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Certificates of the authorities that the daemon's certificate may come from (PEM); https:// needs them
    #[arg(long, global = true, help_heading = GLOBAL, hide_short_help = true, display_order = 101, env = "TIDEMAP_TLS_CA", value_name = "FILE")]
    tls_ca: Option<PathBuf>,
    /// Certificate of this client (PEM), for a daemon that requires one
    #[arg(long, global = true, help_heading = GLOBAL, hide_short_help = true, display_order = 101, env = "TIDEMAP_TLS_CERT", value_name = "FILE", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// Private key of --tls-cert (PEM)
    #[arg(long, global = true, help_heading = GLOBAL, hide_short_help = true, display_order = 101, env = "TIDEMAP_TLS_KEY", value_name = "FILE", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
    /// Format of the results [default: table on a terminal, csv otherwise]
    #[arg(long, global = true, help_heading = GLOBAL, hide_short_help = true, display_order = 101, value_name = "FORMAT", value_parser = format_parser())]
    output: Option<Format>,
    /// Format of times in tables; CSV and JSON always have Unix seconds
    #[arg(id = "time_style", long = "time", global = true, help_heading = GLOBAL, hide_short_help = true, display_order = 101, value_name = "STYLE", default_value = "local")]
    time: TimeArg,
}

impl ConnectionArgs {
    /// Address of the daemon.
    #[must_use]
    pub fn server(&self) -> &str {
        &self.server
    }

    /// Whether results and errors are JSON.
    #[must_use]
    pub fn prints_json(&self) -> bool {
        self.output == Some(Format::Json)
    }

    /// Format of the results.
    #[must_use]
    pub fn format(&self) -> Format {
        self.output.unwrap_or_else(default_format)
    }

    /// The client's credentials, and the authority that the daemon's certificate must come from.
    ///
    /// # Errors
    /// A file cannot be read.
    pub fn credentials(&self) -> anyhow::Result<Credentials> {
        let read = |what: &str, path: &Option<PathBuf>| {
            let bytes = path.as_ref().map(|path| fs::read(path).with_context(|| format!("{what} {}", path.display())));
            bytes.transpose()
        };
        let token = match read("token file", &self.token_file)? {
            // The bytes are not shown, even if they are no text.
            Some(bytes) => {
                Some(String::from_utf8(bytes).map_err(|_| usage("the token file holds no text"))?.trim().to_owned())
            }
            None => None,
        };
        let identity = read("certificate", &self.tls_cert)?.zip(read("key", &self.tls_key)?);
        Ok(Credentials { token, ca: read("certificates", &self.tls_ca)?, identity })
    }
}

/// The context of a command.
#[derive(Debug)]
pub struct Session {
    /// Calls the daemon.
    pub client: Client,
    /// Format of the results.
    pub format: Format,
    /// The style of times in tables.
    pub times: TimeStyle,
}

impl Session {
    /// A session whose tables show times in UTC.
    ///
    /// # Errors
    /// The address is none.
    pub fn new(connection: &ConnectionArgs, credentials: &Credentials) -> anyhow::Result<Self> {
        let client = Client::with_credentials(&connection.server, credentials);
        let client = client.map_err(|error| UsageError(error.to_string()))?;
        Ok(Self { client, format: connection.format(), times: TimeStyle::Clock(Zone::utc()) })
    }

    /// This session, with tables that show times as the options state, and by default in the zone of the command's map.
    pub(crate) async fn with_times_of(self, connection: &ConnectionArgs, subject: &Subject) -> Self {
        let times = time_style(&self.client, self.format, connection.time, subject).await;
        Self { times, ..self }
    }

    /// Prints rows to stdout, the result of a command that succeeded.
    ///
    /// # Errors
    /// Stdout cannot be written.
    pub fn print(&self, columns: &[&str], rows: impl IntoIterator<Item = Vec<Cell>>) -> anyhow::Result<ExitCode> {
        table::write_rows_at(self.format, &self.times, columns, rows, output::stdout())?;
        Ok(ExitCode::SUCCESS)
    }

    /// Prints one row; in a table each value has a line.
    ///
    /// # Errors
    /// Stdout cannot be written.
    pub fn print_one(&self, columns: &[&str], row: Vec<Cell>) -> anyhow::Result<ExitCode> {
        if self.format != Format::Table {
            return self.print(columns, [row]);
        }
        table::write_upright(&self.times, columns, &row, output::stdout())?;
        Ok(ExitCode::SUCCESS)
    }

    /// A result on stdout, for rows that come one by one.
    pub fn table(&self, columns: &[&str]) -> TableWriter<output::Stdout> {
        TableWriter::new(self.format, columns, output::stdout()).with_times(&self.times)
    }
}

/// The time limit for the request of a map's zone; without the zone, times are UTC.
const ZONE_WITHIN: Duration = Duration::from_secs(2);

/// The style of times in the tables of a command.
async fn time_style(client: &Client, format: Format, time: TimeArg, subject: &Subject) -> TimeStyle {
    match (time, &subject.map) {
        (TimeArg::Unix, _) => TimeStyle::Unix,
        (TimeArg::Ns, _) => TimeStyle::Nanos,
        (TimeArg::Local, Some(map)) if format == Format::Table || subject.is_drawn => {
            // The command itself reports problems with the map or the daemon.
            let map = tokio::time::timeout(ZONE_WITHIN, client.map(map)).await;
            let zone = map.ok().and_then(Result::ok).and_then(|map| Zone::named(&map.time_zone).ok());
            TimeStyle::Clock(zone.unwrap_or_else(Zone::utc))
        }
        (TimeArg::Local | TimeArg::Utc, _) => TimeStyle::Clock(Zone::utc()),
    }
}
