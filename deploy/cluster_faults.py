#!/usr/bin/env python3
"""Harms a cluster again and again, with real faults drawn from a seed, and checks that nothing acknowledged is lost.

Three hosts, each a network namespace with one nats-server and one tidemapd, and up to 16 producers that stream to all
of them. After each fault the run waits until every producer is acknowledged again. Every few faults the producers
pause, and each daemon must hold everything that was acknowledged once; all logs and digests must be equal, and the
models must be, number for number, those of a daemon without a cluster that got the same observations.

Invariant: a fault after which something is wrong is kept with its seed, logs and files, and the exit status is 1. A
second run goes on where the first one ended.

Usage: cluster_faults.py PROGRAMS FAULTS SEED [KIND...]     the folder with tidemapd, tidemap and tidemap-lanes
       cluster_faults.py --table                            what all runs have found so far

TIDEMAP_FAULTS_FOLDER (default target/cluster-faults) holds state.json, results.csv and, in found/, what went wrong.
"""

import collections
import csv
import json
import math
import os
import pathlib
import queue
import random
import shutil
import signal
import subprocess
import sys
import threading
import time

import cluster_kit as kit
from cluster_harm import KINDS, Harm
from cluster_net import HUB, Disk, Network, prefix, space, why_no_namespaces

FOLDER = pathlib.Path(os.environ.get("TIDEMAP_FAULTS_FOLDER", kit.ROOT / "target" / "cluster-faults"))
MAP = "office"
CHECK_EVERY = 5
# Time within which all producers are acknowledged again: elections, the wait for a daemon with a longer log, and a slow
# machine.
RECOVERS_WITHIN = 300
# After this time the state of the streams in the engines is written down.
STALLS_AFTER = 30
# Engines that were set back catch up with the next snapshot of their leader, which comes every two minutes.
RESET_AFTER = 200
ALONE = "127.0.0.1:27900"
COLUMNS = ("fault", "seed", "life", "kind", "host", "was_writer", "harm_secs", "failover_secs", "after_heal_secs",
           "all_back_secs", "set_back", "load", "result")


class Lanes:
    """The producers, as a process; their events, and replies to commands."""

    def __init__(self, cluster, programs, folder, producers, seed):
        words = [*cluster.hub, programs / "tidemap-lanes", MAP, folder / "record.json", str(producers), str(seed)]
        self.producers, self.lock = producers, threading.Lock()
        self.answers, self.last, self.acks, self.wrong = queue.Queue(), {}, [], []
        self.set_back = collections.Counter()
        self.process = subprocess.Popen([*words, *(host.address for host in cluster.hosts)], stdin=subprocess.PIPE,
                                        stdout=subprocess.PIPE, stderr=open(folder / "lanes.log", "ab"), text=True,
                                        start_new_session=True)
        self.log = open(folder / "lanes-events.log", "a")
        threading.Thread(target=self.read, daemon=True).start()

    def read(self):
        for line in self.process.stdout:
            event = json.loads(line)
            what = event["event"]
            with self.lock:
                if what == "ack":
                    self.last[event["producer"]] = event["at"]
                    self.acks.append(event["at"])
                    continue
                self.log.write(line)
                self.log.flush()
                if what == "set_back":
                    self.set_back["set_back"] += 1
                elif what in ("violation", "lost", "foreign"):
                    self.wrong.append(line.strip())
            if "wrong" in event:
                self.answers.put(event["wrong"])
        self.answers.put(["the producers have ended; see lanes.log"])

    def ask(self, *words, within=300):
        """Gives a command and waits for its reply: the faults found."""
        self.process.stdin.write(" ".join(map(str, words)) + "\n")
        self.process.stdin.flush()
        try:
            return self.answers.get(timeout=within)
        except queue.Empty:
            raise kit.Failed(f"{' '.join(map(str, words))}: not within {within} s") from None

    def begin(self):
        """Forgets the acknowledgements before now but for the last."""
        with self.lock:
            self.acks, self.set_back = self.acks[-1:], collections.Counter()

    def are_back(self, since):
        """Whether each producer was acknowledged after a time."""
        with self.lock:
            return sum(at > since for at in self.last.values()) == self.producers

    def gap(self, since):
        """The longest time without any acknowledgement that ends after a time, until now."""
        with self.lock:
            acks = sorted([*self.acks, time.time()])
        return max((after - before for before, after in zip(acks, acks[1:]) if after > since), default=0.0)

    def first_after(self, since):
        with self.lock:
            return min((at - since for at in self.acks if at > since), default=None)

    def complaints(self):
        with self.lock:
            wrong, self.wrong = self.wrong, []
        return wrong

    def end(self):
        if self.process.poll() is None:
            self.process.stdin.close()
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()


