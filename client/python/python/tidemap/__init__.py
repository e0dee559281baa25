"""tidemap: the map service that learns when.

``connect()`` gives a client of a daemon, ``serve()`` starts one, and ``tidemap.models`` has the temporal models in
process. Times are ``datetime64``, ``datetime``, ISO 8601 texts, or integers of nanoseconds UTC.
"""

from tidemap._native import __version__
from tidemap.client import Client, Grid, Observed, Predictions, Producer, connect
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

__all__ = [
    "AlreadyExists",
    "Client",
    "Daemon",
    "FailedPrecondition",
    "Grid",
    "InvalidArgument",
    "NotFound",
    "Observed",
    "PermissionDenied",
    "Predictions",
    "Producer",
    "ResourceExhausted",
    "TidemapError",
    "Unauthenticated",
    "Unavailable",
    "__version__",
    "connect",
    "serve",
]
