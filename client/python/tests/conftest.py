"""A daemon for all tests, and a map of its own for each."""

from __future__ import annotations

import pytest

import tidemap


@pytest.fixture(scope="session")
def daemon():
    with tidemap.serve() as daemon:
        yield daemon


@pytest.fixture
def client(daemon, request):
    """A client with an empty map in UTC, whose name is in ``client.name``."""
    client = daemon.connect()
    name = "".join(letter if letter.isalnum() else "-" for letter in request.node.name.lower())[:60].strip("-")
    client.create_map(name)
    client.name = name
    yield client
    client.delete_map(name)
