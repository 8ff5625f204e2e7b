"""Every kind of file that is written opens under OpenVDB 12 with the same bits, and the way back.

OpenVDB 12 comes with Blender's Python module. Its environment is named by USDSMOKE_BPY_PYTHON;
without it these tests are skipped. CONTRIBUTING.md tells how to make one.
"""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.client_fixtures import ALL, WINDOWS, dense, expected
from tests.fixtures.grids_fixtures import make_field, openvdb, raw_grid, rotated, write_raw
from tests.fixtures.other_openvdb import describe
from tests.fixtures.pipeline_fixtures import PROJECT, Shot, copied, run
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.content_hash import CONTENT_KEY, hash_fields, hash_vdb_file
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.vdb.write import write_frame

OTHER_PYTHON = os.environ.get("USDSMOKE_BPY_PYTHON", "")
pytestmark = pytest.mark.skipif(
    not OTHER_PYTHON, reason="needs USDSMOKE_BPY_PYTHON, the Python of an environment with bpy"
)

HALF = "grids.half=true"
KINDS = {
    "float": (),
    "half": (HALF,),
    "options": ALL,
    "options in half": (*ALL, HALF),
    "velocity": ("layer.copy_velocity=true",),
}


def written(plume: Shot, folder: Path) -> dict[str, Path]:
    """Files of every kind in ``folder``, by what they are."""
    write_raw(plume.folder / "in/cache/smoke.0002.vdb", raw_grid(np.zeros((0, 0, 0), np.float32)))
    for code in (1, 3):
        name = plume.folder / f"in/cache/smoke.{code:04d}.vdb"
        velocity = raw_grid(np.ones((2, 2, 2, 3), np.float32), "vel", grid_class="unknown")
        write_raw(name, openvdb().read(str(name), "density"), velocity)
    found = {}
    for number, (kind, settings) in enumerate(KINDS.items()):
        shot = copied(plume, f"kind{number}")
        frames = "stage.frames=1,3" if kind == "velocity" else "stage.frames=1-5"
        result = run(shot, frames, *WINDOWS, *settings)
        for name in shot.output.rglob("*.vdb"):  # results, parts, and the file without a colour
            place = name.relative_to(result.frames[0].parent).with_suffix("")
            found[f"{kind} {place}"] = name
    turned = make_field("density", index_to_world=rotated(), background=0.25)
    found["turned"] = plume.folder / "turned.vdb"
    write_frame(found["turned"], [turned], {}, half=False)
    for label, file_path in found.items():
        shutil.copy(file_path, folder / f"{label.replace('/', ' ')}.vdb")
    return {label.replace("/", " "): path for label, path in found.items()}


def test_openvdb_12_reads_the_same_bits_and_writes_what_we_read_again(
    plume: Shot, tmp_path: Path
) -> None:
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    ours.mkdir()
    theirs.mkdir()
    files = written(plume, ours)
    done = subprocess.run(
        [OTHER_PYTHON, str(PROJECT / "tests/fixtures/other_openvdb.py"), str(ours), str(theirs)],
        capture_output=True,
        text=True,
        timeout=100,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)[0] >= 12
    assert any("parts" in label for label in files)
    assert any("0006" in label for label in files)  # no colour where the source is shown
    for label in files:
        grids, _ = openvdb().readAll(str(ours / f"{label}.vdb"))
        record = json.loads((theirs / f"{label}.json").read_text())
        arrays = np.load(theirs / f"{label}.npz")
        assert len(grids) == len(record["grids"]) == len(arrays)
        for grid, found in zip(grids, record["grids"], strict=True):
            facts, values = describe(grid)
            assert found == facts, label
            np.testing.assert_array_equal(arrays[grid.name], values, err_msg=label)
            assert arrays[grid.name].dtype == values.dtype
        again = theirs / f"{label}.vdb"
        requests = [GridRequest(grid.name) for grid in grids]
        assert (
            hash_fields(read_grids(again, requests, GridsConfig()))
            == (record["metadata"][CONTENT_KEY])
        ), label
        assert (
            hash_vdb_file(ours / f"{label}.vdb", GridsConfig()) == record["metadata"][CONTENT_KEY]
        )
    _check_half(theirs)


def _check_half(theirs: Path) -> None:
    """What OpenVDB 12 finds in 16-bit files is within half a step of the numbers before."""
    for code in (1, 3, 4, 5):
        exact = dense(theirs / f"float smoke.{code:04d}.vdb")
        for kind, settings in (("half", ()), ("options in half", ALL)):
            found = dense(theirs / f"{kind} smoke.{code:04d}.vdb")
            for name, values in expected(exact, settings).items():
                bound = np.maximum(np.abs(values) * 2.0**-11, 2.0**-25)
                assert (np.abs(found[name].astype(float) - values) <= bound).all(), (kind, name)
