"""Landmarks, by which a robot recognises places: which are visible when, and localisation of a robot.

Invariant: nothing is computed here; the daemon predicts and matches.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tidemap import tables
from tidemap import times as _times
from tidemap.answers import Observed, observed
from tidemap.connection import Connection
from tidemap.errors import InvalidArgument
from tidemap.times import Time

if TYPE_CHECKING:
    import pandas


def _wrong(message: str) -> InvalidArgument:
    return InvalidArgument(message, "INVALID_ARGUMENT")


def _features(positions: Any, descriptors: Any) -> list[dict[str, Any]]:
    """Image features: positions of shape (n, 2) in pixels, and descriptors of shape (n, bytes), uint8."""
    places = np.asarray(positions, dtype=float).reshape(-1, 2)
    described = np.asarray(descriptors)
    if described.dtype != np.uint8 or described.ndim != 2:
        raise _wrong(f"descriptors are of {described.dtype} and shape {described.shape}: they must be uint8, (n, bytes)")
    if len(places) != len(described):
        raise _wrong(f"{len(places)} positions and {len(described)} descriptors: they must be as many")
    texts = [base64.b64encode(row.tobytes()).decode() for row in described]
    return [{"u_px": u, "v_px": v, "descriptor": text} for (u, v), text in zip(places.tolist(), texts)]


def _place(name: str) -> dict[str, Any]:
    """A place by its name: a node, or an edge ``from/to`` or ``from/to/action``."""
    if "/" not in name:
        return {"node": name}
    start, end, *action = name.split("/", 2)
    return {"edge": {"from": start, "to": end, "action": action[0] if action else ""}}


def _part(name: str, part: tuple[float, float] | None) -> dict[str, Any]:
    return _place(name) if part is None else {**_place(name), "from_m": part[0], "to_m": part[1]}


def _name(place: Mapping[str, Any]) -> str:
    if "edge" not in place:
        return str(place["node"])
    edge = place["edge"]
    return "/".join(str(part) for part in (edge["from"], edge["to"], edge.get("action")) if part)


def _row(landmark: Mapping[str, Any]) -> dict[str, Any]:
    """The description and place of a landmark."""
    path, marker = landmark.get("path") or {}, landmark.get("marker") or {}
    feature = landmark.get("image") or path.get("feature") or {}
    described = feature.get("descriptor")
    return {
        "landmark": landmark["name"],
        "kind": next(kind for kind in ("image", "marker", "path") if kind in landmark),
        "u_px": feature.get("u_px", np.nan),
        "v_px": feature.get("v_px", np.nan),
        "descriptor": None if described is None else base64.b64decode(described),
        "number": marker.get("number"),
        "along_m": path.get("along_m", np.nan),
    }


class Landmarks(Connection):
    """Landmarks, sightings, and finding places by them."""

    def add_landmarks(
        self,
        map: str,
        place: str,
        names: Sequence[str],
        positions: Any,
        descriptors: Any,
        *,
        kind: str = "",
        along_m: Any = None,
        velocity_profile: bytes | None = None,
    ) -> dict[str, Any]:
        """Adds image features to a node, or to an edge ``from/to``, or replaces the features of the same names.

        ``positions``: pixels, shape (n, 2). ``descriptors``: uint8, shape (n, bytes), as OpenCV gives them. ``kind``:
        the algorithm that computes them, such as ``"orb"``; a map has descriptors of one kind. At an edge ``along_m``
        gives for each feature how far along the edge it is seen. Markers: ``call("LandmarkService/AddLandmarks", …)``.
        """
        features = _features(positions, descriptors)
        if len(names) != len(features):
            raise _wrong(f"{len(names)} names and {len(features)} features: they must be as many")
        if along_m is None:
            landmarks = [{"name": str(name), "image": feature} for name, feature in zip(names, features)]
        else:
            along = np.asarray(along_m, dtype=float).tolist()
            if len(along) != len(features):
                raise _wrong(f"{len(along)} numbers in along_m and {len(features)} features: they must be as many")
            landmarks = [
                {"name": str(name), "path": {"along_m": metres, "feature": feature}}
                for name, feature, metres in zip(names, features, along)
            ]
        request: dict[str, Any] = {
            "map": map, "place": _place(place), "landmarks": landmarks, "descriptor_kind": kind
        }
        if velocity_profile is not None:
            request["velocity_profile"] = base64.b64encode(velocity_profile).decode()
        return self.call("LandmarkService/AddLandmarks", request)

    def sight(
        self,
        map: str,
        sightings: Iterable[Mapping[str, Any]],
        *,
        zone: str | None = None,
        producer: str = "python",
        label: str = "",
        nightly: bool = False,
    ) -> Observed:
        """Reports sightings, and waits until they are durable; the same ones again add nothing.

        Each sighting has ``time``, ``place`` and ``seen``, the names of the landmarks that were seen, and may have
        ``out_of_view``, and ``from_m`` and ``to_m`` for a part of an edge. It counts for all landmarks of the place: 1
        if it was seen, else 0, and nothing if it was out of view.
        """
        known = {"time", "place", "seen", "out_of_view", "from_m", "to_m"}
        rows = []
        for number, sighting in enumerate(sightings):
            missing = [name for name in ("time", "place", "seen") if name not in sighting]
            strange = [name for name in sighting if name not in known]
            if missing or strange:
                what = f"has no {missing[0]!r}" if missing else f"has {strange[0]!r}, which is not known"
                raise _wrong(f"sighting {number} {what}")
            time = self._moment(map, sighting["time"], zone)
            rows.append((
                str(sighting["place"]), sighting.get("from_m"), sighting.get("to_m"), time,
                [str(name) for name in sighting["seen"]], [str(name) for name in sighting.get("out_of_view", ())],
            ))
        return observed(self._native.sight(map, rows, producer, label, nightly))

    def landmarks(self, map: str, place: str | None = None) -> pandas.DataFrame:
        """The landmarks of a place with ``seen_share`` and ``sightings``; without a place: ``place, landmarks``."""
        tables.pandas_needed()
        request = {"map": map} if place is None else {"map": map, "place": _place(place)}
        reply = self.call("LandmarkService/ListLandmarks", request)
        if place is None:
            counts = [{"place": _name(row["place"]), "landmarks": row["landmarks"]} for row in reply["places"]]
            return tables.frame(counts, columns=["place", "landmarks"])
        rows = [
            {**_row(row["landmark"]), "seen_share": row["seen_share"], "sightings": int(row["sightings"])}
            for row in reply["landmarks"]
        ]
        return tables.frame(rows, columns=[*_row_columns(), "seen_share", "sightings"])

    def remove_landmarks(self, map: str, place: str, names: Sequence[str]) -> None:
        """Removes landmarks of a place; their learned data stays for a landmark of the same name that is added
        again."""
        request = {"map": map, "place": _place(place), "names": [str(name) for name in names]}
        self.call("LandmarkService/RemoveLandmarks", request)

    def prune_landmarks(
        self, map: str, below: float, *, min_sightings: int = 10, place: str | None = None, dry_run: bool = False
    ) -> dict[str, list[str]]:
        """Removes landmarks that were seen in less than a share of at least ``min_sightings`` sightings: names by place."""
        request: dict[str, Any] = {
            "map": map, "seldom_seen": {"below": below, "min_sightings": min_sightings}, "dry_run": dry_run
        }
        if place is not None:
            request["place"] = _place(place)
        reply = self.call("LandmarkService/RemoveLandmarks", request)
        return {_name(row["place"]): list(row["names"]) for row in reply["removed"]}

    def predict_landmarks(
        self,
        map: str,
        place: str,
        time: Time,
        *,
        count: int = 0,
        part: tuple[float, float] | None = None,
        zone: str | None = None,
    ) -> pandas.DataFrame:
        """The landmarks of a place that are visible at a time, the most probable first; at most ``count``, or all.

        ``part``: from and to, metres along an edge.
        """
        tables.pandas_needed()
        moment = _times.timestamp(self._moment(map, time, zone))
        request = {"map": map, "place": _part(place, part), "time": moment, "limit": count}
        reply = self.call("LandmarkService/PredictLandmarks", request)
        rows = [
            {**_row(row["landmark"]), "probability": row["probability"], "sightings": int(row["sightings"])}
            for row in reply["landmarks"]
        ]
        return tables.frame(rows, columns=[*_row_columns(), "probability", "sightings"])

    def localise(
        self,
        map: str,
        time: Time,
        positions: Any,
        descriptors: Any,
        *,
        count: int = 100,
        nodes: Sequence[str] = (),
        zone: str | None = None,
    ) -> pandas.DataFrame:
        """The nodes at which a robot with these image features may be, the best first.

        ``positions`` and ``descriptors`` as in :meth:`add_landmarks`. ``count``: landmarks of each node to compare.
        ``nodes``: where the robot may be. The columns are ``node, landmarks, matches, votes, heading_px, probability``.
        """
        tables.pandas_needed()
        request = {
            "map": map, "time": _times.timestamp(self._moment(map, time, zone)), "landmarks_per_node": count,
            "features": _features(positions, descriptors), "nodes": list(nodes),
        }
        reply = self.call("LandmarkService/Localise", request)
        columns = ["node", "landmarks", "matches", "votes", "heading_px", "probability"]
        rows = [{name: row.get(name, np.nan) for name in columns} for row in reply["nodes"]]
        return tables.frame(rows, columns=columns)


def _row_columns() -> list[str]:
    return ["landmark", "kind", "u_px", "v_px", "descriptor", "number", "along_m"]
