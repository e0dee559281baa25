"""Tests of the parts that need packages that are not on the index, with stand-ins for their types."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from rclpy.logging import get_logger

from tidemap_ros import optional
from tidemap_ros.charts import NoMap
from tidemap_ros.inputs import Inputs
from tidemap_ros.outputs import Outputs
from tidemap_ros.parameters import Settings


class RouteServer:
    """A client of DynamicEdges, and the requests that it received."""

    srv_name = "/route_server/adjust_edges"

    def __init__(self) -> None:
        self.asked: list[SimpleNamespace] = []
        self.is_ready = self.succeeds = True

    def service_is_ready(self) -> bool:
        return self.is_ready

    def call_async(self, request: SimpleNamespace) -> SimpleNamespace:
        self.asked.append(request)
        reply = SimpleNamespace(result=lambda: SimpleNamespace(success=self.succeeds))
        return SimpleNamespace(add_done_callback=lambda answered: answered(reply))


class EdgeCost:
    def __init__(self, edgeid: int, cost: float) -> None:
        self.edgeid, self.cost = edgeid, cost


def edge(start: str, end: str, success: float, secs: float = 10.0) -> dict:
    return {"edge": {"from": start, "to": end}, "success": success, "duration_secs": secs}


def outputs(predicted: list[dict]) -> SimpleNamespace:
    """The part of the outputs that the call needs."""
    ends = {3: ("hall", "lab"), 4: ("lab", "hall")}
    return SimpleNamespace(
        _settings=Settings({}), _closed=set(), _predicted=lambda: predicted,
        _inputs=SimpleNamespace(forget_ends=lambda: None, ends=lambda: ends),
        _node=SimpleNamespace(get_logger=lambda: get_logger("test")),
    )


def test_the_route_server_hears_which_edges_are_closed_and_opened_again():
    server, kind = RouteServer(), SimpleNamespace(Request=SimpleNamespace)
    predicted = [edge("hall", "lab", 0.1), edge("lab", "hall", 0.5)]
    known = outputs(predicted)

    def reprice() -> SimpleNamespace:
        Outputs._reprice(known, server, kind, EdgeCost)
        return server.asked[-1]

    first = reprice()
    assert (first.closed_edges, first.opened_edges) == ([3], [])
    assert [(cost.edgeid, cost.cost) for cost in first.adjust_edges] == [(4, 20.0)]
    predicted[0]["success"] = 0.9
    server.succeeds = False
    assert reprice().opened_edges == [3]
    # The request was refused: the edge is still closed there.
    server.succeeds = True
    assert reprice().opened_edges == [3]
    assert reprice().opened_edges == []
    server.is_ready = False
    with pytest.raises(NoMap, match="not there"):
        reprice()


def test_all_transforms_of_a_message_of_tf_are_taken():
    taken: list[tuple[object, bool]] = []
    known = SimpleNamespace(_intake=SimpleNamespace(transform=lambda one, is_static: taken.append((one, is_static))))
    Inputs._tf(known, True, SimpleNamespace(transforms=["a", "b"]))
    assert taken == [("a", True), ("b", True)]


def test_a_package_that_is_not_installed_costs_a_line():
    log: list[str] = []
    assert optional.found("nav2_msgs_of_nobody.msg", "EdgeCost", "/edges is not called", log.append) is None
    assert optional.found("std_msgs.msg", "NoSuchType", "nothing", log.append) is None
    assert optional.found("std_msgs.msg", "String.SLOT_TYPES", "nothing", log.append) is not None
    assert len(log) == 2 and "nav2_msgs_of_nobody" in log[0]
