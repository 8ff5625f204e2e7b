"""Writing a frame: what is refused, what is left out, and that a short write is found out."""

import dataclasses
import errno
import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import TIGHT, make_field, make_vectors
from usdsmoke.base.errors import NonFiniteError, WriteFailed
from usdsmoke.vdb import child, write
from usdsmoke.vdb.child import ChildFailure
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.vdb.write import clean_metadata, write_frame

PROJECT = Path(__file__).resolve().parents[3]


def test_metadata_is_kept_in_pythons_own_types() -> None:
    given = {
        "text": "é",
        "truth": np.bool_(True),
        "number": np.int64(2**40),
        "real": np.float32(0.5),
        "triple": (1, 2, 3),
        "reals": [0.5, 1, 2],
        "array": np.arange(3),
        "scalar": np.array(1.5),
        "none": None,
        "bytes": b"abc",
        "bool triple": (True, False, True),
        "pair": (1, 2),
        "nan": float("nan"),
        "huge": 2**80,
        "map": {"a": 1},
        "": "nameless",
    }
    cleaned = clean_metadata(given)
    assert cleaned == {
        "text": "é", "truth": True, "number": 2**40, "real": 0.5, "triple": (1, 2, 3),
        "reals": (0.5, 1.0, 2.0), "array": (0, 1, 2), "scalar": 1.5,
    }  # fmt: skip
    assert type(cleaned["truth"]) is bool
    assert {type(n) for n in cleaned["array"]} == {int}


@pytest.mark.parametrize("change", [{"values": np.full((1, 1, 1), np.nan, np.float32)}])
def test_what_is_not_finite_is_not_written(tmp_path: Path, change: dict[str, Any]) -> None:
    field = dataclasses.replace(make_field(), **change)
    with pytest.raises(NonFiniteError, match=r'"density" of a\.vdb: 1'):
        write_frame(tmp_path / "a.vdb", [field], {}, half=False)
    assert os.listdir(tmp_path) == []


def test_value_that_half_cannot_hold_is_refused(tmp_path: Path) -> None:
    field = dataclasses.replace(make_field(), values=np.full((1, 1, 1), 70000, np.float32))
    with pytest.raises(WriteFailed, match=r"70000.*65504.*grids\.half"):
        write_frame(tmp_path / "a.vdb", [field], {}, half=True)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("names", [("a", "a"), ("",)])
def test_grids_need_names_of_their_own(tmp_path: Path, names: tuple[str, ...]) -> None:
    with pytest.raises(WriteFailed, match=r"cannot write a\.vdb.* name"):
        write_frame(tmp_path / "a.vdb", [make_field(name) for name in names], {}, half=False)


def test_voxel_size_that_openvdb_cannot_hold_is_named(tmp_path: Path) -> None:
    field = make_field(index_to_world=np.diag([1e-9, 1e-9, 1e-9, 1.0]))
    with pytest.raises(WriteFailed, match=r"OpenVDB.* 1e-27"):
        write_frame(tmp_path / "a.vdb", [field], {}, half=False)
    assert os.listdir(tmp_path) == []


def test_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(WriteFailed, match=r"cannot write a\.vdb"):
        write_frame(tmp_path / "none" / "a.vdb", [make_field()], {}, half=False)


def test_disk_that_fills_up_keeps_the_old_file(tmp_path: Path) -> None:
    """OpenVDB reports nothing; a file size limit stands in for the full disk."""
    target = tmp_path / "smoke.0001.vdb"
    write_frame(target, [make_field()], {}, half=False)
    before = target.read_bytes()
    code = (
        "import resource, sys\n"
        "import numpy as np\n"
        "from tests.fixtures.grids_fixtures import make_field\n"
        "from usdsmoke.base.errors import WriteFailed\n"
        "from usdsmoke.vdb import child\n"
        "from usdsmoke.vdb.write import write_frame\n"
        "hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, hard))\n"
        "child._worker = child._Worker()\n"  # only this process: the hand-over needs room too
        "resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))\n"
        "try:\n"
        "    write_frame(sys.argv[1], [make_field(shape=(40, 40, 40))], {}, half=False)\n"
        "except WriteFailed as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(target)],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "smoke.0001.vdb does not read back" in done.stdout
    assert "full" in done.stdout
    assert target.read_bytes() == before
    assert os.listdir(tmp_path) == ["smoke.0001.vdb"]


class FullDisk(io.BytesIO):
    """A file that takes nothing any more."""

    def write(self, data: Any) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("is_crash", [False, True])
def test_a_full_disk_is_called_so_and_not_a_damaged_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_crash: bool
) -> None:
    def write_nothing(*arguments: object) -> None:
        if is_crash:
            raise ChildFailure("OpenVDB ended with SIGSEGV")

    monkeypatch.setattr(child, "run_child", write_nothing)
    monkeypatch.setattr(write, "open", lambda *_, **__: FullDisk(), raising=False)
    message = r"cannot write a\.vdb in .*: No space left on device.*space"
    with pytest.raises(WriteFailed, match=message):
        write_frame(tmp_path / "a.vdb", [make_field()], {}, half=False)
    assert os.listdir(tmp_path) == []


