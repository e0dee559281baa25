"""A cluster of tidemap on one machine, for demonstrations and tests: engines and daemons as processes.

A host stands for a machine: one nats-server and one tidemapd, with a folder each. Hosts are all on loopback, or each in
a network namespace.

Invariant: no process outlives the cluster that started it, also after an error or a signal.
"""

import csv
import dataclasses
import io
import os
import pathlib
import random
import signal
import socket
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
NATS = pathlib.Path(os.environ.get("TIDEMAP_NATS_SERVER", ROOT / "target" / "nats" / "nats-server"))
NAMES = ("north", "east", "west")
# A deadline for every wait: the awaited event has happened by then, or it hangs.
WITHIN_SECS = 120
# The port at which an engine with a network of its own reports its state.
MONITOR = "127.0.0.1:8222"

ENGINE = """\
server_name: {name}
listen: "{ip}:{engine_port}"
max_payload: 2MB
{monitor}jetstream {{ store_dir: "{store}", sync_interval: always, max_file_store: 4GB }}
cluster {{ name: tidemap, listen: "{ip}:{route_port}", routes: [{routes}] }}
system_account: SYS
accounts {{
  SYS {{
    users: [{{ user: sys, password: sys }}]
    exports: [{{ service: "$SYS.REQ.SERVER.PING.VARZ", response_type: stream }}]
  }}
  TIDEMAP {{
    jetstream: enabled
    users: [{{ user: tidemap, password: tidemap }}]
    imports: [{{ service: {{ account: SYS, subject: "$SYS.REQ.SERVER.PING.VARZ" }} }}]
  }}
}}
"""

DAEMON = """\
listen = "{ip}:{port}"
http_listen = "127.0.0.1:0"
allow_insecure_remote = {is_remote}
data_dir = "{data}"
update_at_midnight = {at_midnight}
[cluster]
member = "{name}"
servers = [{servers}]
"""


class Failed(Exception):
    """An error from which a run cannot go on, in words for its user."""


def free_ports(count):
    """Ports of this machine that nobody uses now, below those that the system gives to clients."""
    found, tried = [], random.Random(os.getpid())
    while len(found) < count:
        port = tried.randrange(27000, 28000)
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        if port not in found:
            found.append(port)
    return found


@dataclasses.dataclass
class Host:
    """One machine of the cluster. `prefix` is the command line that runs a command on it."""

    name: str
    ip: str
    port: int
    engine_port: int
    route_port: int
    folder: pathlib.Path
    prefix: tuple = ()
    engine: subprocess.Popen = None
    daemon: subprocess.Popen = None

    @property
    def address(self):
        return f"{self.ip}:{self.port}"

    @property
    def store(self):
        return self.folder / "engine"

    @property
    def data(self):
        return self.folder / "data"


def command(programs, server, words):
    """The command line of these words: those after `bench` are of the load generator."""
    if words[0] == "bench":
        return [programs / "tidemap-bench", "--server", server, *words[1:]]
    return [programs / "tidemap", "--server", server, *words]


