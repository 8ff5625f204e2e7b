"""The process that opens VDB files: damage, hunger and endless loops end in a named error."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import TIGHT, make_field, uniform
from usdsmoke.base.errors import (
    BindingMissing,
    DamagedFile,
    PlanError,
    UsdSmokeError,
    WriteFailed,
)
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb import child
from usdsmoke.vdb.child import ChildFailure, end_worker, run_child
from usdsmoke.vdb.read import GridRequest, read_binding_version, read_grids
from usdsmoke.vdb.write import write_frame

DENSITY = [GridRequest("density", where="field </plume/density>, timeCode 3")]
# A small file gets a share of the time limit: 1.2 s of these 8 s.
HASTY = GridsConfig(memory_limit_gib=1.0, time_limit_s=8.0)


@pytest.fixture(autouse=True)
def fresh_worker() -> Iterator[None]:
    """Every test begins and ends without a worker."""
    end_worker()
    yield
    end_worker()


def test_a_python_that_cannot_be_started_is_not_a_full_disk(
    tmp_path: Path, good_file: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "good.vdb").write_bytes(good_file)
    monkeypatch.setattr(child, "python_command", lambda code: [str(tmp_path / "no-python"), code])
    with pytest.raises(PlanError, match="cannot start"):
        read_grids(tmp_path / "good.vdb", DENSITY, GridsConfig())


@pytest.fixture(scope="module")
def good_file(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """About fifty kilobytes of noise, which compression leaves as it is."""
    file_path = tmp_path_factory.mktemp("child") / "good.vdb"
    field = make_field(shape=(20, 20, 20), index_to_world=uniform(0.1, (1.0, 2.0, 3.0)))
    write_frame(file_path, [field], {}, half=False)
    return file_path.read_bytes()


def tree_start(packed: bytes) -> int:
    """Where the tree begins: behind the map's name and its eighteen numbers."""
    name = b"UniformScaleTranslateMap"
    return packed.index(name) + len(name) + 18 * 8


@pytest.mark.parametrize("offset", [4, 60, 20_000])
def test_forty_bytes_of_ones_in_the_tree_end_in_a_named_error_soon(
    tmp_path: Path, good_file: bytes, offset: int
) -> None:
    """Some of these places make OpenVDB allocate without end, others loop, others abort."""
    place = tree_start(good_file) + offset
    file_path = tmp_path / "broken.vdb"
    file_path.write_bytes(good_file[:place] + b"\xff" * 40 + good_file[place + 40 :])
    start = time.monotonic()
    try:
        (field,) = read_grids(file_path, DENSITY, HASTY)
    except UsdSmokeError as error:
        for part in ("broken.vdb", "timeCode 3"):
            assert part in str(error)
    else:  # in a voxel's own bytes there is nothing to find out
        assert field.values.shape == (20, 20, 20)
    assert time.monotonic() - start < 60.0  # the limit is 8 CPU seconds; the machine may be busy


@pytest.mark.parametrize(
    "packed",
    [b"", b"\xff" * 40, b"this is no volume\n" * 100, b" BDV\0\0\0\0" + b"\xff" * 40],
    ids=["empty", "ones", "text", "mark and ones"],
)
def test_file_that_is_no_vdb_is_refused_without_a_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, packed: bytes
) -> None:
    (tmp_path / "a.vdb").write_bytes(packed)
    monkeypatch.setattr(child, "_run", lambda *_: pytest.fail("a process was started"))
    with pytest.raises(DamagedFile, match=r"a\.vdb.*VDB file"):
        read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)


def test_memory_limit_ends_a_hungry_file(tmp_path: Path, good_file: bytes) -> None:
    """The tree claims four thousand million topmost nodes, and OpenVDB begins to make them."""
    place = tree_start(good_file) + 12
    file_path = tmp_path / "hungry.vdb"
    file_path.write_bytes(good_file[:place] + b"\xff" * 4 + good_file[place + 4 :])
    patient = HASTY.replace(time_limit_s=120.0)
    with pytest.raises(DamagedFile, match=r"1 GiB of memory.*memory_limit_gib"):
        read_grids(file_path, DENSITY, patient)


