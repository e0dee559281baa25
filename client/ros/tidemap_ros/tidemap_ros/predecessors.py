"""The common parts of the servers of both predecessors: predictions by a number of rhythms, and refusals.

Invariant: a goal is answered or refused with words; nothing that a client can send is sent on to the daemon without a
bound on its size.
"""

from __future__ import annotations

from typing import Any, Union

import numpy as np
import numpy.typing as npt

import tidemap
from tidemap import times as _times
from tidemap_ros.link import Link

Floats = npt.NDArray[np.float64]
Seconds = npt.NDArray[np.int64]

TIMES_MAX = 100_000
"""Times of a goal."""
IDS_MAX = 10_000
"""States of a goal."""
ORDER_MAX = 15
"""Rhythms that a model of tidemap has at most; the predecessors had more, of which these are the strongest."""
SECOND = 1_000_000_000
LAST_SECOND = 9_000_000_000
"""Times beyond it, in the year 2255, do not fit into nanoseconds."""

UNKNOWN, LENGTHS_DIFFER, FAILED = -1, -2, -3
"""Codes of refusals: the codes of fremenserver, and one for all refusals that it did not have."""


class Refused(Exception):
    """A goal that cannot be done; the message states why."""

    def __init__(self, message: str, code: int = FAILED) -> None:
        super().__init__(message)
        self.code = code


def selector(order: int) -> Union[str, dict[str, Any]]:
    """The model of an order: this number of rhythms, or for a negative order the model that the map has chosen."""
    if order < 0:
        return "auto"
    return {"kind": "MODEL_KIND_SPECTRAL", "order": min(order, ORDER_MAX)}


def checked_count(count: int, most: int, what: str) -> None:
    """Refuses too much of something."""
    if count > most:
        raise Refused(f"{count} {what} are too many: a goal may have {most}")


class States:
    """The states of the node's map."""

    def __init__(self, link: Link, map_name: str) -> None:
        self._link, self.map_name = link, map_name

    @property
    def client(self) -> Any:
        """The client of the daemon."""
        return self._link.client

    def predicted(self, names: list[str], seconds: Seconds, order: int) -> tuple[Floats, int]:
        """The values of states at times, a row for each state; and the number of their observations that no update has
        learned."""
        values = np.full((len(names), len(seconds)), np.nan)
        pending = 0
        if not names or not len(seconds):
            return values, pending
        request = {
            "map": self.map_name, "states": names, "times_nanos": seconds * SECOND, "model": selector(order),
        }
        for reply in self.client.stream("QueryService/PredictStates", request):
            name = names[reply["state_index"]]
            if reply["axis"]:
                raise Refused(f"the state {name} has several values: name one of them, such as {name}/x")
            first, part = reply["first_time_index"], reply["probabilities"]
            values[reply["state_index"], first : first + len(part)] = part
            if first == 0:
                pending += int(reply["pending"])
        return values, pending

    def described(self, name: str) -> dict[str, Any]:
        """The daemon's description of a state; refuses a state that is not there."""
        try:
            return dict(self.client.call("QueryService/DescribeModel", {"map": self.map_name, "state": name}))
        except tidemap.NotFound:
            raise self.missing(name) from None

    def missing(self, name: str) -> Refused:
        """The refusal of a state that is not there; raises the error of the daemon if the map is not there either."""
        self._link.map()
        return Refused(f"State ID {name} does not exist.", UNKNOWN)

    def names(self) -> set[str]:
        """The names of all states."""
        found: set[str] = set()
        token = ""
        while True:
            request = {"map": self.map_name, "page_size": 10_000, "page_token": token}
            page = self.client.call("MapService/ListStates", request)
            found.update(str(state["name"]) for state in page["states"])
            token = page["next_page_token"]
            if not token:
                return found

    def update(self) -> None:
        """Makes the map learn new observations, and waits until this ends."""
        self.client.update(self.map_name)


def nanos(timestamp: str) -> int:
    """A timestamp of the daemon, nanoseconds since 1970."""
    return int(_times.resolve(_times.read(timestamp), None, lambda: "UTC")[0])
