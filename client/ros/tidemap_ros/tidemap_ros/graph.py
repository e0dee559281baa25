"""Nav2's route graph beside the topology of the map, and the changes for the route server.

Invariant: an edge of the graph corresponds to at most one edge of the topology, by the names or the places of its
nodes.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

EDGE_ID_MAX = 65_535
"""Numbers of edges are 16 bits wide in Nav2's messages."""
BYTES_MAX = 64 << 20


class BadGraph(ValueError):
    """A file that is no route graph."""


@dataclass(frozen=True)
class Node:
    """A node of the topology of the map, or of the graph."""

    name: str
    x_m: float | None
    y_m: float | None


@dataclass(frozen=True)
class GraphEdge:
    """An edge of the graph, by the names of the topology; ``None``: the topology has no such node."""

    number: int
    start: int
    end: int


class RouteGraph:
    """A route graph of Nav2."""

    def __init__(self, nodes: dict[int, Node], edges: dict[int, GraphEdge]) -> None:
        self.nodes = nodes
        self.edges = edges

    @classmethod
    def read(cls, path: str | Path) -> RouteGraph:
        """Reads a GeoJSON file: points with ``id``, lines with ``id``, ``startid`` and ``endid``."""
        try:
            if Path(path).stat().st_size > BYTES_MAX:
                raise BadGraph(f"{path} is larger than {BYTES_MAX} bytes")
            return cls.parsed(json.loads(Path(path).read_text()))
        except (OSError, ValueError, RecursionError) as error:
            raise BadGraph(f"the route graph {path}: {error}") from None

    @classmethod
    def parsed(cls, known: Any) -> RouteGraph:
        """The graph of a GeoJSON FeatureCollection."""
        nodes: dict[int, Node] = {}
        edges: dict[int, GraphEdge] = {}
        features = known.get("features") if isinstance(known, dict) else None
        if not isinstance(features, list):
            raise BadGraph("no FeatureCollection")
        for feature in features:
            try:
                properties, geometry = feature["properties"], feature["geometry"]
                number = int(properties["id"])
                if geometry["type"] == "Point":
                    metadata = properties.get("metadata") or {}
                    name = str(properties.get("name") or metadata.get("name") or "")
                    x_m, y_m = (float(metres) for metres in geometry["coordinates"][:2])
                    nodes[number] = Node(name, x_m, y_m)
                else:
                    edges[number] = GraphEdge(number, int(properties["startid"]), int(properties["endid"]))
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                raise BadGraph(f"a feature that is no node and no edge: {error!r}") from None
        return cls(nodes, edges)

    def names(self, topology: list[Node], within_m: float) -> dict[int, str]:
        """The names of nodes of the graph in the topology: the same name, or else the nearest node."""
        by_name = {node.name for node in topology}
        placed = [node for node in topology if node.x_m is not None and node.y_m is not None]
        found: dict[int, str] = {}
        for number, node in self.nodes.items():
            if node.name in by_name:
                found[number] = node.name
                continue
            if node.x_m is None or node.y_m is None:
                continue
            x_m, y_m = node.x_m, node.y_m
            distances = [(math.hypot((one.x_m or 0) - x_m, (one.y_m or 0) - y_m), one.name) for one in placed]
            nearest = min(distances, default=(math.inf, ""))
            if nearest[0] <= within_m:
                found[number] = nearest[1]
        return found

    def ends(self, names: dict[int, str]) -> dict[int, tuple[str, str]]:
        """The names of the ends of edges of the graph in the topology."""
        return {
            edge.number: (names[edge.start], names[edge.end])
            for edge in self.edges.values() if edge.start in names and edge.end in names
        }


@dataclass(frozen=True)
class Repricing:
    """The changes for the route server."""

    closed: list[int]
    opened: list[int]
    costs: list[tuple[int, float]]
    """Number of the edge, and its cost in seconds."""


def repricing(
    ends: dict[int, tuple[str, str]], predicted: list[dict[str, Any]], closed_below: float, closed_before: set[int],
) -> Repricing:
    """The edges to close, to open again and to reprice, of the edges that ``PredictEdges`` predicts.

    The cost is the duration divided by the probability of success: the cost of an edge that is tried until it works.
    """
    known: dict[tuple[str, str], tuple[float, float]] = {}
    for edge in predicted:
        pair = edge["edge"]["from"], edge["edge"]["to"]
        success, secs = float(edge["success"]), float(edge["duration_secs"])
        # The best of several actions of an edge: the robot would take it.
        if pair not in known or secs / max(success, 1e-6) < known[pair][1] / max(known[pair][0], 1e-6):
            known[pair] = success, secs
    closed, costs = [], []
    for number, pair in sorted(ends.items()):
        if pair not in known or not 0 <= number <= EDGE_ID_MAX:
            continue
        success, secs = known[pair]
        if success < closed_below:
            closed.append(number)
        elif secs > 0:
            costs.append((number, secs / success))
    opened = sorted(closed_before - set(closed))
    return Repricing(closed, opened, costs)
