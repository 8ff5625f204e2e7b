"""Which workers of a cluster are refused and why; what happens where there is no cluster."""

import json
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from tests.fixtures.pipeline_fixtures import Shot
from usdsmoke import __version__
from usdsmoke.base.errors import ClusterError, MissingPackage
from usdsmoke.farm import dask
from usdsmoke.farm.dask import stylize_on_cluster
from usdsmoke.pipeline import Request
from usdsmoke.planning.plan import Plan
from usdsmoke.ui.cli.main import main


@pytest.fixture
def answer(tmp_path: Path) -> dict[str, Any]:
    """Of a worker that sees what was written."""
    (tmp_path / "token").touch()
    return dask._look_around([str(tmp_path / "token")])


def test_a_worker_that_sees_everything_is_taken_without_a_note(answer: dict[str, Any]) -> None:
    assert dask._check_answer("tcp://w:1", answer) == []


def test_a_worker_that_does_not_see_a_file_is_refused_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask, "_VISIBLE_S", 0.2)
    began = time.monotonic()
    answer = dask._look_around([str(tmp_path / "shot.usda")])
    assert 0.2 <= time.monotonic() - began < 2
    with pytest.raises(ClusterError, match=r"tcp://w:1.*/shot\.usda"):
        dask._check_answer("tcp://w:1", answer)


def test_a_file_that_shows_late_is_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "token"
    timer = threading.Timer(0.3, path.touch)
    timer.start()
    assert dask._look_around([str(path)])["missing"] == []
    timer.join()


def test_a_worker_of_another_version_is_refused(answer: dict[str, Any]) -> None:
    with pytest.raises(ClusterError, match=rf"tcp://w:1 .* 0\.0\.1, .*{__version__}"):
        dask._check_answer("tcp://w:1", answer | {"version": "0.0.1"})


def test_a_worker_without_usdsmoke_is_refused() -> None:
    error = ModuleNotFoundError("No module named 'usdsmoke'")
    with pytest.raises(ClusterError, match=r"tcp://w:1 .*No module named"):
        dask._check_answer("tcp://w:1", error)


def test_other_packages_are_worth_a_note(answer: dict[str, Any]) -> None:
    packages = answer["packages"] | {"torch": "0.1"}
    (note,) = dask._check_answer("tcp://w:1", answer | {"packages": packages})
    assert "tcp://w:1 has torch 0.1" in note


def test_without_the_package_the_error_says_how_to_get_it(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    plans: list[Plan] = []
    request = Request(shot.stage, shot.style, shot.output)
    with pytest.raises(MissingPackage, match=r"distributed .*pip install"):
        stylize_on_cluster("tcp://127.0.0.1:9", request, planned=plans.append)
    assert not plans
    assert not shot.output.exists()


@pytest.mark.parametrize("address", ["127.0.0.1:9", "", "threads"])
def test_an_address_without_a_protocol_is_refused(shot: Shot, address: str) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed")
    with pytest.raises(ClusterError, match="tcp://HOST:PORT"):
        stylize_on_cluster(address, Request(shot.stage, shot.style, shot.output))


def test_the_command_ends_with_1_where_dask_is_missing(
    shot: Shot, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(shot.arguments("--cluster", "tcp://127.0.0.1:9", "--json")) == 1
    assert json.loads(capsys.readouterr().out)["error"]["type"] == "MissingPackage"


@pytest.mark.parametrize("other", [["--coarse"], ["--window", "0"]])
def test_a_cluster_and_a_part_of_a_run_exclude_each_other(shot: Shot, other: list[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(shot.arguments("--cluster", "tcp://127.0.0.1:9", *other))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "tcp://", "nonsense://x:1"])
def test_a_scheduler_that_does_not_answer_is_named_soon(
    shot: Shot, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed")
    monkeypatch.setattr(dask, "_CONNECT_S", 0.5)
    with pytest.raises(ClusterError, match=f"no Dask scheduler answers at {address}"):
        stylize_on_cluster(address, Request(shot.stage, shot.style, shot.output))
    assert not shot.output.exists()


@contextmanager
def web_server() -> Iterator[int]:
    """A real one, which takes Dask's greeting for a bad request."""
    with ThreadingHTTPServer(("127.0.0.1", 0), QuietHandler) as server:
        threading.Thread(target=server.serve_forever).start()
        yield server.server_address[1]
        server.shutdown()


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        pass


@contextmanager
def greeter(words: bytes) -> Iterator[int]:
    """A server that says something to whoever comes, and nothing else."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        kept = []

        def greet() -> None:
            while True:
                try:
                    connection = server.accept()[0]
                except OSError:
                    return
                kept.append(connection)
                connection.sendall(words)

        thread = threading.Thread(target=greet)
        thread.start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)
        thread.join()
        for connection in kept:
            connection.close()


_HEAD = b"HTTP/1.1 400 Bad Request\r\n\r\n"  # read as a length: 3 EiB
_EMPTY = bytes(8)


@pytest.mark.parametrize(
    "server",
    [web_server, partial(greeter, b""), partial(greeter, _HEAD), partial(greeter, _EMPTY)],
    ids=["web server", "silence", "words", "zeros"],
)
def test_whatever_else_answers_is_found_out_without_a_trace(
    shot: Shot,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    server: Callable[[], AbstractContextManager[int]],
) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed")
    monkeypatch.setattr(dask, "_CONNECT_S", 0.5)
    with server() as port:
        assert main(shot.arguments("--cluster", f"tcp://127.0.0.1:{port}", "--json")) == 1
    out, err = capfd.readouterr()
    error = json.loads(out)["error"]
    assert error["type"] == "ClusterError"
    assert f"no Dask scheduler answers at tcp://127.0.0.1:{port} (" in error["message"]
    assert err.splitlines()[-1] == f"usdsmoke: {error['message']}"
    assert "Traceback" not in err and "Exception" not in err
    assert not shot.output.exists()
