"""What usdsmoke writes is what is on record: voxels, pictures, layers and figures.

The id of each test names what is compared: ``bits`` on a processor and with packages that the
record has hashes for, ``statistics`` otherwise.
"""

import copy
import shutil
from collections.abc import Iterator
from typing import Any

import pytest

from tests.baselines.record import differences, read_record, same_circumstances
from tests.baselines.runs import RUNS, make_results_in_processes

pytestmark = pytest.mark.slow

RECORD = read_record()
COMPARED = "bits" if same_circumstances(RECORD) else "statistics"
OTHER = "another seed"


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """What every run gives now."""
    folder = tmp_path_factory.mktemp("golden")
    yield make_results_in_processes(folder, RUNS)
    shutil.rmtree(folder)


@pytest.mark.parametrize(
    "name", [pytest.param(n, id=f"{n}-{COMPARED}") for n in RUNS if n != OTHER]
)
def test_a_run_gives_what_is_on_record(results: dict[str, Any], name: str) -> None:
    found = differences(RECORD, name, results[name])
    assert not found, f"compared by {COMPARED}:\n" + "\n".join(found)


def test_every_recorded_run_is_made() -> None:
    assert set(RECORD["results"]) == set(RUNS) - {OTHER}


@pytest.mark.parametrize(
    ("name", "way", "n_files"), [("plume", "window by window", 3), ("mask", "once more", 2)]
)
def test_windows_one_by_one_and_a_rerun_give_the_same_content(
    results: dict[str, Any], name: str, way: str, n_files: int
) -> None:
    whole = {
        stage: {file: measured["hash"] for file, measured in found["files"].items()}
        for stage, found in results[name]["stages"].items()
    }
    assert [len(files) for files in whole.values()] == [n_files]
    assert results[name][way] == whole


def test_another_seed_differs_in_its_bits_and_in_its_statistics(results: dict[str, Any]) -> None:
    (stage,), (golden,) = (list(results[name]["stages"].values()) for name in (OTHER, "slab"))
    assert stage["files"].keys() == golden["files"].keys()
    for file, found in stage["files"].items():
        assert found["hash"] != golden["files"][file]["hash"]
    told = differences(RECORD, "slab", {**results["slab"], **results[OTHER]}, exact=False)
    assert any("/emission/statistics" in text for text in told)


def test_smoke_that_is_somewhere_else_is_found(results: dict[str, Any]) -> None:
    """A fiftieth of the density of a ninth of the slab; processors differ by less."""
    changed = copy.deepcopy(results["slab"])
    (stage,) = changed["stages"].values()
    (file,) = stage["files"].values()
    blocks = file["grids"]["density"]["statistics"]["blocks"]
    blocks[blocks.index(max(blocks))] *= 0.98
    told = differences(RECORD, "slab", changed, exact=False)
    assert any("/density/statistics" in text for text in told)


@pytest.mark.parametrize("exact", [True, False])
def test_one_changed_value_of_a_layer_is_found(results: dict[str, Any], exact: bool) -> None:
    changed = copy.deepcopy(results["slab"])
    layer = changed["layers"]["look.usda"]
    attribute = layer["/shot/smoke.usdSmoke:extinctionPerDensity"]
    attribute["default"] *= 1.01
    told = differences(RECORD, "slab", changed, exact)
    assert any("extinctionPerDensity/default" in text for text in told)


def test_one_changed_bit_is_found(results: dict[str, Any]) -> None:
    changed = copy.deepcopy(results["slab"])
    (stage,) = changed["stages"].values()
    found = next(iter(stage["files"].values()))
    found["hash"] = found["hash"][::-1]
    told = differences(RECORD, "slab", changed, exact=True)
    assert any("the bits differ" in text for text in told)