class Life:
    """A cluster from its making to the end of the run, or to the first thing that is wrong with it."""

    def __init__(self, programs, network, seed, number):
        self.folder, self.programs, self.number = FOLDER / f"life-{number}", programs, number
        self.producers = random.Random(f"{seed} {number}").randint(2, 16)
        hosts = [kit.Host(name, network.ip(index), 7435, 4222, 6222, self.folder / name, prefix(space(name)))
                 for index, name in enumerate(kit.NAMES)]
        self.disks = {host.name: Disk(host.data, self.folder / f"{host.name}.img") for host in hosts}
        self.cluster = kit.Cluster(hosts, programs, prefix(HUB), "false")
        self.network, self.lanes, self.checks, self.resets = network, None, 0, 0
        try:
            self.start(seed * 1000 + number)
        except BaseException:
            self.end()
            raise

    def start(self, seed):
        self.cluster.start_all()
        self.wait_well()
        first = self.cluster.hosts[0]
        if not self.cluster.must(first, "cluster", "maps"):
            self.cluster.must(first, "map", "create", MAP, "--time-zone", "UTC")
        kit.wait_until("three replicas", lambda: len(self.cluster.tidemap(first, "cluster", "maps")[1]) == 3)
        self.wait_well()
        self.lanes = Lanes(self.cluster, self.programs, self.folder, self.producers, seed)
        self.stream()
        # Discards the complaints about data that is not in the record of a run that was killed.
        self.lanes.complaints()

    def recover(self, what, look, pause=0.2):
        """Waits until something is true, and writes down the state of the engines if that takes long."""
        try:
            return kit.wait_until(what, look, within=STALLS_AFTER, pause=pause)
        except kit.Failed:
            self.write_engines()
        try:
            return kit.wait_until(what, look, within=RESET_AFTER - STALLS_AFTER, pause=pause)
        except kit.Failed:
            self.write_engines()
            self.reset_stuck_engines()
            return kit.wait_until(what, look, within=RECOVERS_WITHIN - RESET_AFTER, pause=pause)

    def reset_stuck_engines(self):
        """Does the work of an operator with engines that were set back and cannot catch up: they start with empty folders,
        one after the other."""
        for host in self.cluster.hosts:
            with open(host.folder / "engine.log", "rb") as log:
                log.seek(max(0, log.seek(0, os.SEEK_END) - 2000))
                if b"Expected first catchup entry" not in log.read():
                    continue
            self.resets += 1
            self.cluster.kill(host, "engine")
            shutil.rmtree(host.store, ignore_errors=True)
            self.cluster.start(host, "engine")
            time.sleep(10)

    def write_engines(self):
        stalls = self.folder / "stalls"
        stalls.mkdir(exist_ok=True)
        ask = f"http://{kit.MONITOR}/jsz?accounts=1&streams=1&consumers=1&raft=1"
        for host in self.cluster.hosts:
            with open(stalls / f"{time.strftime('%H-%M-%S')}-{host.name}.json", "w") as out:
                subprocess.run([*host.prefix, "curl", "-s", "-m", "5", ask], stdout=out, stderr=subprocess.DEVNULL)

    def answered(self, *words):
        """Gives a command of the producers; repeats it for daemons that do not reply yet."""
        wrong = []

        def look():
            wrong[:] = self.lanes.ask(*words)
            return not wrong or not all(text.startswith("no answer") for text in wrong)

        try:
            self.recover(" ".join(map(str, words)), look, pause=1)
        except kit.Failed:
            pass
        return wrong

    def wait_well(self):
        """Waits until nothing is wrong but records that were set aside, which a check handles."""
        first = self.cluster.hosts[0]

        def look():
            code, _, self.said = self.cluster.tidemap(first, "cluster", "status", timeout=20)
            bad = [line for line in self.said.splitlines() if "set aside" not in line]
            return code == 0 or (self.said and not bad)

        try:
            self.recover("all is well", look)
        except kit.Failed as failed:
            raise kit.Failed(f"{failed}: {self.said}") from None

    def stream(self):
        self.lanes.ask("go")
        begun = time.time()
        kit.wait_until("all producers are acknowledged", lambda: self.lanes.are_back(begun), within=RECOVERS_WITHIN)

    def heal_forks(self):
        """Removes forks whose observations the map has; gives their number, and the faults found."""
        code, rows, said = self.cluster.tidemap(self.cluster.hosts[0], "cluster", "heal", MAP)
        forks = len({row["fork"] for row in rows})
        return forks, [f"a fork holds what the map lacks: {said}"] if code else []

    def check(self):
        """Checks everything that must hold when nothing is harmed; gives the number of forks, and the faults found."""
        self.lanes.ask("pause", within=RECOVERS_WITHIN)
        wrong = self.lanes.complaints()
        self.wait_well()
        forks, more = self.heal_forks()
        wrong += more
        self.checks += 1
        reach = "all" if self.checks % 4 == 1 else "new"
        alone = self.start_alone()
        try:
            wrong += self.answered("sums", 0)
            for index, host in enumerate(self.cluster.hosts):
                wrong += [f"{host.name}: {text}" for text in self.answered("check", index, reach)]
            wrong += self.answered("update", 0)
            wrong += self.answered("alone", ALONE)
            wrong += self.verify()
            for index, host in enumerate(self.cluster.hosts):
                wrong += [f"{host.name}: {text}" for text in self.answered("compare", index, ALONE)]
        finally:
            alone.terminate()
            alone.wait(60)
        if not wrong:
            self.lanes.ask("checked")
            self.stream()
        return forks, wrong

    def verify(self):
        """Compares logs and digests; repeats it for a member that is behind."""
        first = self.cluster.hosts[0]

        def look():
            self.verified = self.cluster.tidemap(first, "cluster", "verify", MAP)
            return self.verified[0] == 0 and len(self.verified[1]) == 3

        try:
            self.recover("equal logs", look, pause=1)
        except kit.Failed:
            return [f"cluster verify ended with {self.verified[0]}: {self.verified[2]} {self.verified[1]}"]
        return []

    def start_alone(self):
        """A daemon without a cluster, in the hub."""
        words = ["--listen", ALONE, "--http-listen", "127.0.0.1:0", "--data-dir", self.folder / "alone", "--config",
                 self.folder / "alone.toml"]
        (self.folder / "alone.toml").write_text("update_at_midnight = false\n")
        with open(self.folder / "alone.log", "ab") as log:
            process = subprocess.Popen([*prefix(HUB), self.programs / "tidemapd", *words], stdin=subprocess.DEVNULL,
                                       stdout=log, stderr=log, start_new_session=True)
        server = kit.Host("alone", *ALONE.split(":"), 0, 0, self.folder)
        kit.wait_until("the daemon that is alone", lambda: self.cluster.tidemap(server, "map", "list")[0] == 0)
        return process

    def end(self):
        if self.lanes:
            self.lanes.end()
        self.cluster.stop()
        for host in self.cluster.hosts:
            self.network.cut(host.name, False)

    def unmount(self):
        for disk in self.disks.values():
            disk.remove()


