"""Clients in other processes and in many calls at once: forks, pickles, an end, and a daemon without room."""

from __future__ import annotations

import asyncio
import os
import pickle
import signal
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import tidemap

DAY = np.datetime64("2026-01-12T00:00:00", "ns") + np.arange(24) * np.timedelta64(3_600_000_000_000, "ns")


def learned(client) -> None:
    when = np.datetime64("2026-01-05T00:00:00", "ns") + np.arange(1_000) * np.timedelta64(600_000_000_000, "ns")
    client.observe(client.name, states="door", times=when, values=np.arange(1_000) % 2)


def in_child(work) -> str:
    """The result of the work in a child of a fork; it must end within a minute."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            told = str(work())
        except BaseException as error:
            told = f"{type(error).__name__}: {error}"
        os.write(write, told.encode())
        os._exit(0)
    os.close(write)
    killer = threading.Timer(60, os.kill, (child, signal.SIGKILL))
    killer.start()
    with os.fdopen(read, "rb") as pipe:
        told = pipe.read().decode()
    killer.cancel()
    os.waitpid(child, 0)
    return told or "the child hung"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_a_client_works_in_a_forked_process(client):
    learned(client)
    expected = client.predict(client.name, "door", DAY).values.tolist()
    stream = client.watch_anomalies(client.name)
    with client.producer(client.name, label="kept") as producer:
        producer.send("hatch", DAY[0], 1)
        producer.flush()
        found = in_child(lambda: client.predict(client.name, "door", DAY).values.tolist() == expected)
        assert found == "True"
        for work in (lambda: producer.send("hatch", DAY[1], 1), producer.flush, lambda: next(stream)):
            refused = in_child(work)
            assert refused.startswith("FailedPrecondition") and "before this process was forked" in refused, refused
        assert in_child(lambda: (stream.close(), producer.__exit__(None, None, None))).startswith("FailedPrecondition")
        # The parent goes on as before.
        producer.send("hatch", DAY[1], 1)
    stream.close()
    assert client.predict(client.name, "door", DAY).values.tolist() == expected


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_the_end_of_a_forked_process_does_not_end_the_daemon():
    with tidemap.serve() as daemon:
        child = os.fork()
        if child == 0:
            try:
                daemon.stop()
            finally:
                os._exit(0)
        os.waitpid(child, 0)
        assert daemon.connect().maps() == [] and daemon.data_dir.exists()


def _predicted(client, name: str, hour: int) -> float:
    return float(client.predict(name, "door", DAY[hour : hour + 1]).values[0, 0])


@pytest.mark.parametrize("method", ["spawn", "fork"])
def test_a_client_is_sent_to_workers(client, method):
    if method == "fork" and sys.platform != "linux":
        pytest.skip("no forks here")
    learned(client)
    expected = [_predicted(client, client.name, hour) for hour in range(8)]
    with ProcessPoolExecutor(2, mp_context=get_context(method)) as workers:
        asked = [workers.submit(_predicted, client, client.name, hour) for hour in range(8)]
        assert [answer.result(timeout=60) for answer in asked] == expected


def test_a_pickle_has_files_and_no_secret(daemon, tmp_path, monkeypatch):
    token = tmp_path / "robot.token"
    token.write_text("tm_1_abc\n")
    monkeypatch.chdir(tmp_path)
    by_file = tidemap.Client(daemon.grpc, token_file="robot.token")
    text = pickle.dumps(by_file)
    assert b"abc" not in text and str(token).encode() in text
    monkeypatch.chdir("/")
    assert pickle.loads(text).maps() == by_file.maps()
    with pytest.raises(pickle.PicklingError, match="token_file=PATH"):
        pickle.dumps(tidemap.Client(daemon.grpc, token="tm_1_abc"))
    with pytest.raises(tidemap.InvalidArgument, match="token and token_file"):
        tidemap.Client(daemon.grpc, token="tm_1_abc", token_file=token)
    waiting = tidemap.aio.AsyncClient(tidemap.Client(daemon.grpc))
    assert pickle.loads(pickle.dumps(waiting)).client.server == waiting.client.server


def test_streams_and_producers_are_not_pickled(client):
    stream = client.watch_anomalies(client.name)
    with client.producer(client.name) as producer, pytest.raises(pickle.PicklingError, match="numbered in this"):
        pickle.dumps(producer)
    with pytest.raises(pickle.PicklingError, match="open call"):
        pickle.dumps(stream)
    stream.close()


def test_a_closed_client_refuses_calls(daemon):
    with daemon.connect() as client:
        assert client.maps() is not None
    with pytest.raises(tidemap.FailedPrecondition, match="closed"):
        client.maps()
    client.close()

    async def use() -> None:
        async with await tidemap.aio.connect(daemon.grpc) as waiting:
            await waiting.maps()
        with pytest.raises(tidemap.FailedPrecondition, match="closed"):
            waiting.client.maps()

    asyncio.run(use())


def test_a_thousand_questions_at_once_are_answered(client):
    learned(client)
    expected = client.predict(client.name, "door", DAY).values.tolist()
    many = np.datetime64("2026-01-12T00:00:00", "ns") + np.arange(20_000) * np.timedelta64(60_000_000_000, "ns")

    async def ask() -> list:
        async with await tidemap.aio.connect(client.server.removeprefix("http://")) as waiting:
            asked = [waiting.predict(client.name, "door", many if n % 10 == 0 else DAY) for n in range(1_000)]
            return await asyncio.gather(*asked)

    answers = asyncio.run(ask())
    assert len(answers) == 1_000
    assert all(answer.values.tolist() == expected for n, answer in enumerate(answers) if n % 10)
    with ThreadPoolExecutor(200) as threads:
        asked = [threads.submit(client.predict, client.name, "door", DAY) for _ in range(1_000)]
        assert all(answer.result().values.tolist() == expected for answer in asked)


def test_a_daemon_without_room_is_asked_again(tmp_path):
    config = tmp_path / "small.toml"
    config.write_text("max_requests = 2\n")
    with tidemap.serve(None, "--config", str(config)) as daemon, daemon.connect() as client:
        client.create_map("full")
        with ThreadPoolExecutor(32) as threads:
            asked = [threads.submit(client.map, "full") for _ in range(300)]
            assert all(answer.result()["name"] == "full" for answer in asked)


def test_what_is_too_much_at_any_time_is_refused_at_once(client):
    learned(client)
    start = time.monotonic()
    with pytest.raises(tidemap.ResourceExhausted):
        client.call("QueryService/PredictStates", {
            "map": client.name, "states": ["door"] * 200, "times_nanos": list(range(10**18, 10**18 + 60_000)),
        })
    assert time.monotonic() - start < 30
