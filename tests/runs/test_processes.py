"""``--jobs``: windows as processes of this machine, side by side."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.fixtures.pipeline_fixtures import Shot, contents, make_shot
from usdsmoke.base import machine
from usdsmoke.base.errors import ClusterError, Interrupted, NonFiniteError, PlanError
from usdsmoke.config.settings import Config
from usdsmoke.farm import processes
from usdsmoke.pipeline import Request
from usdsmoke.runs.progress import RunProgress
from usdsmoke.ui.cli.main import main

QUICK = (
    "--set", "windows.size=2", "--set", "windows.overlap=1", "--set", "optimize.iterations=2",
    "--set", "views.image_size=16", "--set", "views.pool=2", "--set", "optimize.threads=1",
)  # fmt: skip


class StandIn:
    """Tasks of which one does something; the others note who did them."""

    def __init__(self, folder: Path, bad: int | None = None, what: str = "", gib: float = 0.1):
        self.folder, self.bad, self.what = folder, bad, what
        self.windows = {number: float(number) for number in range(4)}
        config = SimpleNamespace(layer=SimpleNamespace(look="a", mode="sublayer"))
        estimate = SimpleNamespace(memory_gib=gib)
        self.plan = SimpleNamespace(config=config, estimate=estimate)
        self.request = SimpleNamespace(output=folder)

    def run(self, window, progress) -> None:
        progress(RunProgress("shape", 1.0, 0, 1, 0.5))
        if window is not None and window == self.bad:
            if self.what == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.what == "bug":
                raise KeyError("a key")
            if self.what == "memory":
                raise RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to")
            raise NonFiniteError("there is a NaN. Repair it.")
        if window is not None and self.what == "wait":
            time.sleep(60)
        time.sleep(0.3)
        (self.folder / f"{window} {os.getpid()}").touch()


def start(monkeypatch, tasks: StandIn, jobs: int, told: list[float]) -> None:
    monkeypatch.setattr(processes, "prepare", lambda request: tasks)  # its plan is read
    monkeypatch.setattr(processes, "plan_with_notes", lambda job: job.plan)
    monkeypatch.setattr(processes, "divide_job", lambda job: tasks)
    monkeypatch.setattr(processes, "assemble", lambda *arguments: told.append(-1.0))
    request = Request("shot.usda", (), tasks.folder)
    processes.stylize_in_processes(jobs, request, lambda report: told.append(report.share))


def done(folder: Path) -> dict[str, str]:
    return {name: pid for name, _, pid in (item.name.partition(" ") for item in folder.iterdir())}


def test_processes_share_the_windows_after_the_coarse_step(tmp_path, monkeypatch) -> None:
    told: list[float] = []
    start(monkeypatch, StandIn(tmp_path), 2, told)
    found = done(tmp_path)
    assert set(found) == {"None", "0", "1", "2", "3"}
    assert len(set(found.values())) == 2
    assert told == [*sorted(told[:-1]), -1.0]  # never back; assembled at the end


@pytest.mark.parametrize(
    ("what", "error", "text"),
    [
        ("kill", ClusterError, "window 1 failed.*exit code -9.*--jobs"),
        ("memory", ClusterError, "window 1 failed.*--jobs"),
        ("bug", RuntimeError, "window 1 failed: KeyError: 'a key'"),
        ("", NonFiniteError, "NaN"),
    ],
)
def test_what_ends_a_process_ends_the_run_before_it_is_assembled(
    tmp_path, monkeypatch, what: str, error: type[Exception], text: str
) -> None:
    told: list[float] = []
    with pytest.raises(error, match=text):
        start(monkeypatch, StandIn(tmp_path, bad=1, what=what), 2, told)
    assert -1.0 not in told


@pytest.mark.parametrize(
    ("has_begun", "told"), [(True, "0 of 4 windows finished"), (False, "Nothing was left")]
)
def test_ctrl_c_ends_the_processes(tmp_path, monkeypatch, has_begun: bool, told: str) -> None:
    if has_begun:
        (tmp_path / "vdb/key").mkdir(parents=True)
        (tmp_path / "vdb/key/run.json").touch()
    alarm = threading.Timer(3.0, os.kill, (os.getpid(), signal.SIGINT))
    alarm.start()
    began = time.monotonic()
    with pytest.raises(Interrupted, match=told):
        start(monkeypatch, StandIn(tmp_path, what="wait"), 2, [])
    assert time.monotonic() - began < 30
    alarm.join()


def test_processes_that_do_not_fit_into_memory_are_refused(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(processes, "available_memory_gib", lambda: 8.0)
    with pytest.raises(PlanError, match=r"4.*12.0 GiB.*--jobs 2"):
        start(monkeypatch, StandIn(tmp_path, gib=3.0), 4, [])
    assert not done(tmp_path)


def test_side_by_side_gives_the_bits_of_one_after_the_other(tmp_path) -> None:
    shot = make_shot(tmp_path, n_frames=3)
    beside = Shot(shot.folder, shot.stage, shot.style, tmp_path / "beside")
    assert main(shot.arguments(*QUICK)) == 0
    assert main(beside.arguments(*QUICK, "--jobs", "2")) == 0
    one, other = (contents(item.output / "shot_look.usda") for item in (shot, beside))
    assert one == other
    assert len(one) == 3


@pytest.mark.parametrize(
    ("windows", "seconds", "gib", "cpus", "device", "gpu", "jobs"),
    [
        (5, 600.0, 1.0, 4, "auto", False, 4),  # as many as processors
        (3, 600.0, 1.0, 8, "auto", False, 3),  # as windows
        (5, 600.0, 3.0, 8, "auto", False, 2),  # as memory allows
        (5, 600.0, 30.0, 8, "auto", False, 1),
        (5, 20.0, 1.0, 8, "auto", False, 1),  # a short run
        (5, 600.0, 1.0, 4, "auto", True, 1),  # a GPU is used by one
        (5, 600.0, 1.0, 4, "cuda:1", True, 1),
        (5, 600.0, 1.0, 4, "cpu", True, 4),
    ],
)
def test_a_long_run_takes_as_many_processes_as_pay(
    monkeypatch, windows: int, seconds: float, gib: float, cpus: int, device: str, gpu: bool,
    jobs: int,
) -> None:  # fmt: skip
    monkeypatch.setattr(processes, "available_memory_gib", lambda: 8.0)
    monkeypatch.setattr(processes, "usable_cpus", lambda: cpus)
    monkeypatch.setattr(processes, "seems_to_have_gpu", lambda: gpu)
    estimate = SimpleNamespace(seconds=seconds, memory_gib=gib)
    config = Config().with_values({"optimize.device": device})
    plan = SimpleNamespace(tasks=[None] * windows, estimate=estimate, config=config)
    assert processes.choose_jobs(plan) == jobs


@pytest.mark.parametrize(
    ("version", "nodes", "seems"),
    [
        ("2.13.0+cu130", ["nvidia0", "nvidiactl"], True),
        ("2.13.0", ["kfd"], True),
        ("2.13.0+cpu", ["nvidia0"], False),
        ("2.13.0", ["nvidiactl", "null"], False),
    ],
)
def test_a_gpu_is_guessed_without_torch(
    monkeypatch, tmp_path: Path, version: str, nodes: list[str], seems: bool
) -> None:
    for node in nodes:
        (tmp_path / node).touch()
    monkeypatch.setattr(machine, "_DEVICES", tmp_path)
    monkeypatch.setattr(machine, "package_versions", lambda: {"torch": version})
    assert machine.seems_to_have_gpu() == seems


def test_a_process_uses_no_more_processors_than_its_share() -> None:
    code = "from usdsmoke.base.machine import limit_cpus, usable_cpus; limit_cpus(1); "
    command = [sys.executable, "-c", code + "print(usable_cpus())"]
    done = subprocess.run(command, capture_output=True, check=True)
    assert done.stdout.strip() == b"1"


@pytest.mark.parametrize(
    ("cpus", "n_processes", "threads"), [(1, 1, 1), (2, 1, 2), (16, 1, 4), (16, 5, 3), (2, 3, 1)]
)
def test_processes_share_processors_up_to_four_each(
    monkeypatch, cpus: int, n_processes: int, threads: int
) -> None:
    monkeypatch.setattr(machine, "_most_cpus", max(cpus // n_processes, 1))  # as a process is told
    monkeypatch.setattr(machine.os, "sched_getaffinity", lambda process: range(cpus))
    assert machine.usable_threads() == threads
