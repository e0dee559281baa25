"""The content of diagnostics.

Invariant: every lost, omitted or refused item is counted here, and the level is then not OK.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from tidemap import QueueState
from tidemap_ros.intake import Counts

OK, WARN, ERROR = 0, 1, 2
NEARLY_FULL = 0.8


@dataclass
class Status:
    """One line of diagnostics."""

    name: str
    level: int = OK
    message: str = ""
    values: dict[str, str] = field(default_factory=dict)


def of_sending(state: QueueState, now_nanos: int, server: str) -> Status:
    """Whether the daemon takes the records that are sent."""
    found = Status("daemon", OK, f"connected to {server}")
    if not state.connected:
        found.level, found.message = ERROR, f"not connected, all is kept: {state.error or 'connecting'}"
    elif state.refused or state.unsendable:
        found.level, found.message = WARN, f"the daemon refused records; the last: {state.last_refusal or 'unknown'}"
    oldest = state.oldest_waiting_nanos
    found.values = {
        "server": server,
        "records waiting": str(state.waiting),
        "oldest waits for seconds": "0" if oldest is None else f"{max(now_nanos - oldest, 0) / 1e9:.1f}",
        "records durable": str(state.durable),
        "records refused": str(state.refused),
        "records unsendable": str(state.unsendable),
        "durable without a word on refusals": str(state.unreported),
        **{f"refused: {reason}": str(count) for reason, count in sorted(state.refused_by_reason.items())},
    }
    return found


def of_spool(folder: str, state: QueueState, counts: Counts) -> Status:
    """The fill level of the queue."""
    used, bytes_max, lost = state.bytes, state.bytes_max, state.lost
    found = Status("spool", OK, f"{used / 1e6:.1f} of {bytes_max / 1e6:.1f} MB")
    if counts.spool_refused:
        found.level = ERROR
        found.message = f"{counts.spool_refused} observations were lost: {counts.last_problem}"
    elif lost:
        found.level, found.message = ERROR, f"the daemon lost {lost} records that it had: was a backup restored?"
    elif used > NEARLY_FULL * bytes_max:
        found.level, found.message = WARN, f"nearly full: {found.message}"
    found.values = {
        "folder": folder,
        "bytes": str(used),
        "bytes at most": str(bytes_max),
        "observations lost because it was full": str(counts.spool_refused),
        "records that the daemon lost": str(lost),
        "bytes cut off at the start": str(state.cut_bytes),
    }
    return found


def of_intake(counts: Counts, waiting: int) -> Status:
    """The counts of messages."""
    found = Status("observations", OK, f"{counts.taken} taken")
    if counts.left_out:
        found.level, found.message = WARN, f"{counts.left_out} left out; the last: {counts.last_problem}"
    elif counts.never_arrived:
        found.level, found.message = WARN, f"ROS lost {counts.never_arrived} messages before they arrived"
    found.values = {
        "taken": str(counts.taken),
        "lost by ROS before they arrived": str(counts.never_arrived),
        "left out": str(counts.left_out),
        "thinned out": str(counts.thinned),
        "waiting for a transform": str(waiting),
        **{f"left out: {reason}": str(count) for reason, count in sorted(counts.reasons.items())},
    }
    return found


def of_output(name: str, error: str | None, published: int, *, is_cut: bool = False) -> Status:
    """Whether the published data is of now."""
    if error is not None:
        return Status(name, WARN, error, {"published": str(published)})
    if is_cut:
        return Status(
            name, WARN, "the map has grown beyond what is published: set map_region, or start the node anew",
            {"published": str(published)},
        )
    return Status(name, OK, f"{published} published", {"published": str(published)})
