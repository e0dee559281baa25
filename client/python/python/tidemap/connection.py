"""The connection to a daemon: any RPC by its name, and times as the map of a request means them.

Invariant: a time without a zone is never taken for UTC unless the map is in UTC or the user says so.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tidemap import times as _times
from tidemap._native import NativeClient, Replies, model_request
from tidemap.errors import InvalidArgument, TidemapError
from tidemap.times import Time


def _bytes_of(what: str | Path | bytes | None) -> bytes | None:
    return what if what is None or isinstance(what, bytes) else Path(what).read_bytes()


class Stream(Iterator[dict[str, Any]]):
    """Replies of the daemon, one by one, as they come."""

    def __init__(self, native: Replies) -> None:
        self._native = native

    def __next__(self) -> dict[str, Any]:
        reply: dict[str, Any] = json.loads(next(self._native))
        return reply

    def close(self) -> None:
        """Wants no further reply. A thread that waits for one gets the end."""
        self._native.cancel()


class Connection:
    """A connection to a daemon. Other threads of Python run while it waits."""

    def __init__(
        self,
        server: str = "127.0.0.1:7435",
        *,
        token: str | None = None,
        ca: str | Path | bytes | None = None,
        certificate: str | Path | bytes | None = None,
        key: str | Path | bytes | None = None,
    ) -> None:
        self._native = NativeClient(server, token, _bytes_of(ca), _bytes_of(certificate), _bytes_of(key))
        self._zones: dict[str, str] = {}

    @property
    def server(self) -> str:
        """Its address."""
        return self._native.server

    def __repr__(self) -> str:
        return f"<tidemap.Client of {self.server}>"

    def stream(self, method: str, request: dict[str, Any] | None = None, *, zone: str | None = None) -> Stream:
        """The replies of ``SERVICE/METHOD``, one by one, as the API page of the guide describes them."""
        given = request or {}
        name = str(given.get("map", given.get("name", "")))
        return Stream(self._native.call(method, json.dumps(self._prepared(given, name, zone))))

    def call(self, method: str, request: dict[str, Any] | None = None, *, zone: str | None = None) -> dict[str, Any]:
        """The one reply of ``SERVICE/METHOD``. Times of the request may have any form."""
        replies = list(self.stream(method, request, zone=zone))
        if len(replies) != 1:
            raise TidemapError(f"{method} gave {len(replies)} replies: use stream()", "INTERNAL")
        return replies[0]

    def _zone_now(self, map: str) -> str:
        """The zone of a map, asked of the daemon."""
        found = str(self.call("MapService/GetMap", {"name": map})["map"]["time_zone"])
        self._zones[map] = found
        return found

    def _zone(self, map: str) -> str:
        """The zone of a map, for what is shown: it never changes while the map exists."""
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
            raise InvalidArgument(f"{len(nanos)} times where one is asked for", "INVALID_ARGUMENT")
        return int(nanos[0])

    def _prepared(self, value: Any, map: str, zone: str | None) -> Any:
        """A request as JSON has it: times become texts, and the name of a model what it stands for."""
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
