"""tidemap: the map service that learns when.

``connect()`` gives a client of a daemon, ``serve()`` starts one, ``tidemap.aio.connect()`` gives a client for asyncio,
and ``tidemap.models`` has the temporal models in process. Times are ``datetime64``, ``datetime``, ISO 8601 texts,
integers of nanoseconds or floats of seconds since 1970 UTC; times without a zone need a zone from the user: see
``tidemap.times``.
"""

from tidemap import aio
from tidemap._native import __version__
from tidemap.answers import Grid, Map, ObservationWarning, Observed, Predictions, Topology
from tidemap.client import Client, connect
from tidemap.daemon import Daemon, serve
from tidemap.errors import (
    AlreadyExists,
    FailedPrecondition,
    InvalidArgument,
    NotFound,
    PermissionDenied,
    ResourceExhausted,
    TidemapError,
    Unauthenticated,
    Unavailable,
)
from tidemap.producer import Producer, QueuedProducer, QueueState

__all__ = [
    "AlreadyExists",
    "Client",
    "Daemon",
    "FailedPrecondition",
    "Grid",
    "InvalidArgument",
    "Map",
    "NotFound",
    "ObservationWarning",
    "Observed",
    "PermissionDenied",
    "Predictions",
    "Producer",
    "QueueState",
    "QueuedProducer",
    "ResourceExhausted",
    "TidemapError",
    "Topology",
    "Unauthenticated",
    "Unavailable",
    "__version__",
    "aio",
    "connect",
    "serve",
]
