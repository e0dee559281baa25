#!/usr/bin/env python3
"""Measures a cluster of three engines and three daemons on this machine, beside a daemon that is alone.

Prints a row of CSV for each figure: what, value, unit. Everything runs on the same processors and the same disk, so
the cluster does its work three times there. The machine should be at rest.

Invariant: a figure is of the public calls and commands. All processes and files are gone afterwards.

Usage: cluster_bench.py PROGRAMS [FIGURES]      the folder with tidemapd and tidemap; names of figures, default: all
"""

import contextlib
import csv
import io
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import threading
import time

import cluster_kit as kit

# The load of 5,000 observations a second.
LATENCY = ("bench", "latency", "--streams", "100", "--rate", "5000", "--secs", "20")
OBSERVATIONS = int(os.environ.get("CLUSTER_BENCH_OBSERVATIONS", 10_000_000))
# The number of observations that a member has missed when it joins.
JOIN_OBSERVATIONS = int(os.environ.get("CLUSTER_BENCH_JOIN", 20_000_000))
TRIALS = int(os.environ.get("CLUSTER_BENCH_TRIALS", 20))
# The load of a stream that goes on while the map changes its writer.
STEADY = ("bench", "latency", "--streams", "4", "--rate", "400")

ALONE = """\
listen = "127.0.0.1:{port}"
http_listen = "127.0.0.1:0"
data_dir = "{data}"
update_at_midnight = false
"""


def row(what, value, unit):
    csv.writer(sys.stdout).writerow([what, value, unit])
    sys.stdout.flush()