def test_a_folder_that_may_not_be_written_to_is_named_before_anything_is_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    monkeypatch.setattr(child, "run_child", lambda *_: pytest.fail("OpenVDB was started"))
    with pytest.raises(WriteFailed, match=r"Read-only file system.*output folder"):
        write_frame(tmp_path / "a.vdb", [make_field()], {}, half=False)


@pytest.mark.parametrize(
    "change",
    [
        {"values": make_field(seed=5).values},
        {"index_to_world": np.diag([0.1, 0.1, 0.11, 1.0])},
        {"name": "other"},
    ],
    ids=lambda change: next(iter(change)),
)
def test_file_that_came_back_different_is_found_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, Any]
) -> None:
    described = write._described

    def describe_another(field):
        return described(dataclasses.replace(field, **{k: change[k] for k in change}))

    monkeypatch.setattr(write, "_described", describe_another)
    if "values" in change:
        run = child.run_child

        def write_others(request: Any, arrays: Any, config: Any) -> Any:
            return run(request, [change["values"]] if arrays else [], config)

        monkeypatch.setattr(child, "run_child", write_others)
    with pytest.raises(WriteFailed, match=r"a\.vdb"):
        write_frame(tmp_path / "a.vdb", [make_field()], {}, half=False)
    assert os.listdir(tmp_path) == []


def test_kill_while_writing_leaves_the_old_file_and_the_next_run_finishes(tmp_path: Path) -> None:
    target = tmp_path / "smoke.0001.vdb"
    write_frame(target, [make_field()], {}, half=False)
    before = target.read_bytes()
    code = (
        "import sys\n"
        "from tests.fixtures.grids_fixtures import make_field\n"
        "from usdsmoke.vdb.write import write_frame\n"
        "print('started', flush=True)\n"
        "write_frame(sys.argv[1], [make_field(shape=(60, 60, 60))], {}, half=False)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(target)], cwd=PROJECT, stdout=subprocess.PIPE, text=True
    )
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        deadline = time.monotonic() + 20.0
        while len(os.listdir(tmp_path)) == 1 and time.monotonic() < deadline:
            time.sleep(0.001)  # until the temporary is there
        process.send_signal(signal.SIGKILL)
    # Old or new, never a mixture: the kill may have come just after the rename.
    if target.read_bytes() != before:
        (field,) = read_grids(target, [GridRequest("density")], TIGHT)
        assert field.values.shape == (60, 60, 60)
    write_frame(target, [make_field(seed=9)], {}, half=False)
    (field,) = read_grids(target, [GridRequest("density")], TIGHT)
    assert np.array_equal(field.values, make_field(seed=9).values)


def test_empty_and_blank_fields_become_empty_grids(tmp_path: Path) -> None:
    nothing = np.zeros((0, 0, 0), np.float32)
    fields = [
        dataclasses.replace(make_field("density"), values=nothing),
        dataclasses.replace(make_field("blank"), values=np.zeros((3, 3, 3), np.float32)),
        dataclasses.replace(make_vectors("emission"), values=nothing),
    ]
    write_frame(tmp_path / "a.vdb", fields, {}, half=False)
    grids = read_header(tmp_path / "a.vdb").grids
    assert [(grid.name, grid.value_type, grid.active_voxels) for grid in grids] == [
        ("density", "float", 0),
        ("blank", "float", 0),
        ("emission", "vec3s", 0),
    ]


def test_vectors_are_invariant_unless_their_source_said_otherwise(tmp_path: Path) -> None:
    fields = [
        make_vectors("emission"),
        make_vectors("vel", metadata={"vector_type": "contravariant relative"}),
        make_vectors("odd", metadata={"vector_type": "no such thing"}),
    ]
    write_frame(tmp_path / "a.vdb", fields, {}, half=False)
    types = [grid.metadata["vector_type"] for grid in read_header(tmp_path / "a.vdb").grids]
    assert types == ["invariant", "contravariant relative", "invariant"]
