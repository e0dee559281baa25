"""No-go areas from Python: added, listed and removed; and no route leads through one."""

from __future__ import annotations

import pytest

import tidemap

PAINT = [(4.0, -1.0), (6.0, -1.0), (6.0, 1.0), (4.0, 1.0)]


def test_no_route_leads_through_an_area(client):
    pandas = pytest.importorskip("pandas")
    nodes = pandas.DataFrame({"name": ["A", "B", "C"], "x_m": [0.0, 10.0, 5.0], "y_m": [0.0, 0.0, 8.0]})
    ends = [("A", "B", 10), ("A", "C", 10), ("C", "B", 10)]
    edges = pandas.DataFrame([{"from": a, "to": b, "length_m": m, "both_ways": True} for a, b, m in ends])
    client.load_topology(client.name, edges, nodes)

    def way():
        return list(client.route(client.name, "A", "B", "2016-01-05T09:00:00Z")["to"])

    assert client.no_go(client.name) == {} and way() == ["B"]
    client.add_no_go(client.name, "paint", PAINT)
    client.add_no_go(client.name, "stairs", [(90, 90), (91, 90), (91, 91)])
    assert client.no_go(client.name) == {"paint": PAINT, "stairs": [(90.0, 90.0), (91.0, 90.0), (91.0, 91.0)]}
    assert way() == ["C", "B"]
    client.remove_no_go(client.name, "paint")
    assert list(client.no_go(client.name)) == ["stairs"] and way() == ["B"]


def test_what_is_no_area_is_refused(client):
    with pytest.raises(tidemap.errors.InvalidArgument):
        client.add_no_go(client.name, "line", [(0, 0), (1, 1)])
    with pytest.raises(tidemap.errors.NotFound):
        client.remove_no_go(client.name, "paint")
