"""Fixtures: buckets in memory, a local S3 server, and the stub of the engine."""

import os
import socket
import subprocess
import sys
import time
import urllib.request
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

import pytest

from tests.fleet import stub

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def engine(monkeypatch, tmp_path):
    """Install the stub in this process; return the folder of its journal."""
    from jaxdet import engine

    monkeypatch.setitem(vars(engine), "run_one", stub.run_one)
    journal = tmp_path / "journal"
    journal.mkdir()
    monkeypatch.setenv(stub.JOURNAL, str(journal))
    return journal


@pytest.fixture
def how(tmp_path):
    return {"config": {"ground": {"step_height_m": 0.03}}, "spool": str(tmp_path / "spool")}


@pytest.fixture
def stores(monkeypatch):
    """Replace buckets by stores in memory; return the stores by address."""
    pytest.importorskip("obstore")
    from obstore.store import MemoryStore

    from jaxdet.fleet import place

    made = defaultdict(MemoryStore)
    monkeypatch.setattr(place, "_store", made.__getitem__)
    place.open_place.cache_clear()
    yield made
    place.open_place.cache_clear()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _start_moto() -> tuple[subprocess.Popen, str]:
    port = free_port()
    command = [sys.executable, "-P", "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environment = {**os.environ, "MOTO_ALLOW_NONEXISTENT_REGION": "1"}
    server = subprocess.Popen(command, env=environment, **quiet)
    url, until = f"http://127.0.0.1:{port}", time.monotonic() + 60
    while time.monotonic() < until and server.poll() is None:
        with suppress(OSError), urllib.request.urlopen(url, timeout=5):
            return server, url
        time.sleep(0.2)
    server.kill()
    server.wait()
    raise RuntimeError("the S3 server does not start")


def started(start):
    """Return the result of ``start``, called up to three times."""
    for _ in range(2):
        with suppress(Exception):
            return start()
    return start()


@pytest.fixture(scope="session")
def moto():
    """Return the address of an S3 server on loopback."""
    server, url = started(_start_moto)
    yield url
    server.kill()
    server.wait()


@pytest.fixture
def bucket(moto, monkeypatch):
    """Return the address of a new bucket, which child processes can use, too."""
    import uuid

    from jaxdet.fleet import place

    settings = {
        "AWS_ENDPOINT_URL": moto,
        "AWS_ALLOW_HTTP": "true",
        "AWS_ACCESS_KEY_ID": "AKIDEXAMPLE",
        "AWS_SECRET_ACCESS_KEY": "topsecretvalue",
        "AWS_REGION": "us-east-1",
        "NO_PROXY": "127.0.0.1,localhost",
        "no_proxy": "127.0.0.1,localhost",
    }
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    name = f"b{uuid.uuid4().hex[:12]}"
    request = urllib.request.Request(f"{moto}/{name}", method="PUT")
    urllib.request.urlopen(request, timeout=30).close()
    place.open_place.cache_clear()
    yield f"s3://{name}"
    place.open_place.cache_clear()


@pytest.fixture
def put():
    """Return a function that writes logs, by key, to an address."""
    from jaxdet.fleet.place import open_place

    def put(url: str, **logs: str) -> None:
        for name, text in logs.items():
            open_place(url).put(f"{name}.mcap", text.encode())

    return put
