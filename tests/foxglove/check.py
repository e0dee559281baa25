"""Queries `tidemap foxglove` by the protocol of Foxglove: python check.py FOLDER_OF_PROGRAMS

A daemon gets a map with a grid, a topological map and a door that is open by day. The time bar is moved to times of the
past and of the future, and the messages that follow are compared with what other commands print.

Invariant: the client follows the protocol's documentation and shares no code with the server. Nothing is left behind.
"""

import asyncio
import base64
import csv
import io
import json
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from datetime import datetime, timedelta, timezone
from pathlib import Path

import websockets

# The opcodes of binary messages.
MESSAGE, TIME, PLAYBACK_STATE, PLAYBACK_REQUEST = 1, 2, 5, 3
PAUSE, PLAY = 1, 0
PAUSED, PLAYING, ENDED = 1, 0, 3
SECOND = 1_000_000_000
WITHIN_SECS = 20
TOPICS = ("/grid", "/topology", "/states/door", "/anomalies")
HEAD = """# .PCD v0.7
VERSION 0.7
FIELDS x y z
SIZE 4 4 4
TYPE F F F
COUNT 1 1 1
WIDTH 3
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 3
DATA ascii
2 0 0
0 2 0
"""


def started(command: list, says: str) -> tuple[subprocess.Popen, str]:
    """Starts a program, and waits for a line with these words on stdout or stderr."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    for line in process.stdout:
        if says in line:
            return process, line.strip()
    raise AssertionError(f"{command} ended with {process.wait()}")


class Daemon:
    """A daemon with a map."""

    def __init__(self, programs: Path, folder: Path):
        self.programs, self.folder = programs, folder
        ports = ["--listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0"]
        self.process, line = started([programs / "tidemapd", "--data-dir", folder / "data", *ports], "listening grpc=")
        self.address = line.split("grpc=")[1].split()[0]

    def run(self, *words: str, stdin: str = "") -> list[dict]:
        """Runs a command, and returns the rows that it prints."""
        command = [self.programs / "tidemap", "--server", self.address, "--output", "csv", *words]
        ended = subprocess.run(command, input=stdin, capture_output=True, text=True)
        assert ended.returncode == 0, (words, ended.stderr)
        return list(csv.DictReader(io.StringIO(ended.stdout)))

    def fill(self, today: datetime) -> None:
        """Three weeks before today: a door, scans, and traversals of two nodes."""
        self.run("map", "create", "home", "--time-zone", "UTC", "--grid", "resolution=0.5,origin=-4:-4:0,flat")
        rows = "time,state,value\n"
        for hour in range(1, 21 * 24):
            at = today - timedelta(hours=hour)
            rows += f"{at.timestamp()},door,{int(9 <= at.hour < 17)}\n"
        self.run("observe", "home", "-", "--producer", "robot", stdin=rows)
        first, scans = today - timedelta(days=21) + timedelta(hours=1), []
        for scan in range(20 * 6):
            at = first + timedelta(hours=4 * scan)
            path = self.folder / f"scan-{scan:03}.pcd"
            path.write_text(HEAD + ("0 -3 0\n" if 8 <= at.hour < 20 else "0 -1 0\n"))
            scans.append(str(path))
        times = ["--at", str(first.timestamp()), "--every", "4h"]
        self.run("grid", "observe", "home", *scans, *times, "--pose", "0,0,0", "--producer", "robot")
        self.run("topology", "load", "home", "-", stdin="node A\nnode B\nlink A B 10\n")
        self.run("topology", "edit", "set-node", "home", "A", "--position", "0,0")
        self.run("topology", "edit", "set-node", "home", "B", "--position", "2,1")
        self.run("update", "home")


class Foxglove:
    """A client, which has subscribed to the topics."""

    def __init__(self, socket):
        self.socket, self.server, self.channels, self.states = socket, {}, {}, []

    async def begin(self) -> None:
        while len(self.channels) < len(TOPICS) or not self.server:
            message = json.loads(await asyncio.wait_for(self.socket.recv(), WITHIN_SECS))
            if message["op"] == "serverInfo":
                self.server = message
            if message["op"] == "advertise":
                self.channels |= {one["topic"]: one for one in message["channels"] if one["topic"] in TOPICS}
        wanted = [dict(id=at, channelId=self.channels[topic]["id"]) for at, topic in enumerate(TOPICS)]
        await self.socket.send(json.dumps(dict(op="subscribe", subscriptions=wanted)))

    async def request(self, command: int, speed: float, seek: int | None, name: str) -> None:
        text = name.encode()
        await self.socket.send(
            struct.pack("<BBfBQI", PLAYBACK_REQUEST, command, speed, seek is not None, seek or 0, len(text)) + text
        )

    async def next(self) -> tuple:
        """The next message of a topic, or state of the time bar."""
        while True:
            message = await asyncio.wait_for(self.socket.recv(), WITHIN_SECS)
            if isinstance(message, str):
                assert json.loads(message)["op"] != "status", message
            elif message[0] == MESSAGE:
                topic, at = struct.unpack_from("<IQ", message, 1)
                return TOPICS[topic], at, json.loads(message[13:])
            elif message[0] == PLAYBACK_STATE:
                status, at, speed, did_seek, length = struct.unpack_from("<BQfBI", message, 1)
                return "state", at, dict(status=status, speed=speed, seek=did_seek, name=message[19 : 19 + length].decode())

    async def seek(self, at: int) -> tuple[dict, float]:
        """Moves the time bar; returns the message of each topic, and after how many seconds the last of them came."""
        name = f"seek-{at}"
        begin = time.monotonic()
        await self.request(PAUSE, 1.0, at, name)
        found = {}
        while len(found) < len(TOPICS) + 1:
            topic, message_at, message = await self.next()
            if topic == "state" and message["name"] == name:
                assert (message_at, message["status"], message["seek"]) == (at, PAUSED, 1), message
                found[topic] = message
            elif topic != "state" and message_at == at:
                found[topic] = message
        return found, time.monotonic() - begin


def nanos(at: dict) -> int:
    return at["sec"] * SECOND + at["nsec"]


def cells(grid: dict) -> dict:
    """Returns the percents of the known cells of a foxglove.Grid, by their centre."""
    data = base64.b64decode(grid["data"])
    percents = struct.unpack(f"{len(data)}b", data)
    side, width = grid["cell_size"]["x"], grid["column_count"]
    corner = grid["pose"]["position"]
    return {
        (round(corner["x"] + (at % width + 0.5) * side, 6), round(corner["y"] + (at // width + 0.5) * side, 6)): percent
        for at, percent in enumerate(percents)
        if percent >= 0
    }


def compare(daemon: Daemon, at: int, found: dict) -> None:
    """Checks that the messages for a time equal the output of other commands for it."""
    text = f"{at / SECOND:.0f}"
    out = daemon.folder / "cells.csv"
    daemon.run("grid", "predict", "home", "--at", text, "--out", str(out))
    rows = csv.DictReader(out.open())
    expected = {(float(row["x"]), float(row["y"])): round(float(row["probability"]) * 100) for row in rows}
    assert cells(found["/grid"]) == expected, (text, cells(found["/grid"]), expected)
    [door] = daemon.run("predict", "home", "door", "--at", text)
    assert abs(found["/states/door"]["value"] - float(door["probability"])) < 1e-9, (found["/states/door"], door)
    graph = json.loads(found["/topology"]["geojson"])
    assert [one["geometry"]["type"] for one in graph["features"]] == ["Point"] * 2 + ["MultiLineString"] * 2
    assert nanos(found["/anomalies"]["timestamp"]) == at


async def check(daemon: Daemon, url: str, today: datetime) -> list[float]:
    async with websockets.connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        client = Foxglove(socket)
        await client.begin()
        assert "playbackControl" in client.server["capabilities"], client.server
        first, last = nanos(client.server["dataStartTime"]), nanos(client.server["dataEndTime"])
        midnight = int(today.timestamp()) * SECOND
        assert first <= midnight - 20 * 86_400 * SECOND and last >= midnight + 7 * 86_400 * SECOND, client.server
        day, hour = 86_400 * SECOND, 3_600 * SECOND
        took, doors = [], []
        for at in [midnight + step * day + clock * hour for step in (-10, -1, 2, 6) for clock in (3, 12)]:
            found, secs = await client.seek(at)
            compare(daemon, at, found)
            took.append(secs)
            doors.append(found["/states/door"]["value"])
        assert all(night < 0.3 and noon > 0.7 for night, noon in zip(doors[::2], doors[1::2])), doors
        # A time beyond the end moves the bar to the end.
        await client.request(PLAY, 1.0, last + 5 * day, "beyond")
        while (got := await client.next())[0] != "state" or got[2]["name"] != "beyond":
            pass
        assert got[1] == last and got[2]["status"] == ENDED, got
        # While it plays the time moves, at the requested speed, until the end.
        await client.request(PLAY, 60.0, last - 60 * SECOND, "play")
        while (got := await client.next())[0] != "state" or got[2]["name"] != "play":
            pass
        assert got[2]["status"] == PLAYING and got[2]["speed"] == 60.0, got
        times = []
        while (got := await client.next())[0] != "state":
            times += [got[1]] if got[0] == "/states/door" else []
        # The first message may be the map of the end, which was requested before.
        times = times[times[0] == last :]
        assert (got[1], got[2]["status"], times[-1]) == (last, ENDED, last), (got, times)
        assert times == sorted(times) and len(times) > 1, times
        return took


def main() -> None:
    programs = Path(sys.argv[1]).resolve()
    today = datetime.now(timezone.utc).replace(hour=0, minute=0, second=0, microsecond=0)
    with tempfile.TemporaryDirectory() as folder:
        daemon = Daemon(programs, Path(folder))
        server = None
        try:
            daemon.fill(today)
            command = [programs / "tidemap", "--server", daemon.address, "--output", "csv", "foxglove"]
            server, line = started([*command, "--port", "0", "--ahead", "9d"], "ws://")
            url = line.split(",")[0]
            assert url.startswith("ws://127.0.0.1:"), line
            took = asyncio.run(check(daemon, url, today))
            milliseconds = [round(1_000 * secs) for secs in took]
            print(f"a seek is answered with all messages after {statistics.median(milliseconds)} ms (median), "
                  f"{max(milliseconds)} ms at most")
            open_one, warning = started([*command, "--port", "0", "--listen", "0.0.0.0", "--allow-insecure-remote"], "warning")
            open_one.kill()
            assert "no key" in warning, warning
        finally:
            for process in (server, daemon.process):
                if process:
                    process.kill()
                    process.wait()


if __name__ == "__main__":
    main()
