#!/usr/bin/env python3
"""Shows a cluster: three engines and three daemons on this machine, and a writer that is killed while robots send.

Three robots send two weeks of a simulated office through one daemon. The daemon that writes the map is killed with
SIGKILL in the middle. The robots come back at another daemon and send what was not acknowledged. At the end every
observation that was acknowledged must be in the map once, as a third daemon shows it, and all logs must be equal.

Invariant: the last line is "lost: N", and the exit status is 0 only if nothing was lost, doubled or different. All
processes and files are gone afterwards, also after Ctrl-C.

Usage: cluster_demo.py PROGRAMS      the folder with tidemapd and tidemap
"""

import collections
import csv
import pathlib
import subprocess
import sys
import tempfile
import threading
import time

import cluster_kit as kit

MAP = "office"
DAYS = 14
# Duration of all days of the robots.
SENDING_SECS = 20
ROBOTS = ("robot-ada", "robot-bob", "robot-cleo")
BEGUN = time.monotonic()


def say(text):
    print(f"{time.monotonic() - BEGUN:6.1f} s  {text}", flush=True)


class Robot(threading.Thread):
    """Sends the rows of a file in pieces, as time goes by. When its daemon is gone, it goes to the next one and begins
    its file again there: the daemon reports which rows the map has, and only the others are sent."""

    def __init__(self, cluster, name, rows, hosts):
        super().__init__(daemon=True)
        self.cluster, self.name, self.rows, self.hosts = cluster, name, rows, hosts
        self.begun, self.acknowledged, self.doubtful, self.forgotten, self.error = 0.0, 0, 0, 0, None

    def run(self):
        try:
            self.begun = time.monotonic()
            for host in self.hosts:
                if self.send(host):
                    return
            raise kit.Failed(f"{self.name}: no daemon takes what it sends")
        except Exception as error:
            self.error = error

    def send(self, host):
        """Sends to one daemon; returns whether everything is acknowledged."""
        words = ["observe", MAP, "-", "--producer", self.name, "--label", "demo", "--patience"]
        # The robot gives the first daemon up at once, and waits at the next one until there is a new writer.
        words.append("1s" if host is self.hosts[0] else "60s")
        process = subprocess.Popen(self.cluster.command(host, *words), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True, env=kit.environment())
        # The process ends by itself when its daemon is gone, and stops reading.
        feeder = threading.Thread(target=self.feed, args=(process,), daemon=True)
        feeder.start()
        output = process.stdout.read()
        said = process.stderr.read()
        process.wait()
        feeder.join()
        counted = list(csv.DictReader(output.splitlines()))
        if counted:
            row = counted[0]
            new, known = int(row["accepted"]) + int(row["refused"]), int(row["duplicate"])
            if known > self.acknowledged:
                # These rows were in the log, and their acknowledgement was under way when the daemon was killed.
                self.doubtful += known - self.acknowledged
            self.forgotten += max(0, self.acknowledged - known)
            self.acknowledged = max(self.acknowledged, new + known)
        if process.returncode and "durable" not in said and "reach" not in said and not counted:
            say(f"{self.name}: {said.splitlines()[-1] if said else 'ended'}")
        return process.returncode == 0

    def feed(self, process):
        """Writes the rows to a process, each when its time has come."""
        try:
            with process.stdin as target:
                target.write("time,state,value\n")
                done = 0
                while done < len(self.rows):
                    share = min(1.0, (time.monotonic() - self.begun) / SENDING_SECS)
                    end = max(done, int(share * len(self.rows)))
                    target.writelines(self.rows[done:end])
                    target.flush()
                    done = end
                    time.sleep(0.02)
        except BrokenPipeError:
            pass


def known(cluster, host):
    """The number of observations that a daemon shows in the map, of all robots."""
    code, rows, _ = cluster.tidemap(host, "producer", "list", MAP)
    return 0 if code else sum(int(row["observations"]) for row in rows)


def kill_the_writer(cluster, first, robots):
    """Kills the writer in the middle, and waits until observations are acknowledged again; gives the time for that."""
    half = sum(len(robot.rows) for robot in robots) // 2
    kit.wait_until("half of the observations", lambda: known(cluster, first) >= half, pause=0.05)
    say(f"half of the observations are in the map; {first.name}, which writes it, is killed (kill -9)")
    killed = time.monotonic()
    cluster.kill(first, "daemon")
    other = next(host for host in cluster.hosts if host is not first)
    # Observations that were under way are there at once; a new writer is needed for more.
    time.sleep(0.5)
    before = known(cluster, other)
    kit.wait_until("a new writer", lambda: known(cluster, other) > before, pause=0.05)
    secs = time.monotonic() - killed
    writer = kit.wait_until("a new writer", lambda: cluster.writer(MAP))
    say(f"{writer.name} writes the map now; observations were acknowledged again after {secs:.1f} s")
    return secs


