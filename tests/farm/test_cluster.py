"""Windows on a Dask cluster of two worker processes: the bits of a plain run, whoever dies."""

import gc
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from tests.farm.test_farm import outcome
from tests.fixtures.pipeline_fixtures import make_shot, run, values_of, write_nan
from usdsmoke.base.errors import ClusterError, Interrupted, NonFiniteError
from usdsmoke.config.run_sections import OptimizeConfig
from usdsmoke.config.settings import Config
from usdsmoke.farm.dask import stylize_on_cluster
from usdsmoke.pipeline import Request
from usdsmoke.runs.progress import RunProgress

pytest.importorskip("distributed", reason="distributed is not installed")

PROJECT = Path(__file__).resolve().parents[2]
SETTINGS = ("windows.size=2", "windows.overlap=1", "optimize.threads=1", "layer.look=ember")
N_FRAMES = 8
N_BEGUN = 8 + 3  # three of the four windows go one frame beyond their own
PATIENCE_S = 30.0


@dataclass(frozen=True)
class Cluster:
    """A scheduler and its workers, as processes of this machine."""

    address: str
    folder: Path
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]

    @property
    def begun(self) -> list[tuple[int, float]]:
        """Process and timeCode of every frame that a worker began for this test, in order."""
        log = self.folder / "log"
        lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
        return [(int(pid), float(code)) for pid, code in map(str.split, lines)]

    def make_ready(self) -> None:
        """Forget the frames of other tests, and replace the workers that they killed."""
        (self.folder / "log").unlink(missing_ok=True)
        self.workers[:] = [worker for worker in self.workers if worker.poll() is None]
        self.add_workers(2 - len(self.workers))

    def add_workers(self, number: int) -> None:
        """Start worker processes of one thread, and wait until the scheduler knows them."""
        messages = self.folder / "dask_worker.txt"
        messages.touch()
        wanted = messages.read_text(encoding="utf-8").count("Registered to") + number
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard"]
        options += ["--preload", "tests.fixtures.cluster_worker"]
        options += ["--local-directory", str(self.folder)]
        for _ in range(number):
            self.workers.append(start(self.folder, "dask_worker", self.address, *options))
        until = time.monotonic() + PATIENCE_S
        while messages.read_text(encoding="utf-8").count("Registered to") < wanted:
            assert time.monotonic() < until
            time.sleep(0.05)


def start(folder: Path, program: str, *arguments: str) -> subprocess.Popen[bytes]:
    environment = {
        **os.environ,
        "PYTHONPATH": str(PROJECT),
        "USDSMOKE_TEST_LOG": str(folder / "log"),
        "OMP_NUM_THREADS": "1",
    }
    with open(folder / f"{program}.txt", "ab") as messages:
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{program}", *arguments],
            env=environment,
            cwd=folder,
            stdout=messages,
            stderr=messages,
        )


@contextmanager
def running(folder: Path) -> Iterator[Cluster]:
    """A scheduler, and the workers that are started, until the end."""
    contact = folder / "scheduler.json"
    options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    scheduler = start(folder, "dask_scheduler", *options, "--scheduler-file", str(contact))
    workers: list[subprocess.Popen[bytes]] = []
    try:
        until = time.monotonic() + PATIENCE_S
        while not contact.exists() or not contact.read_text(encoding="utf-8").endswith("}"):
            assert time.monotonic() < until and scheduler.poll() is None
            time.sleep(0.05)
        address = json.loads(contact.read_text(encoding="utf-8"))["address"]
        yield Cluster(address, folder, scheduler, workers)
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """The scheduler that tests use which do not kill it."""
    with running(tmp_path_factory.mktemp("cluster")) as cluster:
        yield cluster


@pytest.fixture
def cluster(shared: Cluster) -> Cluster:
    """A scheduler with two workers."""
    shared.make_ready()
    return shared


