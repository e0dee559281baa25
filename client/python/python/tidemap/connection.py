"""The connection to a daemon: any RPC by its name, and times in the zone of the map of a request.

Invariant: a time without a zone is never taken for UTC unless the map is in UTC or the user states it. A pickle holds
no secret, and no open connection.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from tidemap import times as _times
from tidemap._native import NativeClient, Replies, model_request
from tidemap.errors import InvalidArgument, TidemapError
from tidemap.times import Time


C = TypeVar("C", bound="Connection")


def _bytes_of(what: str | Path | bytes | None) -> bytes | None:
    return what if what is None or isinstance(what, bytes) else Path(what).read_bytes()


def _kept(what: str | Path | bytes | None) -> str | bytes | None:
    """The form of a value in a pickle: a path that is valid in any folder."""
    return what if what is None or isinstance(what, bytes) else str(Path(what).absolute())


class Stream(Iterator[dict[str, Any]]):
    """Replies of the daemon, one by one, as they come."""

    def __init__(self, native: Replies) -> None:
        self._native = native

    def __next__(self) -> dict[str, Any]:
        reply: dict[str, Any] = json.loads(next(self._native))
        return reply

    def close(self) -> None:
        """Ends the stream: no further reply is wanted. A thread that waits for a reply gets the end of the stream."""
        self._native.cancel()

    def __reduce__(self) -> Any:
        raise pickle.PicklingError("a stream of replies is not pickled: it is an open call of this process")


class Connection:
    """A connection to a daemon. Other threads of Python run while it waits.

    ``token_file`` is a file that holds the token, ``token`` the token itself; ``ca``, ``certificate`` and ``key`` are
    files or their content. At most 64 requests are under way at a time, others wait for their turn; if the daemon has
    no room, a request is sent again at the time that the daemon states, for at most a minute.

    A process that was forked gets connections of its own. A pickle has the address and the files, by absolute paths,
    and connects anew where it is loaded. A client whose token or private key was given as text is not pickled, because
    the pickle would contain the secret.
    """

    def __init__(
        self,
        server: str = "127.0.0.1:7435",
        *,
        token: str | None = None,
        token_file: str | Path | None = None,
        ca: str | Path | bytes | None = None,
        certificate: str | Path | bytes | None = None,
        key: str | Path | bytes | None = None,
    ) -> None:
        if token is not None and token_file is not None:
            raise InvalidArgument("token and token_file are both given: one of them is the token", "INVALID_ARGUMENT")
        given = token if token_file is None else Path(token_file).read_text().strip()
        self._native = NativeClient(server, given, _bytes_of(ca), _bytes_of(certificate), _bytes_of(key))
        self._has_secret_text = token is not None or isinstance(key, bytes)
        self._given = {
            "server": server, "token_file": _kept(token_file), "ca": _kept(ca), "certificate": _kept(certificate),
            "key": None if isinstance(key, bytes) else _kept(key),
        }
        self._zones: dict[str, str] = {}

    def close(self) -> None:
        """Closes the connections. Calls that wait go on to their end; later ones are refused."""
        self._native.close()

    def __enter__(self: C) -> C:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __getstate__(self) -> dict[str, Any]:
        if self._has_secret_text:
            raise pickle.PicklingError(
                "a client whose token or key was given as text is not pickled, because the secret would lie in the "
                "pickle: give token_file=PATH, and key=PATH"
            )
        return dict(self._given)

    def __setstate__(self, given: dict[str, Any]) -> None:
        server = given.pop("server")
        Connection.__init__(self, server, **given)

    @property
    def server(self) -> str:
        """The address of the daemon."""
        return self._native.server

    def __repr__(self) -> str:
        return f"<tidemap.Client of {self.server}>"

    def stream(self, method: str, request: dict[str, Any] | None = None, *, zone: str | None = None) -> Stream:
        """The replies of ``SERVICE/METHOD``, one by one, as the API page of the guide describes them."""
        given = request or {}
        name = str(given.get("map", given.get("name", "")))
        return Stream(self._native.call(method, json.dumps(self._prepared(given, name, zone))))

    def call(self, method: str, request: dict[str, Any] | None = None, *, zone: str | None = None) -> dict[str, Any]:
        """The single reply of ``SERVICE/METHOD``. Times of the request may have any form."""
        replies = list(self.stream(method, request, zone=zone))
        if len(replies) != 1:
            raise TidemapError(f"{method} gave {len(replies)} replies: use stream()", "INTERNAL")
        return replies[0]

    def _zone_now(self, map: str) -> str:
        """The zone of a map, requested from the daemon."""
        found = str(self.call("MapService/GetMap", {"name": map})["map"]["time_zone"])
        self._zones[map] = found
        return found

    def _zone(self, map: str) -> str:
        """The zone of a map, for output: the zone never changes while the map exists."""
        return self._zones.get(map) or self._zone_now(map)

    def _nanos(
        self,
        map: str,
        times: Any,
        zone: str | None,
        states: npt.NDArray[np.uint32] | None = None,
        source: npt.NDArray[np.intp] | None = None,
    ) -> npt.NDArray[np.int64]:
        given = times if isinstance(times, _times.Read) else _times.read(times)
        return _times.resolve(given, zone, lambda: self._zone_now(map), states, source)

    def _moment(self, map: str, time: Time, zone: str | None) -> int:
        nanos = self._nanos(map, time, zone)
        if len(nanos) != 1:
            raise InvalidArgument(f"{len(nanos)} times where one is required", "INVALID_ARGUMENT")
        return int(nanos[0])

    def _prepared(self, value: Any, map: str, zone: str | None) -> Any:
        """A request in the form of JSON: times become texts, and the name of a model becomes its message."""
        if isinstance(value, dict):
            prepared = {key: self._prepared(item, map, zone) for key, item in value.items()}
            if isinstance(value.get("model"), str):
                prepared["model"] = json.loads(model_request(value["model"]))
            return prepared
        if isinstance(value, (list, tuple)):
            return [self._prepared(item, map, zone) for item in value]
        if isinstance(value, np.datetime64) or hasattr(value, "tzinfo"):
            return _times.timestamp(self._moment(map, value, zone))
        if isinstance(value, np.ndarray):
            return self._prepared(value.tolist(), map, zone)
        return value.item() if isinstance(value, np.generic) else value