def compare(cluster, host, robots):
    """Compares the observations of a daemon with those that the robots sent; gives the numbers of lost, doubled and
    foreign ones."""
    sent = collections.defaultdict(collections.Counter)
    for robot in robots:
        for row in robot.rows[:robot.acknowledged]:
            moment, state, value = row.strip().split(",")
            sent[state][(float(moment), float(value))] += 1
    lost = doubled = foreign = 0
    for state, wanted in sorted(sent.items()):
        rows = cluster.must(host, "reconstruct", MAP, state, "--from", "2000-01-01T00:00:00Z", "--to",
                            "2100-01-01T00:00:00Z")
        found = collections.Counter((float(row["time"]), float(row["value"])) for row in rows)
        lost += sum((wanted - found).values())
        for key, more in (found - wanted).items():
            doubled, foreign = (doubled + more, foreign) if key in wanted else (doubled, foreign + more)
    return lost, doubled, foreign


def robots_of(cluster, folder, hosts):
    sample = folder / "sample"
    subprocess.run([cluster.programs / "tidemap", "sample", "office", sample], check=True, stdout=subprocess.DEVNULL,
                   stderr=subprocess.DEVNULL, env=kit.environment())
    robots = []
    for name in ROBOTS:
        rows = (sample / f"{name}.csv").read_text().splitlines(keepends=True)[1:]
        start = float(rows[0].split(",")[0])
        rows = [row for row in rows if float(row.split(",")[0]) < start + DAYS * 86_400]
        robots.append(Robot(cluster, name, rows, hosts))
    return robots


def show(cluster, folder):
    say("three engines (nats-server) and three daemons start: north, east and west")
    cluster.start_all()
    north = cluster.hosts[0]
    kit.wait_until("the daemons", lambda: cluster.tidemap(north, "cluster", "status")[0] == 0)
    cluster.must(north, "map", "create", MAP, "--time-zone", "Europe/London")
    kit.wait_until("three replicas", lambda: len(cluster.tidemap(north, "cluster", "maps")[1]) == 3
                   and cluster.tidemap(north, "cluster", "status")[0] == 0)
    first = kit.wait_until("a writer", lambda: cluster.writer(MAP))
    second, third = (host for host in cluster.hosts if host is not first)
    say(f"map {MAP} is on all three; {first.name} writes it")

    robots = robots_of(cluster, folder, [first, second, third])
    total = sum(len(robot.rows) for robot in robots)
    say(f"{len(robots)} robots send {total:,} observations of {DAYS} days through {first.name}")
    for robot in robots:
        robot.start()
    kill_the_writer(cluster, first, robots)
    for robot in robots:
        robot.join(kit.WITHIN_SECS)
        if robot.error or robot.is_alive():
            raise kit.Failed(f"{robot.name}: {robot.error or 'it hangs'}")
    acknowledged, doubtful = (sum(getattr(robot, what) for robot in robots) for what in ("acknowledged", "doubtful"))
    say(f"the robots came back at {second.name}: {acknowledged:,} observations are acknowledged")
    say(f"the log had {doubtful:,} of them without an acknowledgement; they were not taken twice")

    cluster.start(first, "daemon")
    say(f"{first.name} is started again, and catches up")
    kit.wait_until("all is well", lambda: cluster.tidemap(third, "cluster", "status")[0] == 0)
    cluster.must(second, "update", MAP)
    return check(cluster, third, robots)


def check(cluster, third, robots):
    """Compares the map at a daemon with the data of the robots; returns the exit status."""
    total = sum(len(robot.rows) for robot in robots)
    lost, doubled, foreign = compare(cluster, third, robots)
    # When robots come back they send again the observations that the map no longer has: those are lost too.
    lost += sum(robot.forgotten for robot in robots)
    say(f"{third.name} shows the map: of {total:,} observations {lost} were lost, {doubled} are there twice, {foreign} "
        "were never sent")
    code, rows, said = cluster.tidemap(third, "cluster", "verify", MAP)
    for line in said.splitlines():
        say(line)
    unacknowledged = total - sum(robot.acknowledged for robot in robots)
    print(f"lost: {lost}", flush=True)
    return int(lost + doubled + foreign + unacknowledged > 0 or code != 0 or len(rows) != 3)


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    kit.stop_on_signals()
    with tempfile.TemporaryDirectory(prefix="tidemap-cluster-") as name:
        folder, ports, hosts = pathlib.Path(name), kit.free_ports(9), []
        for index, host in enumerate(kit.NAMES):
            hosts.append(kit.Host(host, "127.0.0.1", *ports[index * 3:index * 3 + 3], folder / host))
        cluster = kit.Cluster(hosts, sys.argv[1])
        try:
            sys.exit(show(cluster, folder))
        finally:
            cluster.stop()


if __name__ == "__main__":
    try:
        main()
    except kit.Failed as failed:
        sys.exit(f"cluster-demo: {failed}")
