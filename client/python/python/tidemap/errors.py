"""Exceptions: the words are the daemon's, the class is for programs.

Invariant: each code of gRPC gives the same class, and every class is a TidemapError.
"""

from __future__ import annotations


class TidemapError(Exception):
    """A request that the daemon refused, or that failed. ``code`` is the name of the gRPC code, such as
    ``NOT_FOUND``."""

    def __init__(self, message: str, code: str = "UNKNOWN") -> None:
        super().__init__(message)
        self.code = code


class InvalidArgument(TidemapError, ValueError):
    """An argument is not valid; the message states which, and what to do."""


class NotFound(TidemapError, LookupError):
    """A map, a state, a node or a job of that name is not there."""


class AlreadyExists(TidemapError):
    """The name is taken, or another stream of the same producer is open."""


class FailedPrecondition(TidemapError):
    """The request is not possible in the present state, for example because these rows differ from the rows that were
    sent before."""


class ResourceExhausted(TidemapError):
    """A limit is reached, or the disk of the daemon is full."""


class PermissionDenied(TidemapError, PermissionError):
    """The token does not allow it."""


class Unauthenticated(TidemapError, PermissionError):
    """A token is needed, or this one is not known."""


class Unavailable(TidemapError, ConnectionError):
    """No daemon responds, or it cannot respond now."""


_CLASSES: dict[str, type[TidemapError]] = {
    "INVALID_ARGUMENT": InvalidArgument,
    "OUT_OF_RANGE": InvalidArgument,
    "NOT_FOUND": NotFound,
    "ALREADY_EXISTS": AlreadyExists,
    "FAILED_PRECONDITION": FailedPrecondition,
    "RESOURCE_EXHAUSTED": ResourceExhausted,
    "PERMISSION_DENIED": PermissionDenied,
    "UNAUTHENTICATED": Unauthenticated,
    "UNAVAILABLE": Unavailable,
}


def of_code(code: str, message: str) -> TidemapError:
    """The exception for a code."""
    return _CLASSES.get(code, TidemapError)(message, code)
