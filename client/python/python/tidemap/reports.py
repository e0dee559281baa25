"""The reporting of states: the meaning of a row of a state, and the time for which it is valid.

Invariant: the stated reporting is checked before anything is sent, and a duration has a unit.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, Union

import numpy as np

from tidemap._native import duration_nanos, stated_reporting
from tidemap.errors import FailedPrecondition, InvalidArgument
from tidemap.times import SECOND

Duration = Union[str, dt.timedelta, np.timedelta64]
Reports = Literal["samples", "changes", "events"]

_MICROSECOND = dt.timedelta(microseconds=1)
_WIRE = "ROW_KIND_"


@dataclass(frozen=True)
class Stated:
    """The stated reporting of states; ``None``: a duration is not stated."""

    kind: str
    max_secs: int | None = None
    step_secs: int | None = None

    @property
    def may_lack_value(self) -> bool:
        """Whether a row may mean that no value is known from then on."""
        return self.kind != "samples"

    def native(self) -> tuple[str, int | None, int | None]:
        """The stated reporting, with durations in nanoseconds."""
        spans = [None if secs is None else secs * SECOND for secs in (self.max_secs, self.step_secs)]
        return self.kind, spans[0], spans[1]

    def request(self) -> dict[str, Any]:
        """A ``StateReporting`` of the wire."""
        spans = {"hold_max": self.max_secs, "step": self.step_secs}
        said = {name: f"{secs}s" for name, secs in spans.items() if secs is not None}
        return {"kind": _WIRE + self.kind.upper(), **said}

    def is_true_of(self, found: Stated) -> bool:
        """Whether it agrees with the reporting ``found`` of a state, in which everything is stated."""
        return self.kind == found.kind and all(
            said in (None, known)
            for said, known in ((self.max_secs, found.max_secs), (self.step_secs, found.step_secs))
        )

    def __str__(self) -> str:
        if self.max_secs is None and self.step_secs is None:
            return self.kind
        spans = (("hold_max", self.max_secs), ("hold_step", self.step_secs))
        return f"{self.kind} ({', '.join(f'{name} {secs} s' for name, secs in spans if secs is not None)})"


def nanos_of(duration: Duration, name: str) -> int:
    """Nanoseconds of a duration: a text such as ``7d``, or a timedelta of Python, numpy or pandas."""
    if isinstance(duration, str):
        try:
            return duration_nanos(duration)
        except InvalidArgument as error:
            raise InvalidArgument(f"{name}: {error}", "INVALID_ARGUMENT") from error
    if isinstance(duration, np.timedelta64) and not np.isnat(duration):
        return int(duration.astype("timedelta64[ns]").astype(np.int64))
    if isinstance(duration, dt.timedelta) and duration == duration:
        return duration // _MICROSECOND * 1_000
    if isinstance(duration, (int, float, np.number)):
        raise InvalidArgument(
            f"{name}={duration!r} has no unit: write \"{duration}s\", \"5m\", \"7d\" or a timedelta", "INVALID_ARGUMENT"
        )
    raise TypeError(f"{name}={duration!r} is not a duration: write \"5m\", \"7d\" or a timedelta")


def stated(reports: str | None, hold_max: Duration | None, hold_step: Duration | None) -> Stated | None:
    """The stated reporting of states; ``None``: nothing is stated."""
    spans = {"hold_max": hold_max, "hold_step": hold_step}
    said = {name: nanos_of(duration, name) for name, duration in spans.items() if duration is not None}
    if reports is None:
        if said:
            raise InvalidArgument(
                f"{' and '.join(said)} can be set for changes and events only: add "
                "reports=\"changes\" or reports=\"events\"",
                "INVALID_ARGUMENT",
            )
        return None
    if not isinstance(reports, str):
        raise TypeError(f"reports={reports!r} is no word: use \"samples\", \"changes\" or \"events\"")
    return Stated(*stated_reporting(reports, said.get("hold_max"), said.get("hold_step")))


def of_state(state: dict[str, Any]) -> Stated:
    """The reporting of a state of the wire."""
    found = state.get("reporting") or {}
    kind = str(found.get("kind", "")).removeprefix(_WIRE).lower()
    if kind not in ("changes", "events"):
        return Stated("samples")
    secs = [round(float(str(found[name]).removesuffix("s"))) for name in ("hold_max", "step")]
    return Stated(kind, *secs)


def check(stated: Stated, names: Iterable[str], states: list[dict[str, Any]]) -> None:
    """Refuses rows of states that exist with another reporting: if they were sent, they would be refused and use up
    numbers."""
    wanted = set(names)
    others = [(state["name"], of_state(state)) for state in states if state["name"] in wanted]
    others = [(name, found) for name, found in others if not stated.is_true_of(found)]
    if others:
        name, found = others[0]
        more = f", and {len(others) - 1} more states are reported otherwise" if len(others) > 1 else ""
        raise FailedPrecondition(
            f"state {name!r} exists and is reported by {found}, not by {stated}{more}. How a state is reported never "
            "changes: erase the state first (client.erase), and send with a label of its own. Nothing was sent",
            "FAILED_PRECONDITION",
        )


def check_values(names: Iterable[str], states: list[dict[str, Any]]) -> None:
    """Refuses rows without a value of states that report changes or events, if ``reports`` is not given."""
    wanted = set(names)
    lacking = [(state["name"], of_state(state)) for state in states if state["name"] in wanted]
    for name, found in lacking:
        if found.may_lack_value:
            raise InvalidArgument(
                f"some rows have no value, and state {name!r} is reported by {found.kind}: set reports={found.kind!r}, "
                "so that they mean that there is no value from then on",
                "INVALID_ARGUMENT",
            )
