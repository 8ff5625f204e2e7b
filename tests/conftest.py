"""Fixtures of the tests that run usdsmoke from end to end."""

import gc
import os
import signal
from collections.abc import Generator
from pathlib import Path

import pytest

# Set before torch is loaded, and for processes that tests start: tests run side by side, and their
# arrays are too small to share among threads.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # spinning threads crawl on shared machines

from tests.fixtures.client_fixtures import plume
from tests.fixtures.farm_fixtures import farm, farm_source, whole
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot, run_here, stand_in

__all__ = ["core", "farm", "farm_source", "plume", "quick_grids", "shot", "whole"]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is loaded with the tests stays: the garbage collector need not look at it again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> None:
    """The processes of pytest-xdist ignore Ctrl-C, and their children inherit that."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def shot(tmp_path: Path) -> Shot:
    """Three small frames, a style image, and a place for the result."""
    return make_shot(tmp_path)


@pytest.fixture
def quick_grids(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenVDB in this process: no limits, but no process to start for every file either."""
    monkeypatch.setattr("usdsmoke.vdb.child.run_child", run_here)


@pytest.fixture
def core(monkeypatch: pytest.MonkeyPatch) -> FakeCore:
    """A core that takes no time and leaves traces in what it writes."""
    return stand_in(monkeypatch)
