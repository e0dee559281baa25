"""The daemon, as the node needs it.

Invariant: nothing connects before a caller needs it.
"""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import tidemap
from tidemap.client import Client
from tidemap.producer import QueuedProducer
from tidemap_ros.parameters import BadParameter, Settings


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
        self.needs_map = settings.flag("create_map")
        """Whether the map may have to be created."""

    @property
    def producer_name(self) -> str:
        """The name of the producer."""
        return self._settings.text("producer") or socket.gethostname()

    def ensure_map(self) -> None:
        """Creates the map if the parameters say so."""
        if not self.needs_map:
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
        self.needs_map = False

    def open_queue(self, folder: Path, bytes_max: int, sync_secs: float) -> QueuedProducer:
        """The producer with its queue; does not wait for the daemon."""
        # Times are numbers of nanoseconds, which have no zone.
        return self.client.producer(
            self._settings.text("map"), self.producer_name, self._settings.text("label"), queue=folder,
            queue_bytes_max=bytes_max, queue_sync_secs=sync_secs,
        )

    def map(self) -> dict[str, Any]:
        """The map, as the daemon describes it."""
        return dict(self.client.call("MapService/GetMap", {"name": self._settings.text("map")})["map"])


def _file(settings: Settings, name: str) -> bytes:
    try:
        return Path(settings.text(name)).read_bytes()
    except OSError as error:
        raise BadParameter(f"the parameter {name}: {error}") from None
