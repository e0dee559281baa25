//! Recordings that browsers and scripts send: `POST /api/v1/maps/NAME/recordings/FILE` imports a file into a map.
//!
//! Invariant: nothing of a file is read before it is checked that its sender may observe the map, and may create it if
//! it does not exist. A file is taken when its sender and its map have a turn, is never whole in memory, and is removed
//! when its import has ended. The daemon neither reads nor unpacks its content: the program `tidemap` does, in a
//! process of its own that is stopped when nobody waits for it, and when its sender's token is no longer valid.

use std::{path::PathBuf, sync::Arc};

use axum::{
    Router,
    body::Body,
    extract::{Path, Request, State},
    http::{HeaderMap, StatusCode, header, request::Parts},
    response::Response,
    routing::get,
};
use serde_json::json;
use tidemap_base::{
    access::table::{CREATE_MAP, OBSERVE},
    config::Settings,
    connections::{Peer, Remote},
};
use tidemap_map::name::{MapName, ProducerKey};
use tidemap_proto::v1::{GetMapRequest, map_service_client::MapServiceClient};
use tidemap_rpc::{
    admission::Admitted,
    guard::Access,
    lookup::check_sender,
    serve::{GuardedServices, Services},
    status::RpcError,
};
use tokio::sync::watch;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Code;

use super::{
    calls::Caller,
    json,
    links::{Given, Parameter},
};

mod import;
mod memory;
mod survivors;
mod turns;
mod upload_error;
mod workplace;

use import::{Import, Origin};
use turns::{Turn, Turns};
use upload_error::UploadError;
use workplace::{Workplace, check_room, file_name};

/// The path of a recording.
pub(super) const PATH: &str = "/api/v1/maps/{name}/recordings/{file}";
/// The folder of files that arrive, in the data folder.
const FOLDER: &str = "uploads";
/// The program that reads recordings, beside the daemon's own.
const PROGRAM: &str = "tidemap";
/// The producer of recordings whose sender names none.
const PRODUCER: &str = "upload";

/// The parameters of the address.
pub(super) const PARAMETERS: &[Parameter; 3] = &[
    Parameter {
        name: "producer",
        description: "Name of the producer that the observations are of. A file that is sent again under the same name \
                      is recognised if its producer is the same. Default: `upload`.",
        example: "",
    },
    Parameter {
        name: "update",
        description: "`false` leaves out the update that ends the import, in which the map learns what was imported; \
                      for all but the last of several files. Default: `true`. A sender whose role may not run updates \
                      has it left out, with a line that states it.",
        example: "",
    },
    Parameter {
        name: "bytes",
        description: "With GET: size of the file, to check whether there is room for it.",
        example: "1000000",
    },
];

/// The state of the imports. Clones share its turns.
#[derive(Clone)]
pub struct Recordings(Arc<Inner>);

struct Inner {
    folder: PathBuf,
    /// Maximum size of a file; 0: none is taken.
    max_bytes: u64,
    turns: Turns,
    services: Services,
    access: Access,
    /// The services for callers of this port.
    guarded: GuardedServices,
    stopping: watch::Receiver<bool>,
}

impl Recordings {
    /// Takes recordings of callers with this access, and removes the files that an earlier daemon left, after ending
    /// the programs that read them.
    ///
    /// # Errors
    /// The files or programs cannot be removed.
    pub fn new(
        settings: &Settings,
        services: &Services,
        access: Access,
        stopping: watch::Receiver<bool>,
    ) -> anyhow::Result<Self> {
        let folder = settings.data_dir.join(FOLDER);
        survivors::end_all(&folder)?;
        workplace::empty(&folder)?;
        Ok(Self(Arc::new(Inner {
            folder,
            max_bytes: settings.max_upload_bytes,
            turns: Turns::default(),
            services: services.clone(),
            guarded: services.guarded(access.clone()),
            access,
            stopping,
        })))
    }
}

/// The routes.
pub(super) fn router(recordings: Recordings) -> Router {
    Router::new().route(PATH, get(check).post(upload)).with_state(recordings)
}

/// A file that will be taken.
struct Upload {
    program: PathBuf,
    map: MapName,
    map_exists: bool,
    file: String,
    key: ProducerKey,
    /// Whether an update ends the import.
    has_update: bool,
    turn: Turn,
    /// Counts the request while it is worked on.
    admitted: Admitted,
}

impl Inner {
    /// Checks whether a file of this size is taken from the sender of this request.
    async fn admit(&self, (name, file): (String, String), head: &Parts, bytes: u64) -> Result<Upload, UploadError> {
        let given = Given::of(head.uri.query(), PARAMETERS)?;
        let admitted = self.guarded.admit(OBSERVE, &head.headers, &head.extensions)?;
        if self.max_bytes == 0 {
            return Err(UploadError::Off);
        }
        let map = MapName::new(&name)?;
        let file = file_name(&file)?;
        // All files of one name have one label, so that a file that is sent again is recognised.
        let key = ProducerKey::new(given.get("producer").unwrap_or(PRODUCER), &format!("upload/{file}"))?;
        let has_update = match given.get("update") {
            None | Some("true") => true,
            Some("false") => false,
            Some(_) => return Err(UploadError::Update),
        };
        admitted.caller().clone().scope(async { check_sender(map.as_str(), key.producer()) }).await?;
        let map_exists = self.map_exists(&map, head).await?;
        let program = program()?;
        if bytes > self.max_bytes {
            return Err(UploadError::TooLarge { max: self.max_bytes });
        }
        let peer = head.extensions.get::<Remote>().map_or(Peer::Local, Remote::peer);
        let turn = self.turns.take(&map, peer, admitted.caller().token_id())?;
        check_room(&self.folder, bytes)?;
        Ok(Upload { program, map, map_exists, file, key, has_update, turn, admitted })
    }

