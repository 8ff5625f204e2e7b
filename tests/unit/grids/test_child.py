"""The process that opens VDB files: damage, hunger and endless loops end in a named error."""

import dataclasses
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.grids_fixtures import TIGHT, make_field, uniform
from usdsmoke.base.config import GridsConfig
from usdsmoke.base.errors import BindingMissing, DamagedFile, UsdSmokeError, WriteFailed
from usdsmoke.vdb import child
from usdsmoke.vdb.child import ChildFailure, run_child
from usdsmoke.vdb.read import GridRequest, read_binding_version, read_grids
from usdsmoke.vdb.write import write_frame

DENSITY = [GridRequest("density", where="field </plume/density>, timeCode 3")]
# A small file gets a share of the time limit: 1.2 s of these 8 s.
HASTY = GridsConfig(memory_limit_gib=1.0, time_limit_s=8.0)


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
    assert time.monotonic() - start < 10.0


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
    with pytest.raises(DamagedFile, match=r"a\.vdb is not a usable VDB file"):
        read_grids(tmp_path / "a.vdb", DENSITY, TIGHT)


def test_memory_limit_ends_a_hungry_file(tmp_path: Path, good_file: bytes) -> None:
    """The tree claims four thousand million topmost nodes, and OpenVDB begins to make them."""
    place = tree_start(good_file) + 12
    file_path = tmp_path / "hungry.vdb"
    file_path.write_bytes(good_file[:place] + b"\xff" * 4 + good_file[place + 4 :])
    patient = dataclasses.replace(HASTY, time_limit_s=120.0)
    with pytest.raises(DamagedFile, match=r"needs more than 1 GiB of memory.*memory_limit_gib"):
        read_grids(file_path, DENSITY, patient)


def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """Let other code take the worker's place."""
    package = tmp_path / "search" / "usdsmoke" / "grids"
    package.mkdir(parents=True)
    for folder in (package.parent, package):
        (folder / "__init__.py").write_text("")
    (package / "worker.py").write_text(code)
    monkeypatch.setattr(child, "_PACKAGE_PARENT", str(tmp_path / "search"))


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import os; os.abort()", "OpenVDB ended with SIGABRT"),
        ("import os; os.kill(os.getpid(), 9)", "OpenVDB ended with SIGKILL"),
        ("import sys; sys.exit('malloc(): invalid size')", r"code 1 \(malloc\(\): invalid size\)"),
        ("import time; time.sleep(30)", "took longer than 1 s"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGXCPU)", "more than 20 s of the proc"),
    ],
)
def test_every_end_of_the_process_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, words: str
) -> None:
    stand_in(tmp_path, monkeypatch, code)
    config = dataclasses.replace(TIGHT, time_limit_s=0.1 if "sleep" in code else 20.0)
    with pytest.raises(ChildFailure, match=words):
        run_child({"action": "describe"}, [], config)


def test_the_worker_ends_itself_when_its_processor_time_is_used_up() -> None:
    """By the clock it has ten times as long, or a busy machine would make sound files suspect."""
    code = "from usdsmoke.vdb.worker import _set_limits; _set_limits(2**33, 1)\nwhile 1: pass"
    ended = subprocess.run([sys.executable, "-c", code], timeout=300, check=False)
    assert ended.returncode == -signal.SIGXCPU


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
