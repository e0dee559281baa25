"""A daemon of one's own, for notebooks and tests.

Invariant: the daemon listens on this machine only, and ends with the process that started it.
"""

from __future__ import annotations

import atexit
import os
import shutil
import signal
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import Any

from tidemap.client import Client
from tidemap.errors import TidemapError

_STARTS_WITHIN_SECS = 60.0
_STOPS_WITHIN_SECS = 30.0


def find_daemon() -> Path:
    """The program ``tidemapd``: ``$TIDEMAPD``, the one in the wheel, or the one on the PATH."""
    named = os.environ.get("TIDEMAPD")
    candidates = [Path(named)] if named else []
    candidates.append(Path(__file__).parent / "bin" / "tidemapd")
    on_path = shutil.which("tidemapd")
    if on_path:
        candidates.append(Path(on_path))
    for candidate in candidates:
        if candidate.is_file() and os.access(candidate, os.X_OK):
            return candidate
    raise TidemapError(
        "no program tidemapd: install the package of the daemon, or set TIDEMAPD to its path", "NOT_FOUND"
    )


class Daemon:
    """A running daemon. Use it as a context manager, or call ``stop()``."""

    def __init__(
        self,
        data_dir: str | Path | None = None,
        *arguments: str,
        listen: str = "127.0.0.1:0",
        http_listen: str = "127.0.0.1:0",
    ) -> None:
        self._own = None if data_dir is not None else Path(tempfile.mkdtemp(prefix="tidemap-"))
        self.data_dir = Path(data_dir) if data_dir is not None else self._own or Path()
        program = find_daemon()
        command = [
            str(program), "--data-dir", str(self.data_dir / "data" if self._own else self.data_dir),
            "--listen", listen, "--http-listen", http_listen, *arguments,
        ]
        self._process = subprocess.Popen(  # noqa: S603
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self._started_by = os.getpid()
        self._log: list[str] = []
        self._reader = threading.Thread(target=self._read_log, daemon=True)
        self._reader.start()
        try:
            self.grpc, self.http = self._ports()
        except BaseException:
            self.stop()
            raise
        atexit.register(self.stop)

    def _read_log(self) -> None:
        stream = self._process.stderr
        if stream is None:
            return
        for line in stream:
            self._log.append(line)
            del self._log[:-200]

    def _ports(self) -> tuple[str, str]:
        stream = self._process.stdout
        timer = threading.Timer(_STARTS_WITHIN_SECS, self._process.kill)
        timer.start()
        line = stream.readline() if stream is not None else ""
        timer.cancel()
        parts = dict(part.split("=", 1) for part in line.split() if "=" in part)
        if "grpc" not in parts:
            self._process.wait(timeout=_STOPS_WITHIN_SECS)
            self._reader.join(timeout=1)
            raise TidemapError("the daemon did not start: " + "".join(self._log[-5:]).strip(), "UNAVAILABLE")
        return parts["grpc"], parts.get("http", "")

    def connect(self, **credentials: Any) -> Client:
        """A client of this daemon."""
        return Client(self.grpc, **credentials)

    @property
    def page(self) -> str:
        """The address of its page."""
        return self.http if self.http.startswith("http") else f"http://{self.http}"

    def kill(self) -> None:
        """Ends the daemon at once, as kill -9 does; for tests of durable data."""
        self._process.kill()
        self._process.wait(timeout=_STOPS_WITHIN_SECS)

    def stop(self) -> None:
        """Ends the daemon in order. Data in a given folder stays; a folder of its own is removed."""
        atexit.unregister(self.stop)
        if self._started_by != os.getpid():
            # A child of a fork may end before the process that the daemon belongs to.
            return
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(timeout=_STOPS_WITHIN_SECS)
            except subprocess.TimeoutExpired:
                self.kill()
        self._reader.join(timeout=1)
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()
        if self._own is not None:
            shutil.rmtree(self._own, ignore_errors=True)
            self._own = None

    def __enter__(self) -> Daemon:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def serve(
    data_dir: str | Path | None = None,
    *arguments: str,
    listen: str = "127.0.0.1:0",
    http_listen: str = "127.0.0.1:0",
) -> Daemon:
    """Starts a daemon on free ports of this machine; without ``data_dir``, its data is removed when it ends.

    ``arguments`` are further options of ``tidemapd``, ``listen`` and ``http_listen`` its addresses.
    """
    return Daemon(data_dir, *arguments, listen=listen, http_listen=http_listen)