class Run:
    """The state of all runs with a seed, in a file that is replaced whole."""

    def __init__(self, programs, seed, kinds):
        self.programs, self.kinds, self.life = copied(pathlib.Path(programs)), kinds, None
        self.file = FOLDER / "state.json"
        self.state = json.loads(self.file.read_text()) if self.file.exists() else {}
        if self.state.get("seed") != seed:
            self.state = {"seed": seed, "next": 1, "life": self.state.get("life", 0) + 1, "checks": 0, "forks": 0}
        self.network = Network(kit.NAMES)

    def save(self):
        new = self.file.with_suffix(".new")
        new.write_text(json.dumps(self.state, indent=1) + "\n")
        new.replace(self.file)

    def open_life(self):
        if self.life is None:
            self.life = Life(self.programs, self.network, self.state["seed"], self.state["life"])
            why_not = next((disk.why_not for disk in self.life.disks.values() if disk.why_not), None)
            if why_not and "disk_full" in self.kinds:
                self.kinds = [kind for kind in self.kinds if kind != "disk_full"]
                say(f"the kind disk_full is left out: {why_not}")
            say(f"life {self.life.number}: three hosts, {self.life.producers} producers")

    def close_life(self):
        if self.life is not None:
            self.life.end()
            self.life.unmount()
            self.life = None

    def fault(self):
        """Draws a fault, does it, and waits until all producers are acknowledged again."""
        number, seed = self.state["next"], self.state["seed"]
        draws = random.Random(f"{seed} {number}")
        kind = draws.choices(self.kinds, [KINDS[kind] or 1 for kind in self.kinds])[0]
        life = self.life
        writer = life.cluster.writer(MAP)
        other = draws.choice(life.cluster.hosts)
        host = writer if writer and draws.random() < 0.6 else other
        row = dict.fromkeys(COLUMNS, "")
        row.update(fault=number, seed=seed, life=life.number, kind=kind, host=host.name,
                   was_writer="yes" if host is writer else "no", load=f"{os.getloadavg()[0]:.1f}")
        wrong = []
        life.lanes.begin()
        begun = time.time()
        try:
            harm = Harm(life, host, draws)
            harm.begun = begun
            harm.do(kind)
            begun = harm.begun
            healed = time.time()
            row["harm_secs"] = f"{healed - begun:.1f}"
            life.recover("all producers are acknowledged again", lambda: life.lanes.are_back(max(healed, begun)),
                         pause=0.05)
            row["failover_secs"] = f"{life.lanes.gap(begun):.2f}"
            row["all_back_secs"] = f"{time.time() - begun:.2f}"
            row["after_heal_secs"] = f"{life.lanes.first_after(healed) or 0:.2f}"
        except kit.Failed as failed:
            wrong.append(str(failed))
        row["set_back"] = life.lanes.set_back["set_back"]
        return row, wrong + life.lanes.complaints()

    def step(self, is_last):
        """Does one fault, and a check if it is time; returns whether all is well."""
        self.open_life()
        resets = self.life.resets
        row, wrong = self.fault()
        if not wrong and (is_last or self.state["next"] % CHECK_EVERY == 0):
            try:
                forks, wrong = self.life.check()
                self.state["forks"] += forks
                self.state["checks"] += 1
                row["result"] = "checked" + (f", {forks} forks" if forks else "")
            except kit.Failed as failed:
                wrong = [f"check: {failed}"]
        row["result"] = row["result"] or "ok"
        if self.life.resets > resets:
            row["result"] += f", {self.life.resets - resets} engines reset"
            self.state["resets"] = self.state.get("resets", 0) + self.life.resets - resets
        if wrong:
            row["result"] = "WRONG: " + wrong[0][:300]
            self.keep(row, wrong)
        self.state["next"] += 1
        self.save()
        write(row)
        say("fault {fault:>3} {kind:13} {host:5} writer {was_writer:3} failover {failover_secs:>6} s, all back "
            "{all_back_secs:>6} s, load {load:>4}: {result}".format(**row))
        return not wrong

    def keep(self, row, wrong):
        """Keeps the files of a fault that was found, and begins anew with another cluster."""
        kept = FOLDER / "found" / f"seed-{row['seed']}-fault-{row['fault']}"
        kept.mkdir(parents=True, exist_ok=True)
        (kept / "wrong.txt").write_text(json.dumps(row) + "\n" + "\n".join(wrong) + "\n")
        life = self.life
        for words in (("cluster", "status"), ("cluster", "maps"), ("cluster", "verify", MAP), ("cluster", "heal", MAP)):
            for host in life.cluster.hosts:
                _, rows, said = life.cluster.tidemap(host, *words, timeout=20)
                with open(kept / "cluster.txt", "a") as out:
                    out.write(f"{host.name}: {' '.join(words)}\n{json.dumps(rows, indent=1)}\n{said}\n\n")
        life.end()
        shutil.copytree(life.folder, kept / "files", ignore=shutil.ignore_patterns("*.img", "ballast", "image-*"),
                        dirs_exist_ok=True)
        self.close_life()
        shutil.rmtree(life.folder, ignore_errors=True)
        self.state["life"] += 1
        for text in wrong[:5]:
            say(f"  {text[:400]}")
        say(f"  kept in {kept}")