def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """Let other code take the worker's place."""
    package = tmp_path / "search" / "usdsmoke" / "vdb"
    package.mkdir(parents=True)
    for folder in (package.parent, package):
        (folder / "__init__.py").write_text("")
    (package / "worker.py").write_text(code)
    monkeypatch.setattr(child, "_PACKAGE_PARENT", str(tmp_path / "search"))


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("input(); import os; os.abort()", "OpenVDB ended with SIGABRT"),
        ("import os; os.abort()", "OpenVDB ended with SIGABRT"),
        ("import os; os.kill(os.getpid(), 9)", "OpenVDB ended with SIGKILL"),
        ("import sys; sys.exit('malloc(): invalid size')", r"code 1 \(malloc\(\): invalid size\)"),
        ("import time; time.sleep(30)", "took longer than 1 s"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGPROF)", "more than 20 s"),
    ],
)
def test_every_end_of_the_process_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, words: str
) -> None:
    stand_in(tmp_path, monkeypatch, code)
    config = TIGHT.replace(time_limit_s=0.1 if "sleep" in code else 20.0)
    with pytest.raises(ChildFailure, match=words):
        run_child({"action": "describe"}, [], config)


def test_the_worker_ends_itself_when_its_processor_time_is_used_up() -> None:
    """By the clock it has ten times as long, or a busy machine would make sound files suspect."""
    code = "from usdsmoke.vdb.worker import _set_limits; _set_limits(2**33, 1)\nwhile 1: pass"
    ended = subprocess.run([sys.executable, "-c", code], timeout=300, check=False)
    assert ended.returncode == -signal.SIGPROF


def test_a_flood_of_messages_is_not_taken_into_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = "import sys\nsys.stderr.write('x' * 5_000_000 + '\\nthe end')\nsys.exit(3)"
    stand_in(tmp_path, monkeypatch, code)
    with pytest.raises(ChildFailure, match=r"code 3 \(the end\)"):
        run_child({"action": "describe"}, [], TIGHT)


def test_crash_while_loading_the_bindings_is_not_blamed_on_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in(tmp_path, monkeypatch, "import os; os.abort()")
    with pytest.raises(BindingMissing, match="SIGABRT"):
        read_binding_version(TIGHT)


def test_nothing_is_left_in_the_temporary_folder(
    tmp_path: Path, good_file: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (tmp_path / "a.vdb").write_bytes(good_file)
    read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
    assert os.listdir(tmp_path) == ["a.vdb"]


def test_temporary_folder_that_cannot_be_used_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", "/nowhere/at/all")
    with pytest.raises(WriteFailed, match="set TMPDIR"):
        run_child({"action": "describe"}, [], TIGHT)


def test_folder_that_is_worked_in_does_not_shadow_packages(
    tmp_path: Path, good_file: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "numpy.py").write_text("raise RuntimeError('shadowed')")
    (tmp_path / "a.vdb").write_bytes(good_file)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    (field,) = read_grids("a.vdb", DENSITY, TIGHT)
    assert np.isfinite(field.values).all()


def worker_id() -> int:
    worker = child._worker
    assert worker is not None
    return int(worker.process.pid)


def damaged(good_file: bytes, offset: int) -> bytes:
    place = tree_start(good_file) + offset
    return good_file[:place] + b"\xff" * 40 + good_file[place + 40 :]


def test_one_worker_serves_a_process_and_ends_with_its_last_request(
    tmp_path: Path, good_file: bytes
) -> None:
    (tmp_path / "a.vdb").write_bytes(good_file)
    read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
    first = worker_id()
    for number in range(3):
        write_frame(tmp_path / "b.vdb", [make_field(seed=number)], {}, half=False)
        read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
    assert worker_id() == first
    end_worker()
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)


@pytest.mark.parametrize("offset", [4, 12, 60])
def test_a_good_file_reads_right_after_a_damaged_one(
    tmp_path: Path, good_file: bytes, offset: int
) -> None:
    (tmp_path / "good.vdb").write_bytes(good_file)
    (before,) = read_grids(tmp_path / "good.vdb", DENSITY, HASTY)
    (tmp_path / "bad.vdb").write_bytes(damaged(good_file, offset))
    with pytest.raises(UsdSmokeError, match=r"bad\.vdb"):
        read_grids(tmp_path / "bad.vdb", DENSITY, HASTY)
    (after,) = read_grids(tmp_path / "good.vdb", DENSITY, HASTY)
    assert np.array_equal(before.values, after.values) and before.metadata == after.metadata


def test_metadata_of_one_file_is_not_carried_into_another(tmp_path: Path) -> None:
    write_frame(tmp_path / "a.vdb", [make_field(metadata={"mark": "first"})], {"of": "a"}, False)
    write_frame(tmp_path / "b.vdb", [make_field(seed=4)], {}, half=False)
    read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
    (field,) = read_grids(tmp_path / "b.vdb", DENSITY, TIGHT)
    assert "mark" not in field.metadata and np.array_equal(field.values, make_field(seed=4).values)