    /// Whether the map exists; if it does not, checks that its sender may create it.
    async fn map_exists(&self, map: &MapName, head: &Parts) -> Result<bool, UploadError> {
        let question = GetMapRequest { name: map.as_str().to_owned() };
        let question = Caller::of_head(&head.headers, &head.extensions).request(question);
        match MapServiceClient::new(self.guarded.clone()).get_map(question).await {
            Ok(_) => Ok(true),
            Err(status) if status.code() == Code::NotFound => {
                let may_create = self.guarded.admit(CREATE_MAP, &head.headers, &head.extensions);
                may_create
                    .map(|_| false)
                    .map_err(|error| UploadError::NotCreated { map: map.clone(), error: Box::new(error) })
            }
            Err(status) => Err(UploadError::Status(Box::new(status))),
        }
    }
}

/// The program that reads recordings.
fn program() -> Result<PathBuf, UploadError> {
    let own = std::env::current_exe().map_err(|_| UploadError::NoProgram(PROGRAM.into()))?;
    let program = own.with_file_name(PROGRAM);
    if program.is_file() { Ok(program) } else { Err(UploadError::NoProgram(program)) }
}

/// Reports whether a file would be taken, so that nobody sends gigabytes that are refused.
async fn check(
    State(recordings): State<Recordings>,
    Path(names): Path<(String, String)>,
    request: Request,
) -> Response {
    let (head, _) = request.into_parts();
    let checked = async {
        let given = Given::of(head.uri.query(), PARAMETERS)?;
        let bytes = match given.get("bytes").map(str::parse) {
            None => 0,
            Some(Ok(bytes)) => bytes,
            Some(Err(_)) => return Err(UploadError::Bytes),
        };
        recordings.0.admit(names, &head, bytes).await
    };
    match checked.await {
        Ok(upload) => {
            let max_bytes = recordings.0.max_bytes.to_string();
            let found = json!({ "mapExists": upload.map_exists, "file": upload.file, "maxUploadBytes": max_bytes });
            json::ok(format!("{found}\n").into())
        }
        Err(refusal) => refusal.response(),
    }
}

/// The token with which the sender proves its identity.
fn token(headers: &HeaderMap) -> Option<String> {
    let text = headers.get(header::AUTHORIZATION)?.to_str().ok()?;
    let (scheme, token) = text.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim().to_owned())
}

fn is_bytes(headers: &HeaderMap) -> bool {
    headers.get(header::CONTENT_TYPE).is_some_and(|media| media == "application/octet-stream")
}

/// Takes a file, imports it, and sends the progress and the result, one object a line.
async fn upload(
    State(recordings): State<Recordings>,
    Path(names): Path<(String, String)>,
    request: Request,
) -> Response {
    match import(&recordings.0, names, request).await {
        Ok(body) => json::reply(StatusCode::OK, "application/x-ndjson", body),
        Err(refusal) => refusal.response(),
    }
}

async fn import(inner: &Inner, names: (String, String), request: Request) -> Result<Body, UploadError> {
    // No form of a page can send this type, so that the browser of a page of another origin has to send a preflight
    // request.
    let (head, body) = request.into_parts();
    if !is_bytes(&head.headers) {
        return Err(UploadError::MediaType);
    }
    let bytes = http_body::Body::size_hint(&body).lower();
    let upload = inner.admit(names, &head, bytes).await?;
    let token = token(&head.headers).filter(|_| matches!(inner.access, Access::Tokens(_)));
    let place = Workplace::make(&inner.folder, &upload.file, upload.turn).await?;
    let mut stopping = inner.stopping.clone();
    let received = tokio::select! {
        received = place.receive(body, inner.max_bytes) => received,
        () = inner.access.clone().revoked(upload.admitted.caller().clone()) => Err(RpcError::Revoked.into()),
        _ = stopping.wait_for(|stopping| *stopping) => Err(UploadError::Stopping),
    };
    let bytes = match received {
        Ok(bytes) => bytes,
        Err(refusal) => {
            place.clear().await;
            return Err(refusal);
        }
    };
    let origin = Origin { services: inner.services.clone(), access: inner.access.clone(), stopping };
    let Upload { program, map, key, has_update, .. } = upload;
    let import = Import { program, map, key, has_update, token, bytes, place, origin };
    Ok(Body::from_stream(ReceiverStream::new(import.start(upload.admitted))))
}