def copied(programs):
    """Copies of the programs, so that builds meanwhile change nothing."""
    copies = FOLDER / "programs"
    copies.mkdir(parents=True, exist_ok=True)
    for name in ("tidemapd", "tidemap", "tidemap-lanes"):
        if not (programs / name).is_file():
            raise kit.Failed(f"{programs / name} is missing")
        shutil.copy2(programs / name, copies / name)
    return copies


def say(text):
    print(f"{time.strftime('%H:%M:%S')}  {text}", flush=True)


def write(row):
    file = FOLDER / "results.csv"
    is_new = not file.exists()
    with open(file, "a", newline="") as out:
        writer = csv.DictWriter(out, COLUMNS)
        if is_new:
            writer.writeheader()
        writer.writerow(row)


def quantile(values, share):
    values = sorted(values)
    return values[max(0, math.ceil(share * len(values)) - 1)]


def table(state):
    """Counts and failover times by kind, over all runs."""
    with open(FOLDER / "results.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    lines = [f"{'kind':15} {'writer':6} {'faults':>6} {'wrong':>5} {'p50 s':>7} {'p99 s':>7}"]
    groups = collections.defaultdict(list)
    for row in rows:
        groups[row["kind"], row["was_writer"]].append(row)
        groups["all", ""].append(row)
    for (kind, writer), group in sorted(groups.items()):
        secs = [float(row["failover_secs"]) for row in group if row["failover_secs"]]
        wrong = sum(row["result"].startswith("WRONG") for row in group)
        shown = [f"{quantile(secs, share):7.2f}" if secs else "      -" for share in (0.5, 0.99)]
        lines.append(f"{kind:15} {writer:6} {len(group):6} {wrong:5} {' '.join(shown)}")
    for what, name in (("checks of everything", "checks"), ("sets of records set aside, and healed", "forks"),
                       ("engines that could not catch up, and were started empty", "resets")):
        lines.append(f"{what}: {state.get(name, 0)}")
    return "\n".join(lines)


def main():
    if sys.argv[1:] == ["--table"]:
        return print(table(json.loads((FOLDER / "state.json").read_text())))
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    count, seed, kinds = int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:] or [kind for kind in KINDS if KINDS[kind]]
    if set(kinds) - set(KINDS):
        sys.exit(f"cluster-faults: no kinds {sorted(set(kinds) - set(KINDS))}; there are {sorted(KINDS)}")
    reason = why_no_namespaces()
    if reason:
        return print(f"SKIPPED: {reason}")
    kit.stop_on_signals()
    FOLDER.mkdir(parents=True, exist_ok=True)
    run = Run(sys.argv[1], seed, kinds)
    is_well = True
    try:
        while run.state["next"] <= count:
            is_well &= run.step(run.state["next"] == count)
    finally:
        run.close_life()
        run.network.remove()
    print(table(run.state), flush=True)
    sys.exit(0 if is_well else 1)


if __name__ == "__main__":
    try:
        main()
    except kit.Failed as failed:
        sys.exit(f"cluster-faults: {failed}")