@pytest.fixture
def mortal(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler with a worker, for one test alone."""
    folder = tmp_path / "cluster"
    folder.mkdir()
    with running(folder) as cluster:
        cluster.add_workers(1)
        yield cluster


@pytest.mark.usefixtures("core")
def test_a_worker_that_is_killed_midway_changes_no_bit(tmp_path: Path, cluster: Cluster) -> None:
    shot = make_shot(tmp_path, N_FRAMES)
    expected = outcome(run(replace(shot, output=tmp_path / "plain"), *SETTINGS).root_stage)
    killed: list[int] = []
    windows: list[float] = []

    def kill_one(report: RunProgress) -> None:
        if report.step == "window":
            windows.append(report.share)
        if windows and not killed:
            killed.append(next_to_begin(cluster))
            os.kill(killed[0], signal.SIGKILL)

    result = stylize_on_cluster(
        cluster.address, Request(shot.stage, shot.style, shot.output, SETTINGS), progress=kill_one
    )
    assert outcome(result.root_stage) == expected
    assert windows == [0.25, 0.5, 0.75, 1.0]
    assert [worker.poll() for worker in cluster.workers].count(-signal.SIGKILL) == 1
    assert len(cluster.begun) > N_BEGUN, "the killed worker lost no frame"


def next_to_begin(cluster: Cluster) -> int:
    """The process that is the next to begin a frame, as soon as it has begun."""
    n_before, until = len(cluster.begun), time.monotonic() + PATIENCE_S
    while len(cluster.begun) == n_before:
        assert time.monotonic() < until
        time.sleep(0.005)
    return cluster.begun[-1][0]


@pytest.mark.usefixtures("core")
def test_an_error_of_a_task_is_raised_here_by_its_own_name(
    tmp_path: Path, cluster: Cluster
) -> None:
    shot = make_shot(tmp_path, 2)
    write_nan(shot.stage.parent / "cache/smoke.0002.vdb")
    with pytest.raises(NonFiniteError, match=r"smoke\.0002\.vdb"):
        stylize_on_cluster(cluster.address, Request(shot.stage, shot.style, shot.output))
    assert not list(shot.output.glob("*.usd*"))


@pytest.mark.usefixtures("core")
def test_a_run_that_was_stopped_goes_on_where_it_was(tmp_path: Path, cluster: Cluster) -> None:
    shot = make_shot(tmp_path, N_FRAMES)

    def stop(report: RunProgress) -> None:
        if report.step == "window":
            raise KeyboardInterrupt

    with pytest.raises(Interrupted, match=r"stopped with 1 of 4 windows finished.*same command"):
        stylize_on_cluster(
            cluster.address, Request(shot.stage, shot.style, shot.output, SETTINGS), progress=stop
        )
    result = stylize_on_cluster(
        cluster.address, Request(shot.stage, shot.style, shot.output, SETTINGS)
    )
    expected = outcome(run(replace(shot, output=tmp_path / "plain"), *SETTINGS).root_stage)
    assert outcome(result.root_stage) == expected


def test_a_cluster_that_loses_all_workers_is_given_up(
    tmp_path: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("usdsmoke.farm.dask._LOST_S", 0.5)
    monkeypatch.setattr("usdsmoke.farm.dask._POLL_S", 0.2)
    shot = make_shot(tmp_path, 2)

    def kill_all(report: RunProgress) -> None:
        for worker in cluster.workers:
            worker.kill()

    with pytest.raises(ClusterError, match=r"[Ff]inished"):
        stylize_on_cluster(
            cluster.address, Request(shot.stage, shot.style, shot.output), progress=kill_all
        )


@pytest.mark.parametrize("moment", ["look_around", "coarse", "window"])
@pytest.mark.usefixtures("core")
def test_a_scheduler_that_dies_ends_the_run_and_keeps_its_windows(
    tmp_path: Path,
    mortal: Cluster,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    moment: str,
) -> None:
    shot = make_shot(tmp_path, N_FRAMES)

    def write_and_kill(*arguments: object) -> None:
        mortal.scheduler.kill()

    def kill_scheduler(report: RunProgress) -> None:
        if report.step == moment:
            mortal.scheduler.kill()

    if moment == "look_around":
        monkeypatch.setattr("usdsmoke.farm.dask.publish_file", write_and_kill)
    with pytest.raises(ClusterError, match=r"scheduler .*[Ff]inished"):
        request = Request(shot.stage, shot.style, shot.output, SETTINGS)
        stylize_on_cluster(mortal.address, request, kill_scheduler)
    gc.collect()
    assert capfd.readouterr().err == ""
    assert bool(list(shot.output.glob("vdb/*/windows/*.json"))) == (moment == "window")


@pytest.mark.usefixtures("core")
def test_frames_of_a_result_are_made_again_and_no_others(tmp_path: Path, cluster: Cluster) -> None:
    shot = make_shot(tmp_path, N_FRAMES)
    first = run(shot, *SETTINGS)
    expected = outcome(first.root_stage)
    first.frames[3].unlink()
    settings = [*SETTINGS, "stage.frames=4"]
    request = Request(shot.stage, shot.style, shot.output, settings)
    result = stylize_on_cluster(cluster.address, request)
    assert {code for _, code in cluster.begun} == {3, 4, 5}  # a window, and the one frame beyond
    assert outcome(result.root_stage) == expected


@pytest.mark.usefixtures("core")
def test_requests_and_what_is_stronger_than_they_reach_the_workers(
    tmp_path: Path, cluster: Cluster
) -> None:
    """The prim asks for a seed, which the run overrides, and for one step, which it does not."""
    shot = make_shot(tmp_path, 2)
    asked = """prepend apiSchemas = ["UsdSmokeStyleAPI"]
    )
    {
        int64 usdSmoke:request:seed = 5
        token[] usdSmoke:request:steps = ["colour"]
"""
    text = shot.stage.read_text(encoding="utf-8")
    text = text.replace('def Volume "smoke"\n    {\n', f'def Volume "smoke" (\n    {asked}')
    shot.stage.write_text(text, encoding="utf-8")
    settings = ("optimize.threads=1", "optimize.seed=2")
    result = stylize_on_cluster(
        cluster.address,
        Request(
            shot.stage,
            shot.style,
            shot.output,
            [Config(optimize=OptimizeConfig(seed=7)), settings],
        ),
    )
    assert values_of(result.frames[0]).max() == 0.625  # the shape step would have halved it
    assert values_of(result.frames[0], "emission").max() == 0.625 * (1 + 2)
