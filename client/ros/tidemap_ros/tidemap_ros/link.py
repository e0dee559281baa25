"""The daemon, as the node needs it.

Invariant: nothing connects before a caller needs it.
"""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import tidemap
from tidemap.client import Client
from tidemap.producer import Producer
from tidemap_ros.charts import grid_of
from tidemap_ros.parameters import BadParameter, Settings
from tidemap_ros.sender import PATIENCE_SECS, MapGrid


class Link:
    """The daemon and the map of the parameters."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        files = [name for name in ("ca", "certificate", "key") if settings.text(f"{name}_file")]
        credentials: dict[str, Any] = {name: _file(settings, f"{name}_file") for name in files}
        if settings.text("token_file"):
            credentials["token"] = _file(settings, "token_file").decode().strip()
        try:
            self.client = Client(settings.text("server"), **credentials)
        except tidemap.TidemapError as error:
            raise BadParameter(f"the parameter server is {settings.text('server')!r}: {error}") from None
        self._is_there = False

    @property
    def producer_name(self) -> str:
        """The name of the producer."""
        return self._settings.text("producer") or socket.gethostname()

    def ensure_map(self) -> None:
        """Creates the map if the parameters say so."""
        if self._is_there or not self._settings.flag("create_map"):
            return
        settings = self._settings
        try:
            self.client.create_map(
                settings.text("map"), time_zone=settings.text("time_zone"),
                grid_resolution_m=settings.number("resolution"),
                grid={"flat": settings.flag("flat"), "frame_id": settings.text("map_frame")},
            )
        except tidemap.AlreadyExists:
            pass
        self._is_there = True

    def open_producer(self) -> Producer:
        """An open producer; raises the error of the daemon, or of the missing connection."""
        self.ensure_map()
        # Times are numbers of nanoseconds, which have no zone.
        return self.client.producer(
            self._settings.text("map"), self.producer_name, self._settings.text("label"), patience_secs=PATIENCE_SECS
        )

    def grid_of_map(self) -> MapGrid | None:
        """The grid of the map."""
        return grid_of(self.map())

    def map(self) -> dict[str, Any]:
        """The map, as the daemon describes it."""
        return dict(self.client.call("MapService/GetMap", {"name": self._settings.text("map")})["map"])


def _file(settings: Settings, name: str) -> bytes:
    try:
        return Path(settings.text(name)).read_bytes()
    except OSError as error:
        raise BadParameter(f"the parameter {name}: {error}") from None