def test_each_request_has_the_whole_time_limit() -> None:
    """The limit counts from the request on, though the worker has worked before."""
    code = (
        "import time\nfrom usdsmoke.vdb.worker import _set_limits\n"
        "for n in range(3):\n"
        "    _set_limits(2**33, 1)\n"
        "    start = time.process_time()\n"
        "    while time.process_time() < start + 0.7: pass\n"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=300, check=False).returncode == 0


def test_a_worker_that_was_killed_meanwhile_is_replaced(tmp_path: Path, good_file: bytes) -> None:
    (tmp_path / "a.vdb").write_bytes(good_file)
    read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
    os.kill(worker_id(), signal.SIGKILL)
    child._worker.process.wait()
    (field,) = read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
    assert field.values.shape == (20, 20, 20)


def test_memory_that_large_grids_took_is_given_back(tmp_path: Path) -> None:
    """A worker that has grown is replaced, so every request has the same room."""
    write_frame(tmp_path / "a.vdb", [make_field(shape=(40, 40, 40))], {}, half=False)
    grown = []
    for number in range(6):
        edge = 20 + 30 * (number % 3)
        write_frame(tmp_path / "b.vdb", [make_field(shape=(edge,) * 3)], {}, half=False)
        pages = Path(f"/proc/{worker_id()}/statm").read_text().split()[1]
        grown.append(int(pages) * os.sysconf("SC_PAGE_SIZE"))
    assert max(grown) < 2**28


def test_threads_take_turns(tmp_path: Path) -> None:
    found: dict[int, np.ndarray] = {}

    def work(number: int) -> None:
        file_path = tmp_path / f"{number}.vdb"
        for _ in range(4):
            write_frame(file_path, [make_field(seed=number)], {}, half=False)
            found[number] = read_grids(file_path, DENSITY, TIGHT)[0].values

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(found[n], make_field(seed=n).values) for n in range(4))


def test_a_fork_starts_a_worker_of_its_own(tmp_path: Path, good_file: bytes) -> None:
    (tmp_path / "a.vdb").write_bytes(good_file)
    read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
    first = worker_id()
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            (field,) = read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
            code = 0 if field.values.shape == (20, 20, 20) and worker_id() != first else 2
            end_worker()
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
    assert worker_id() == first


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGTERM, None])
def test_the_worker_and_its_folders_go_with_the_parent(
    tmp_path: Path, good_file: bytes, by: signal.Signals | None
) -> None:
    (tmp_path / "a.vdb").write_bytes(good_file)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    code = (
        "import sys, time\nfrom usdsmoke.vdb import child\n"
        "from usdsmoke.vdb.read import *\nfrom usdsmoke.config.run_sections import GridsConfig\n"
        "read_grids(sys.argv[1], [GridRequest('density')], GridsConfig())\n"
        "print(child._worker.process.pid, flush=True)\n"
        "sys.stdin.read()\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "a.vdb")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
        text=True,
    )
    with parent:
        assert parent.stdout is not None and parent.stdin is not None
        worker = int(parent.stdout.readline())
        if by is None:
            parent.stdin.close()
        else:
            parent.send_signal(by)
    deadline = time.monotonic() + 30.0
    while Path(f"/proc/{worker}").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not Path(f"/proc/{worker}").exists()
    assert not list(temporary.iterdir())


def test_ctrl_c_ends_the_request_and_the_next_one_is_right(
    tmp_path: Path, good_file: bytes
) -> None:
    """The interrupted request's answer is not taken for that of the next."""
    (tmp_path / "a.vdb").write_bytes(good_file)
    (tmp_path / "slow.vdb").write_bytes(damaged(good_file, 12))
    timer = threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT))
    start = time.monotonic()
    timer.start()
    interrupted = False
    try:
        while time.monotonic() < start + 30:
            with suppress(UsdSmokeError):
                read_grids(tmp_path / "slow.vdb", DENSITY, TIGHT)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        timer.join()
    (field,) = read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
    assert interrupted and field.values.shape == (20, 20, 20)


def test_a_folder_for_temporary_files_that_is_full_is_named_and_no_file_is_called_damaged(
    tmp_path: Path, good_file: bytes
) -> None:
    """Neither the grid nor the answer can be written: files are limited to a few bytes."""
    (tmp_path / "a.vdb").write_bytes(good_file)
    read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)  # a worker is there
    before = resource.prlimit(worker_id(), resource.RLIMIT_FSIZE)
    for limit in (600, 8):
        resource.prlimit(worker_id(), resource.RLIMIT_FSIZE, (limit, before[1]))
        with pytest.raises(WriteFailed, match="TMPDIR"):
            read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
        read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)
