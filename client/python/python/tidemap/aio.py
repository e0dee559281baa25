"""The client for asyncio: every call of :class:`tidemap.Client`, with ``await``.

    async with await tidemap.aio.connect("127.0.0.1:7435") as client:
        await client.observe("home", frame)
        async for reply in client.watch_anomalies("home"): ...

Invariant: a call waits in a thread of its own, and the loop runs meanwhile. A call whose ``await`` is cancelled goes on
in its thread; the rows that it sends still count once.
"""

from __future__ import annotations

import asyncio
import functools
import os
from collections.abc import AsyncIterator, Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ParamSpec, TypeVar

from tidemap.client import Client
from tidemap.connection import Stream
from tidemap.errors import FailedPrecondition
from tidemap.producer import Producer
from tidemap.times import Time

P = ParamSpec("P")
R = TypeVar("R")

_THREADS = 32


class AsyncStream(AsyncIterator[dict[str, Any]]):
    """Replies of the daemon, one by one, as they come."""

    def __init__(self, client: AsyncClient, begin: Callable[[], Stream]) -> None:
        self._client = client
        self._begin = begin
        self._stream: Stream | None = None

    async def __anext__(self) -> dict[str, Any]:
        if self._stream is None:
            self._stream = await self._client._run(self._begin)
            self._client._streams.add(self._stream)
        stream = self._stream
        try:
            reply = await self._client._run(lambda: next(stream, None))
        except asyncio.CancelledError:
            self.close()
            raise
        if reply is None:
            self.close()
            raise StopAsyncIteration
        return reply

    def close(self) -> None:
        """Ends the stream: no further reply is wanted."""
        if self._stream is not None:
            self._stream.close()
            self._client._streams.discard(self._stream)


class AsyncProducer:
    """Sends observations as they come; use it with ``async with``. Observations that it has taken are durable after
    ``flush()``."""

    def __init__(self, client: AsyncClient, begin: Callable[[], Producer]) -> None:
        self._client = client
        self._begin = begin
        self._producer: Producer | None = None

    async def __aenter__(self) -> AsyncProducer:
        self._producer = await self._client._run(self._begin)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    def _opened(self) -> Producer:
        if self._producer is None:
            raise FailedPrecondition(
                "the producer is not open: use async with client.producer(map)", "FAILED_PRECONDITION"
            )
        return self._producer

    async def send(self, state: str, time: Time, value: float | bool | str | None) -> int:
        """Takes an observation and returns its number, as :meth:`tidemap.Producer.send`."""
        producer = self._opened()
        return await self._client._run(lambda: producer.send(state, time, value))

    async def flush(self) -> int:
        """Waits until everything that was taken is durable, and returns the number of the last."""
        return await self._client._run(self._opened().flush)

    async def close(self) -> None:
        """Waits until everything is durable, and ends."""
        if self._producer is not None:
            await self._client._run(self._producer.close)


