#!/usr/bin/env python3
"""Runs the tests of durability for hours, with new seeds each time, and counts.

The time is shared among the rows: the next turn is always that of the row with the least time for its weight. Counts are
kept in a file, so that a second run goes on with new seeds. A turn that fails does not count: its output is kept, and the
exit status is 1. The table gives, for each row without a failure, the bound on its rate with 95 % confidence: 3/n.

Usage: soak.py HOURS [ROW...]        the rows by their names; all if none is given
       soak.py --table               prints the counts so far

TIDEMAP_SOAK_FOLDER (default target/soak) holds counts.json and the outputs of failures; TIDEMAP_SOAK_PROFILE (default
release) is the profile of the build. Rows that this machine cannot run print so, and the others share their time.
"""

import dataclasses
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
FOLDER = pathlib.Path(os.environ.get("TIDEMAP_SOAK_FOLDER", ROOT / "target" / "soak"))
PROFILE = os.environ.get("TIDEMAP_SOAK_PROFILE", "release")
# A turn that lasts longer is taken to hang.
TURN_SECS_MAX = 3600
TABLE_EVERY_SECS = 900
FUZZ_SECS = 60


@dataclasses.dataclass(frozen=True)
class Row:
    """The program that is run in a turn: tests, or a fuzz target. `variable` gives the tests the number of rounds."""

    name: str
    what: str
    weight: float
    package: str
    tests: tuple
    variable: str = ""
    rounds: int = 1
    # Number of counts of one round.
    each: int = 1

    @property
    def counts(self):
        return self.rounds * self.each


def fuzz(target):
    return Row("fuzz-" + target, f"fuzz: inputs of {target}", 0.3, "", (target,), "", FUZZ_SECS)


def integration(name, what, weight, tests, variable="", rounds=1, each=1):
    return Row(name, what, weight, "tidemap-tests", tests, variable, rounds, each)


DURABILITY = "durability::"
ROWS = [
    integration("kills", "kill -9 cycles under load", 3, (
        DURABILITY + "kill::durability_kill_while_producers_stream",
        DURABILITY + "kill::durability_kill_while_updates_run_and_are_saved",
        DURABILITY + "kill::durability_producers_reconnect_by_themselves_and_lose_nothing",
    ), "TIDEMAP_KILL_ROUNDS", 20, 3),
    integration("starts", "kill -9 cycles while the daemon starts", 1,
                (DURABILITY + "kill::durability_kill_while_the_daemon_starts",), "TIDEMAP_KILL_ROUNDS", 20),
    integration("calls", "kills at storage calls", 2,
                (DURABILITY + "system_calls::durability_kill_at_chosen_system_calls",), "TIDEMAP_CALL_KILLS", 48),
    integration("cuts", "power-cut images", 2,
                (DURABILITY + "power_cut::durability_power_cuts_lose_nothing_acknowledged",),
                "TIDEMAP_POWERCUT_ROUNDS", 10),
    Row("disk", "simulated-disk seeds", 2, "tidemap-store",
        ("simulation::crash::nothing_acknowledged_is_lost_in_any_seed",), "TIDEMAP_SIMULATED_SEEDS", 1000),
    Row("shared", "seeds of disks that end at every operation", 2, "tidemap-cluster", (
        "replica::tests::durability::a_disk_that_holds_all_alone_may_end_at_any_operation",
        "replica::tests::durability::the_disk_of_a_writer_may_end_at_any_operation",
        "replica::tests::durability::the_disk_of_a_follower_may_end_at_any_operation",
    ), "TIDEMAP_SIMULATED_SEEDS", 1, 3),
    Row("reads", "reads with tokens while writers change", 1, "tidemapd",
        ("rpc::gateway::tests::forward::no_reply_shows_less_than_its_token_while_writers_change_and_followers_lag",),
        "TIDEMAP_TOKEN_READS", 20000),
    integration("flips", "flipped bits in files", 1,
                (DURABILITY + "bit_flips::durability_a_flipped_bit_is_harmless_or_reported",), "TIDEMAP_FLIPS", 210),
    integration("harms", "zeroed sectors, cut and missing files", 1,
                (DURABILITY + "bit_flips::durability_zeroed_cut_and_missing_files_are_harmless_or_reported",),
                "TIDEMAP_HARMS", 210),
    integration("sockets", "rounds of 2,000 silent sockets", 0.5,
                ("crowds::silent_sockets_keep_no_good_client_out",)),
    integration("streams", "rounds of 1,000 streams at once", 0.5,
                ("crowds::a_thousand_streams_are_acknowledged_and_end_in_order",)),
    integration("overload", "rounds of three times overload", 0.5, ("crowds::overload_refuses_and_goes_on",)),
    integration("full", "full disks", 1,
                (DURABILITY + "full_disk::durability_a_disk_that_gets_full_again_and_again_loses_nothing",),
                "TIDEMAP_FULL_ROUNDS", 24),
    integration("erasures", "kills inside an erasure", 1,
                (DURABILITY + "erasure_kills::durability_a_kill_inside_an_erasure_is_completed_by_the_next_start",),
                "TIDEMAP_ERASURE_KILLS", 8),
    integration("operations", "random operations against the naive model", 2,
                ("random_operations::random_operations_have_the_effect_that_a_naive_model_expects",),
                "TIDEMAP_OPERATIONS", 1000),
    *map(fuzz, ("wire", "csv", "files", "checkpoint", "history", "log", "row", "list")),
]