class Cluster:
    """Three hosts. `programs` is the folder with tidemapd and tidemap; `hub` runs clients."""

    def __init__(self, hosts, programs, hub=(), at_midnight="true"):
        self.hosts, self.programs, self.hub = hosts, pathlib.Path(programs), tuple(hub)
        self.at_midnight = at_midnight
        for program in (NATS, self.programs / "tidemapd", self.programs / "tidemap"):
            if not program.is_file():
                raise Failed(f"{program} is missing")
        for host in hosts:
            host.folder.mkdir(parents=True, exist_ok=True)
            self.write_files(host)

    def host(self, name):
        return next(host for host in self.hosts if host.name == name)

    def write_files(self, host):
        is_remote = "false" if host.ip == "127.0.0.1" else "true"
        monitor = f"http: {MONITOR}\n" if host.prefix else ""
        routes = ", ".join(f'"nats://{other.ip}:{other.route_port}"' for other in self.hosts)
        # A daemon connects to the engine beside it first.
        order = [host] + [other for other in self.hosts if other is not host]
        servers = ", ".join(f'"nats://tidemap:tidemap@{other.ip}:{other.engine_port}"' for other in order)
        values = dict(vars(host), routes=routes, servers=servers, store=host.store, data=host.data, monitor=monitor,
                      is_remote=is_remote, at_midnight=self.at_midnight)
        (host.folder / "nats.conf").write_text(ENGINE.format(**values))
        (host.folder / "tidemapd.toml").write_text(DAEMON.format(**values))

    def start(self, host, what):
        """Starts the `engine` or the `daemon` of a host, if it does not run."""
        if is_running(getattr(host, what)):
            return
        program = [NATS, "-c", host.folder / "nats.conf"] if what == "engine" else [
            self.programs / "tidemapd", "--config", host.folder / "tidemapd.toml"]
        with open(host.folder / f"{what}.log", "ab") as log:
            process = subprocess.Popen([*host.prefix, *program], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                       start_new_session=True)
        setattr(host, what, process)

    def start_all(self):
        for what in ("engine", "daemon"):
            for host in self.hosts:
                self.start(host, what)

    def send(self, host, what, number):
        process = getattr(host, what)
        if is_running(process):
            process.send_signal(number)

    def kill(self, host, *whats, number=signal.SIGKILL):
        """Ends processes of a host: first all signals, then the waiting."""
        for what in whats:
            self.send(host, what, number)
        for what in whats:
            process = getattr(host, what)
            if process is not None:
                process.wait(timeout=WITHIN_SECS)
                setattr(host, what, None)

    def stop(self):
        """Ends all processes. A stopped one is killed as it is."""
        for host in self.hosts:
            self.kill(host, "daemon", "engine")

    def command(self, host, *words):
        return [*self.hub, *command(self.programs, host.address, words)]

    def tidemap(self, host, *words, timeout=WITHIN_SECS):
        """Runs the command line against the daemon of a host; gives status, rows of stdout by column, and stderr."""
        try:
            done = subprocess.run(self.command(host, *words), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                  stderr=subprocess.PIPE, text=True, timeout=timeout, env=environment())
        except subprocess.TimeoutExpired:
            return 124, [], f"tidemap {' '.join(map(str, words))}: no answer in {timeout} s"
        return done.returncode, list(csv.DictReader(io.StringIO(done.stdout))), done.stderr.strip()

    def must(self, host, *words):
        """Does the same as `tidemap`, for a command that must succeed; gives the rows."""
        code, rows, words_said = self.tidemap(host, *words)
        if code:
            raise Failed(f"tidemap {' '.join(map(str, words))} at {host.name} ended with {code}: {words_said}")
        return rows

    def writer(self, map_name, timeout=10):
        """The host whose daemon writes a map, by the first daemon that replies; None if there is none."""
        for host in self.hosts:
            if not is_running(host.daemon):
                continue
            _, rows, _ = self.tidemap(host, "cluster", "maps", timeout=timeout)
            for row in rows:
                if row["map"] == map_name and row["role"] == "writing":
                    return self.host(row["member"])
        return None


def environment():
    """The environment without the settings of the user."""
    return {name: value for name, value in os.environ.items() if not name.startswith("TIDEMAP_")}


def is_running(process):
    return process is not None and process.poll() is None


def wait_until(what, look, within=WITHIN_SECS, pause=0.2):
    """Repeats `look` until it gives a true value, which is returned."""
    end = time.monotonic() + within
    while True:
        found = look()
        if found:
            return found
        if time.monotonic() > end:
            raise Failed(f"{what}: not within {within} s")
        time.sleep(pause)


def stop_on_signals():
    """Turns Ctrl-C and a request to end into exceptions, so that started processes are ended."""
    def interrupt(number, _):
        signal.signal(number, signal.SIG_IGN)
        sys.exit(128 + number)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupt)