def quantiles(what, values, unit):
    """Returns rows for the middle and the ends of some values."""
    ordered = sorted(values)
    row(f"{what}: trials", len(ordered), "")
    row(f"{what}: p50", round(ordered[len(ordered) // 2], 3), unit)
    row(f"{what}: p90", round(ordered[min(len(ordered) - 1, len(ordered) * 9 // 10)], 3), unit)
    row(f"{what}: longest", round(ordered[-1], 3), unit)


def megabytes(folder, name=None):
    """Size of a folder, or of the contents of its folders of a name."""
    files = (file for file in folder.rglob("*") if file.is_file() and (name is None or name in file.parts))
    return round(sum(file.stat().st_size for file in files) / 1e6)


class Alone:
    """A daemon without a cluster."""

    def __init__(self, programs, folder):
        self.programs, self.folder, [self.port] = pathlib.Path(programs), folder, kit.free_ports(1)

    def __enter__(self):
        self.folder.mkdir()
        settings = self.folder / "tidemapd.toml"
        settings.write_text(ALONE.format(port=self.port, data=self.folder / "data"))
        with open(self.folder / "log", "ab") as log:
            self.daemon = subprocess.Popen([self.programs / "tidemapd", "--config", settings], stdin=subprocess.DEVNULL,
                                           stdout=log, stderr=log, env=kit.environment())
        kit.wait_until("the daemon", lambda: self.tidemap("map", "list").returncode == 0)
        return self

    def __exit__(self, *_):
        self.daemon.kill()
        self.daemon.wait()
        shutil.rmtree(self.folder)

    def tidemap(self, *words):
        return subprocess.run(kit.command(self.programs, f"127.0.0.1:{self.port}", words),
                              stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                              env=kit.environment())

    def measure(self, *words):
        done = self.tidemap(*words, "--daemon-pid", str(self.daemon.pid))
        if done.returncode:
            raise kit.Failed(f"tidemap {' '.join(words)}: {done.stderr}")
        return next(csv.DictReader(io.StringIO(done.stdout)))


class Bench:
    """A cluster, and its measurements."""

    def __init__(self, programs, folder):
        self.programs, self.folder, self.count = programs, folder, 0

    @contextlib.contextmanager
    def cluster(self, without=None):
        """A cluster whose daemons run, but for that of the host `without`."""
        self.count += 1
        folder, ports = self.folder / str(self.count), kit.free_ports(9)
        hosts = [kit.Host(name, "127.0.0.1", *ports[index * 3:index * 3 + 3], folder / name)
                 for index, name in enumerate(kit.NAMES)]
        cluster = kit.Cluster(hosts, self.programs, at_midnight="false")
        try:
            for host in hosts:
                cluster.start(host, "engine")
            for host in hosts:
                if host.name != without:
                    cluster.start(host, "daemon")
            kit.wait_until("the daemons", lambda: cluster.tidemap(hosts[0], "cluster", "status")[0] == 0)
            yield cluster
        except kit.Failed:
            for host in hosts:
                log = (host.folder / "daemon.log").read_text().splitlines()
                print(f"{host.name}:", *log[-20:], sep="\n", file=sys.stderr)
            raise
        finally:
            cluster.stop()
            shutil.rmtree(folder, ignore_errors=True)

    def measure(self, cluster, host, *words, timeout=3600):
        """The figures of a benchmark that runs against a host's daemon."""
        pid = () if "lag" in words else ("--daemon-pid", str(host.daemon.pid))
        code, rows, said = cluster.tidemap(host, *words, *pid, timeout=timeout)
        if code:
            raise kit.Failed(f"tidemap {' '.join(words)} at {host.name} ended with {code}: {said}")
        return rows[0]

    def alone(self):
        self.count += 1
        return Alone(self.programs, self.folder / str(self.count))

    def acknowledgements(self):
        """Time until an observation is acknowledged, at 5,000 a second over 100 streams."""
        with self.alone() as alone:
            figures = alone.measure(*LATENCY)
        for what in ("p50_ms", "p99_ms", "max_ms"):
            row(f"acknowledgement, a daemon alone: {what[:-3]}", figures[what], "ms")
        with self.cluster() as cluster:
            figures = self.measure(cluster, cluster.hosts[0], *LATENCY)
        for what in ("p50_ms", "p99_ms", "max_ms"):
            row(f"acknowledgement, cluster: {what[:-3]}", figures[what], "ms")

    def throughput(self):
        """Observations a second, and their update."""
        words = ("bench", "observe", "--observations", str(OBSERVATIONS))
        with self.alone() as alone:
            before = alone.measure(*words)
        with self.cluster() as cluster:
            after = self.measure(cluster, cluster.hosts[0], *words)
        for what, figures in (("a daemon alone", before), ("cluster", after)):
            row(f"throughput, {what}", figures["observations_per_sec"], "observations/s")
            row(f"throughput, {what}: CPU of the daemon", figures["daemon_cpu_secs"], "s")
            row(f"throughput, {what}: update afterwards", figures["update_secs"], "s")
        share = float(after["observations_per_sec"]) / float(before["observations_per_sec"])
        row("throughput, cluster to a daemon alone", round(share, 2), "")

    def lag(self):
        """Time from an acknowledgement until another daemon shows the observation."""
        with self.cluster() as cluster:
            first, second = cluster.hosts[:2]
            words = ("bench", "lag", "--reader", second.address)
            quiet = self.measure(cluster, first, *words)
            load = threading.Thread(target=cluster.tidemap, args=(first, *LATENCY))
            load.start()
            # Waits until the streams of the load are open.
            time.sleep(3)
            loaded = self.measure(cluster, first, *words, "--secs", "15")
            load.join()
        for what, figures in (("no load", quiet), ("at 5,000 observations/s", loaded)):
            for name in ("p50_ms", "p99_ms", "max_ms", "again_p50_ms"):
                row(f"lag of a follower, {what}: {name[:-3]}", figures[name], "ms")

    def steady(self, cluster, host, secs, during):
        """The longest time without an acknowledgement while `during` does something to the map of a stream."""
        known = {known["map"] for known in cluster.tidemap(host, "cluster", "maps")[1]}
        found = []

        def run():
            found.append(self.measure(cluster, host, *STEADY, "--secs", str(secs)))

        stream = threading.Thread(target=run)
        stream.start()

        def held():
            rows = [line for line in cluster.tidemap(host, "cluster", "maps")[1] if line["map"] not in known]
            roles = sorted(line["role"] for line in rows)
            return rows if roles == ["following", "following", "writing"] else None

        rows = kit.wait_until("three replicas", held)
        # Waits until the members have reported it.
        time.sleep(2)
        during(rows[0]["map"], next(line["member"] for line in rows if line["role"] == "writing"))
        stream.join()
        if not found:
            raise kit.Failed("the stream has failed")
        return float(found[0]["max_ms"]) / 1000

    def moves(self):
        """A map changes its writer by `tidemap cluster move`."""
        gaps, told = [], []
        with self.cluster() as cluster:
            host = cluster.hosts[0]

            def move(name, writer):
                other = next(known.name for known in cluster.hosts if known.name != writer)
                begun = time.monotonic()
                rows = cluster.must(host, "cluster", "move", name, other)
                told.append(float(rows[0].get("secs") or time.monotonic() - begun))

            for _ in range(TRIALS):
                gaps.append(self.steady(cluster, host, 8, move))
        quantiles("hand-over, the longest acknowledgement", gaps, "s")
        quantiles("hand-over, the command", told, "s")

    def failovers(self):
        """The writer of a map is killed; its stream goes through another daemon."""
        gaps = []
        with self.cluster() as cluster:
            host = cluster.hosts[0]

            def kill(name, writer):
                if writer == host.name:
                    writer = cluster.hosts[1 + len(gaps) % 2].name
                    cluster.must(host, "cluster", "move", name, writer)
                    time.sleep(1)
                cluster.kill(cluster.host(writer), "daemon")

            for _ in range(TRIALS):
                gaps.append(self.steady(cluster, host, 14, kill))
                for each in cluster.hosts:
                    cluster.start(each, "daemon")
                kit.wait_until("the daemon", lambda: cluster.tidemap(host, "cluster", "status")[0] == 0)
        quantiles("failover to the first acknowledgement", gaps, "s")

    def engine_failovers(self):
        """The engine beside the first daemon is killed: it leads a third of all logs, and of the leases."""
        gaps = []
        with self.cluster() as cluster:
            host = cluster.hosts[0]

            def kill(_, __):
                cluster.kill(cluster.hosts[1 + len(gaps) % 2], "engine")

            for _ in range(TRIALS):
                gaps.append(self.steady(cluster, host, 16, kill))
                for each in cluster.hosts:
                    cluster.start(each, "engine")
                kit.wait_until("the engine", lambda: cluster.tidemap(host, "cluster", "status")[0] == 0)
                time.sleep(3)
        quantiles("a killed engine server, the longest acknowledgement", gaps, "s")

    def join(self):
        """A member with an empty disk joins a map with a long log."""
        with self.cluster(without="west") as cluster:
            host, third = cluster.hosts[0], cluster.hosts[2]
            self.measure(cluster, host, "bench", "observe", "--keep", "--observations", str(JOIN_OBSERVATIONS))
            row("join: observations in the map", JOIN_OBSERVATIONS, "")
            row("join: log of the writer", megabytes(host.data, "log"), "MB")
            names = {line["map"] for line in cluster.must(host, "cluster", "maps")}
            begun = time.monotonic()
            cluster.start(third, "daemon")

            def holds():
                rows = cluster.tidemap(host, "cluster", "maps")[1]
                return all(any(line["map"] == name and line["member"] == "west" and line["role"] == "following"
                               for line in rows) for name in names)

            kit.wait_until("the third member", holds, within=600, pause=0.1)
            row("join, from the start of its daemon until it follows", round(time.monotonic() - begun, 1), "s")
            row("join: folder of the new member", megabytes(third.data), "MB")


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    kit.stop_on_signals()
    with tempfile.TemporaryDirectory(prefix="tidemap-cluster-bench-", dir=os.environ.get("TMPDIR")) as name:
        bench = Bench(sys.argv[1], pathlib.Path(name))
        figures = {"acknowledgements": bench.acknowledgements, "throughput": bench.throughput, "lag": bench.lag,
                   "moves": bench.moves, "failovers": bench.failovers, "engine-failovers": bench.engine_failovers,
                   "join": bench.join}
        asked = sys.argv[2:] or list(figures)
        unknown = [each for each in asked if each not in figures]
        if unknown:
            sys.exit(f"cluster-bench: no figure {', '.join(unknown)}; figures: {', '.join(figures)}")
        row("what", "value", "unit")
        for each in asked:
            figures[each]()


if __name__ == "__main__":
    try:
        main()
    except kit.Failed as failed:
        sys.exit(f"cluster-bench: {failed}")