def executables():
    """The test program of each package, built."""
    packages = {row.package for row in ROWS}
    flags = [] if PROFILE == "dev" else ["--profile", PROFILE]
    command = ["cargo", "build", "--workspace", "--locked", "--bins", "--tests",
               "--features", "tidemapd/full,tidemap/full", *flags]
    lines = subprocess.run([*command, "--message-format", "json-render-diagnostics"], cwd=ROOT, check=True,
                           stdout=subprocess.PIPE, text=True).stdout
    found = {}
    for line in lines.splitlines():
        message = json.loads(line)
        program = message.get("executable")
        if message.get("reason") != "compiler-artifact" or not program or not message["profile"]["test"]:
            continue
        target, manifest = message["target"], pathlib.Path(message["manifest_path"])
        if target["name"] == "integration" or "lib" in target["kind"]:
            name = re.search(r'^name = "(.*)"', manifest.read_text(), re.M).group(1)
            if name in packages and (name == "tidemap-tests") == (target["name"] == "integration"):
                found[name] = (copied(pathlib.Path(program)), manifest.parent)
    return found


def copied(program):
    """A copy of a test and of the programs beside it, so that builds meanwhile change nothing."""
    built, copy = program.parent.parent, FOLDER / "programs"
    (copy / "deps").mkdir(parents=True, exist_ok=True)
    for name in ("tidemapd", "tidemap", "tidemapd-planted-fault"):
        shutil.copy2(built / name, copy / name)
    return shutil.copy2(program, copy / "deps" / program.name)


class Counts:
    """The counts of all runs so far, in a file that is replaced whole."""

    def __init__(self):
        self.file = FOLDER / "counts.json"
        FOLDER.mkdir(parents=True, exist_ok=True)
        self.rows = json.loads(self.file.read_text()) if self.file.exists() else {}

    def of(self, row):
        return self.rows.setdefault(row.name, {"count": 0, "secs": 0.0, "next_seed": 1, "failures": []})

    def save(self):
        new = self.file.with_suffix(".new")
        new.write_text(json.dumps(self.rows, indent=1) + "\n")
        new.replace(self.file)

    def table(self):
        lines = [f"{'what':44} {'count':>12} {'failures':>8}  {'bound (95 %)':14} {'hours':>6}"]
        for row in ROWS:
            of = self.of(row)
            count, failures = of["count"], len(of["failures"])
            bound = f"< {3 / count:.2g}" if count and not failures else "none"
            note = f"  not run here: {of['skipped']}" if of.get("skipped") else ""
            lines.append(f"{row.what:44} {count:12,} {failures:8}  {bound:14} {of['secs'] / 3600:6.2f}{note}")
        return "\n".join(lines)


def turn(row, programs, counts):
    """Runs one turn of a row. Returns whether it can be run on this machine."""
    of, began = counts.of(row), time.monotonic()
    seed = of["next_seed"]
    of["next_seed"] = seed + row.rounds
    counts.save()
    environment = {**os.environ, "TIDEMAP_SEED": str(seed)}
    if row.variable:
        environment[row.variable] = str(row.rounds)
    if row.package:
        program, folder = programs[row.package]
        command = [program, "--exact", *row.tests, "--nocapture", "--test-threads", "1"]
    else:
        # It goes on from its own corpus, and prints what it lacks.
        folder, command = ROOT, ["deploy/fuzz.sh", str(row.rounds), *row.tests]
    try:
        done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                              text=True, errors="replace", timeout=TURN_SECS_MAX)
        output, status = done.stdout, done.returncode
    except subprocess.TimeoutExpired as hung:
        output, status = (hung.stdout or b"").decode(errors="replace") + "\nhangs", -1
    of["secs"] += time.monotonic() - began
    ran = re.search(r"test result: ok\. (\d+) passed", output)
    tried = re.search(r"^fuzz \S+: (\d+) inputs", output, re.M)
    skipped = re.search(r"SKIPPED: (.*)|(no such command: `fuzz`)", output)
    of.pop("skipped", None)
    if skipped:
        of["skipped"] = (skipped.group(1) or "cargo-fuzz is missing: run make fuzz once")[:60]
    elif status == 0 and tried:
        of["count"] += int(tried.group(1))
    elif status == 0 and ran and int(ran.group(1)) == len(row.tests):
        of["count"] += row.counts
    else:
        log = FOLDER / f"{row.name}-{seed}.log"
        log.write_text(output)
        of["failures"].append({"seed": seed, "output": str(log)})
        print(f"soak: {row.what}: seed {seed} failed; see {log}", flush=True)
    counts.save()
    return not skipped


def main():
    counts = Counts()
    if sys.argv[1:] == ["--table"]:
        return print(counts.table())
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    secs = float(sys.argv[1]) * 3600
    unknown = set(sys.argv[2:]) - {row.name for row in ROWS}
    if unknown:
        sys.exit(f"soak: no rows {sorted(unknown)}; there are {[row.name for row in ROWS]}")
    rows = [row for row in ROWS if not sys.argv[2:] or row.name in sys.argv[2:]]
    programs = executables()
    end = time.monotonic() + secs
    spent, shown = {row.name: 0.0 for row in rows}, time.monotonic()
    failed = sum(len(counts.of(row)["failures"]) for row in ROWS)
    while rows and time.monotonic() < end:
        row = min(rows, key=lambda row: spent[row.name] / row.weight)
        began = time.monotonic()
        if not turn(row, programs, counts):
            rows.remove(row)
        spent[row.name] += time.monotonic() - began
        if time.monotonic() - shown > TABLE_EVERY_SECS:
            print(counts.table(), flush=True)
            shown = time.monotonic()
    print(counts.table())
    sys.exit(int(sum(len(counts.of(row)["failures"]) for row in ROWS) > failed))


if __name__ == "__main__":
    main()