class AsyncClient:
    """A client of a daemon, for asyncio. ``client`` is the client without asyncio. It is pickled in the same way as
    ``client``."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self._is_own = False
        self._begin_threads()
        self._streams: set[Stream] = set()
        self.call = self._awaited(client.call)
        self.maps = self._awaited(client.maps)
        self.map = self._awaited(client.map)
        self.create_map = self._awaited(client.create_map)
        self.delete_map = self._awaited(client.delete_map)
        self.add_state = self._awaited(client.add_state)
        self.states = self._awaited(client.states)
        self.observe = self._awaited(client.observe)
        self.observe_grids = self._awaited(client.observe_grids)
        self.update = self._awaited(client.update)
        self.erase = self._awaited(client.erase)
        self.forget_producer = self._awaited(client.forget_producer)
        self.jobs = self._awaited(client.jobs)
        self.predict = self._awaited(client.predict)
        self.classify = self._awaited(client.classify)
        self.evaluate = self._awaited(client.evaluate)
        self.history = self._awaited(client.history)
        self.anomalies = self._awaited(client.anomalies)
        self.position = self._awaited(client.position)
        self.flow = self._awaited(client.flow)
        self.describe = self._awaited(client.describe)
        self.changed_cells = self._awaited(client.changed_cells)
        self.grid = self._awaited(client.grid)
        self.grids = self._awaited(client.grids)
        self.topology = self._awaited(client.topology)
        self.load_topology = self._awaited(client.load_topology)
        self.traverse = self._awaited(client.traverse)
        self.route = self._awaited(client.route)
        self.policy = self._awaited(client.policy)
        self.search = self._awaited(client.search)
        self.add_landmarks = self._awaited(client.add_landmarks)
        self.sight = self._awaited(client.sight)
        self.landmarks = self._awaited(client.landmarks)
        self.remove_landmarks = self._awaited(client.remove_landmarks)
        self.prune_landmarks = self._awaited(client.prune_landmarks)
        self.predict_landmarks = self._awaited(client.predict_landmarks)
        self.localise = self._awaited(client.localise)
        self.information = self._awaited(client.information)
        self.tour = self._awaited(client.tour)
        self.day = self._awaited(client.day)
        self.no_go = self._awaited(client.no_go)
        self.add_no_go = self._awaited(client.add_no_go)
        self.remove_no_go = self._awaited(client.remove_no_go)
        self.tasks = self._awaited(client.tasks)
        self.add_task = self._awaited(client.add_task)
        self.remove_task = self._awaited(client.remove_task)
        self.report_task = self._awaited(client.report_task)
        self.task_weeks = self._awaited(client.task_weeks)
        self.plan_tasks = self._awaited(client.plan_tasks)
        self.kept_plan = self._awaited(client.kept_plan)

    def _awaited(self, call: Callable[P, R]) -> Callable[P, Coroutine[Any, Any, R]]:
        @functools.wraps(call)
        async def waiting(*args: P.args, **kwargs: P.kwargs) -> R:
            return await self._run(functools.partial(call, *args, **kwargs))

        return waiting

    def _begin_threads(self) -> None:
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="tidemap")
        self._process = os.getpid()

    async def _run(self, call: Callable[[], R]) -> R:
        if self._process != os.getpid():
            # A fork does not copy threads.
            self._begin_threads()
        return await asyncio.get_running_loop().run_in_executor(self._threads, call)

    def close(self) -> None:
        """Ends all streams; calls that wait go on to their end. Closes the connections if :func:`connect` made them."""
        for stream in list(self._streams):
            stream.close()
        self._threads.shutdown(wait=False)
        if self._is_own:
            self.client.close()

    def __reduce__(self) -> tuple[type[AsyncClient], tuple[Client]]:
        return AsyncClient, (self.client,)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def stream(self, method: str, request: dict[str, Any] | None = None, *, zone: str | None = None) -> AsyncStream:
        """The replies of ``SERVICE/METHOD``, for ``async for``."""
        return AsyncStream(self, lambda: self.client.stream(method, request, zone=zone))

    def producer(self, map: str, producer: str = "python", label: str = "live", **options: Any) -> AsyncProducer:
        """A producer that stays open, for ``async with``; arguments as in :meth:`tidemap.Client.producer`."""
        return AsyncProducer(self, lambda: self.client.producer(map, producer, label, **options))

    def watch_anomalies(self, map: str, **request: Any) -> AsyncStream:
        """Observations that the model did not expect, live as they come, for ``async for``."""
        return AsyncStream(self, lambda: self.client.watch_anomalies(map, **request))


async def connect(server: str = "127.0.0.1:7435", **credentials: Any) -> AsyncClient:
    """A client of the daemon at ``server``, checked; arguments as in :func:`tidemap.connect`."""
    client = AsyncClient(Client(server, **credentials))
    client._is_own = True
    await client.maps()
    return client
