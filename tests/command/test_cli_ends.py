"""How the command ends when it does not simply succeed: signals, closed pipes, surprises."""

import contextlib
import errno
import importlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import torch

from tests.fixtures.pipeline_fixtures import FakeCore, Shot
from usdsmoke.ui.cli.main import main

PROJECT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_run_cleanly_and_the_same_command_goes_on(
    shot: Shot,
    core: FakeCore,
    capsys: pytest.CaptureFixture[str],
    number: signal.Signals,
    code: int,
) -> None:
    def interrupt(time_code: float) -> None:
        if time_code == 2.0:
            signal.raise_signal(number)

    core.before_frame = interrupt
    before = signal.getsignal(number)
    command = shot.arguments("--set", "windows.size=1", "--json")
    assert main(command) == code
    assert signal.getsignal(number) == before
    out, err = capsys.readouterr()
    assert json.loads(out)["error"]["type"] == "Interrupted"
    assert "1 of 3 frames" in err and "Traceback" not in err
    assert not list(shot.output.glob("*.usd*")) and not list(shot.output.rglob(".*"))
    core.before_frame = lambda time_code: None
    core.stylized.clear()
    assert main(command) == 0
    assert core.stylized == [2.0, 3.0]


@pytest.mark.parametrize("after_s", [0.2, 0.3, 0.4, 0.5, 0.6])
def test_a_signal_while_modules_are_loaded_is_not_lost(shot: Shot, after_s: float) -> None:
    """USD loads its own from C++, and loses what is raised there."""
    run = subprocess.Popen(
        [sys.executable, "-m", "usdsmoke", "stylize", *shot.arguments()[1:]],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=PROJECT,
    )  # fmt: skip
    time.sleep(after_s)
    run.send_signal(signal.SIGTERM)
    out, err = run.communicate(timeout=60)
    assert run.returncode in (143, -signal.SIGTERM) and not out  # before Python runs: not ours
    assert "Traceback" not in err and "Error loading" not in err


def test_a_signal_in_an_import_ends_the_command_behind_it(
    shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, core: FakeCore
) -> None:
    (tmp_path / "slow_module.py").write_text("import time\ntime.sleep(0.1)\n")
    monkeypatch.syspath_prepend(str(tmp_path))

    def load_and_lose(time_code: float) -> None:
        threading.Timer(0.05, signal.raise_signal, [signal.SIGINT]).start()
        with contextlib.suppress(BaseException):
            importlib.import_module("slow_module")
        time.sleep(1)

    core.before_frame = load_and_lose
    assert main(shot.arguments()) == 130
    assert len(core.stylized) == 0


def test_nobody_reading_stdout_is_no_error(shot: Shot) -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as stdout:
        done = subprocess.run(
            [sys.executable, "-m", "usdsmoke", "inspect", str(shot.stage)],
            stdout=stdout, stderr=subprocess.PIPE, text=True, cwd=PROJECT, timeout=60,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
@pytest.mark.parametrize("words", [["settings"], ["inspect", "none.usda", "--json"]])
def test_a_full_disk_behind_stdout_is_named_without_a_traceback(words: list[str]) -> None:
    command = [sys.executable, "-m", "usdsmoke", *words]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, cwd=PROJECT, text=True, check=False
        )
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert os.strerror(errno.ENOSPC) in done.stderr


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_a_process_without_stdout_or_stderr_works(shot: Shot, stream: str) -> None:
    closed = ">&-" if stream == "stdout" else "2>&-"
    command = f"exec {sys.executable} -m usdsmoke inspect {shot.stage} {closed}"
    done = subprocess.run(["sh", "-c", command], cwd=PROJECT, capture_output=True, timeout=60)
    assert (done.returncode, b"Traceback" in done.stderr) == (0, False)


def test_verbose_shows_where_an_error_comes_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(tmp_path / "no.usda")]) == 1
    assert "Traceback" not in capsys.readouterr().err
    assert main(["inspect", str(tmp_path / "no.usda"), "--verbose"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_an_unexpected_error_is_named_without_a_traceback(
    shot: Shot, core: FakeCore, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(time_code: float) -> None:
        raise IndexError("list index out of range")

    core.before_frame = fail
    assert main(shot.arguments()) == 1
    err = capsys.readouterr().err
    assert "unexpected IndexError: list index out of range" in err and "--verbose" in err
    assert "Traceback" not in err
    assert not shot.output.exists()


@pytest.mark.parametrize(
    ("error", "place"),
    [
        (MemoryError(), "out of memory."),
        (torch.cuda.OutOfMemoryError("CUDA"), "memory on the GPU."),
    ],
)
def test_an_error_of_memory_says_what_to_lower(
    shot: Shot, core: FakeCore, capsys: pytest.CaptureFixture[str], error: Exception, place: str
) -> None:
    def fail(time_code: float) -> None:
        raise error

    core.before_frame = fail
    assert main(shot.arguments()) == 1
    err = capsys.readouterr().err
    assert place in err and "views.pool" in err and "unexpected" not in err
    assert ("optimize.device=cpu" in err) == ("GPU" in place)
    assert not shot.output.exists()


def test_a_note_is_made_of_fractional_timecodes(
    shot: Shot, core: FakeCore, capsys: pytest.CaptureFixture[str]
) -> None:
    shot.stage.write_text(shot.stage.read_text().replace("{ 1: @", "{ 0.5: @"))
    assert main(shot.arguments()) == 0
    assert "timeCodes" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ("[1, 2]", "style.weights has 2 numbers for 1 style image"),
        ("[0]", "style.weights are 0"),
    ],
)
@pytest.mark.parametrize("more", [[], ["--dry-run"]])
def test_weights_that_do_not_fit_the_styles_are_refused_before_any_file_is_opened(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], weights: str, message: str
) -> None:
    """Neither the stage nor the style image is there."""
    files = [str(tmp_path / "no.usda"), "--style", str(tmp_path / "no.png")]
    options = ["-o", str(tmp_path / "out"), "--set", f"style.weights={weights}", *more]
    assert main(["stylize", *files, *options]) == 1
    out, err = capsys.readouterr()
    assert out == "" and message in err
    assert not (tmp_path / "out").exists()
