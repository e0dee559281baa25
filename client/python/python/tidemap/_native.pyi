"""The native part of the package."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

__version__: str

class Replies(Iterator[str]):
    def __iter__(self) -> Replies: ...
    def __next__(self) -> str: ...
    def cancel(self) -> None: ...

class OpenProducer:
    def send(self, state: str, time_nanos: int, value: float) -> int: ...
    def send_ranges(
        self,
        time_nanos: int,
        pose: tuple[float, float, float, float, float, float, float],
        angle_min_rad: float,
        angle_increment_rad: float,
        ranges_m: npt.NDArray[np.float32],
        min_range_m: float,
        max_range_m: float,
        free_range_m: float,
        trusted_range_m: float,
        frame_id: str,
    ) -> int: ...
    def send_cloud(
        self,
        time_nanos: int,
        pose: tuple[float, float, float, float, float, float, float],
        xyz_m: npt.NDArray[np.float32],
        min_range_m: float,
        max_range_m: float,
        frame_id: str,
    ) -> int: ...
    def send_grid(self, time_nanos: int, cells: npt.NDArray[np.int8], first_cell: tuple[int, int, int]) -> int: ...
    def send_label(self, state: str, time_nanos: int, label: str) -> int: ...
    def send_position(self, state: str, time_nanos: int, coordinates: list[float]) -> int: ...
    def send_traversal(self, driven: tuple[str, str, str, int, int, bool, str]) -> int: ...
    def progress(self) -> dict[str, Any]: ...
    def take_refusals(self) -> list[tuple[int, str | None, str]]: ...
    def abandon(self) -> None: ...
    def flush(self) -> int: ...
    def close(self) -> None: ...

class NativeQueue:
    def send(self, state: str, time_nanos: int, value: float) -> int: ...
    def send_ranges(
        self,
        time_nanos: int,
        pose: tuple[float, float, float, float, float, float, float],
        angle_min_rad: float,
        angle_increment_rad: float,
        ranges_m: npt.NDArray[np.float32],
        min_range_m: float,
        max_range_m: float,
        free_range_m: float,
        trusted_range_m: float,
        frame_id: str,
    ) -> int: ...
    def send_cloud(
        self,
        time_nanos: int,
        pose: tuple[float, float, float, float, float, float, float],
        xyz_m: npt.NDArray[np.float32],
        min_range_m: float,
        max_range_m: float,
        frame_id: str,
    ) -> int: ...
    def send_grid(self, time_nanos: int, cells: npt.NDArray[np.int8], first_cell: tuple[int, int, int]) -> int: ...
    def send_occupancy(
        self,
        time_nanos: int,
        pose: tuple[float, float, float, float, float, float, float],
        resolution_m: float,
        cells: npt.NDArray[np.int8],
    ) -> int: ...
    def send_label(self, state: str, time_nanos: int, label: str) -> int: ...
    def send_position(self, state: str, time_nanos: int, coordinates: list[float]) -> int: ...
    def send_traversal(self, driven: tuple[str, str, str, int, int, bool, str]) -> int: ...
    def state(self) -> dict[str, Any]: ...
    def retry_now(self) -> None: ...
    def sync(self) -> None: ...
    def progress(self) -> dict[str, Any]: ...
    def take_refusals(self) -> list[tuple[int, str | None, str]]: ...
    def abandon(self) -> None: ...
    def flush(self, patience_secs: float | None = None) -> int: ...
    def close(self) -> None: ...

class NativeClient:
    def __new__(
        cls,
        server: str,
        token: str | None = None,
        ca: bytes | None = None,
        certificate: bytes | None = None,
        key: bytes | None = None,
    ) -> NativeClient: ...
    @property
    def server(self) -> str: ...
    def close(self) -> None: ...
    def call(self, method: str, request: str) -> Replies: ...
    def check_states(self, kind: str | None, reporting: tuple[str, int | None, int | None] | None = None) -> None: ...
    def observe(
        self,
        map: str,
        states: list[str],
        state_indices: npt.NDArray[np.uint32],
        times_nanos: npt.NDArray[np.int64],
        values: npt.NDArray[np.float64],
        producer: str,
        label: str,
        kind: str | None,
        nightly: bool,
        positions: npt.NDArray[np.float64] | None = None,
        progress: Callable[[int, int], object] | None = None,
        reporting: tuple[str, int | None, int | None] | None = None,
    ) -> dict[str, Any]: ...
    def predict(
        self,
        map: str,
        states: list[str],
        times_nanos: npt.NDArray[np.int64],
        model: str,
        interval: float | None = None,
    ) -> tuple[
        npt.NDArray[np.float64],
        tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None,
        npt.NDArray[np.float64],
        list[tuple[str | None, int, int, int, int | None]],
        list[str],
    ]: ...
    def traverse(
        self,
        map: str,
        driven: list[tuple[str, str, str, int, int, bool, str]],
        producer: str,
        label: str,
        nightly: bool,
    ) -> dict[str, Any]: ...
    def sight(
        self,
        map: str,
        sightings: list[tuple[str, float | None, float | None, int, list[str], list[str]]],
        producer: str,
        label: str,
        nightly: bool,
    ) -> dict[str, Any]: ...
    def predict_grid(
        self,
        map: str,
        time_nanos: int,
        model: str,
        output: str,
        threshold: float,
        region: tuple[int, int, int, int, int, int] | None,
        project: bool,
    ) -> dict[str, Any]: ...
    def observe_grids(
        self,
        map: str,
        times_nanos: npt.NDArray[np.int64],
        cells: npt.NDArray[np.int8],
        first_cell: tuple[int, int, int],
        producer: str,
        label: str,
        nightly: bool,
    ) -> dict[str, Any]: ...
    def open_producer(
        self,
        map: str,
        producer: str,
        label: str,
        kind: str | None = None,
        reporting: tuple[str, int | None, int | None] | None = None,
        patience_secs: float = 60.0,
    ) -> OpenProducer: ...
    def open_queue(
        self,
        map: str,
        producer: str,
        label: str,
        folder: str,
        bytes_max: int,
        sync_secs: float,
        kind: str | None = None,
        reporting: tuple[str, int | None, int | None] | None = None,
    ) -> NativeQueue: ...

class NativeModel:
    @staticmethod
    def fit(
        kind: str,
        parameters: list[tuple[str, str]],
        times_nanos: npt.NDArray[np.int64],
        values: npt.NDArray[np.float64],
        state_kind: str,
        time_zone: str,
    ) -> NativeModel: ...
    def predict(self, times_nanos: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]: ...
    def rhythms(self) -> tuple[float, list[tuple[float, float, float]]] | None: ...

def model_request(name: str) -> str: ...
def model_parameters() -> dict[str, list[str]]: ...
def zone_offsets(zone: str, times_nanos: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]: ...
def stated_reporting(
    reports: str, hold_max_nanos: int | None = None, hold_step_nanos: int | None = None
) -> tuple[str, int | None, int | None]: ...
def duration_nanos(text: str) -> int: ...
def usual_words() -> tuple[list[str], list[str], list[str]]: ...
def evaluate(
    client: NativeClient,
    map: str,
    states: list[str],
    state_indices: npt.NDArray[np.uint32],
    times_nanos: npt.NDArray[np.int64],
    values: npt.NDArray[np.float64],
    models: list[str],
    max_order: int | None,
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]: ...
def history(
    client: NativeClient, map: str, state: str, from_nanos: int, to_nanos: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]: ...
