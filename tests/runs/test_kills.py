"""Kill -9 at random moments: a short version of `benchmarks.kills`, and what it would notice."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.kill_scenes import faults_in_sight
from tests.fixtures.farm_fixtures import Outcome, outcome
from tests.fixtures.pipeline_fixtures import PROJECT, FakeCore, Shot, copied, run
from usdsmoke.pipeline import StylizeResult


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="forks, process groups and a subreaper")
def test_after_kills_at_random_moments_the_next_run_ends_in_the_same_bits() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.kills", "--kills", "2", "--seed", "7", "--warm"],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    kills = done.stdout.splitlines()[:2]
    assert [line.endswith(": same bits") for line in kills] == [True] * 2
    assert "**0 of 2 went wrong.**" in done.stdout


@pytest.fixture
def result(shot: Shot, core: FakeCore) -> StylizeResult:
    return run(shot)


@pytest.fixture
def shown(result: StylizeResult) -> Outcome:
    return outcome(result.root_stage)


def test_a_result_in_sight_is_sound_only_if_it_is_one_of_those_allowed(
    shot: Shot, result: StylizeResult, shown: Outcome
) -> None:
    other = copied(shot, f"{shot.folder.name}-other")
    new = outcome(run(other, "optimize.seed=1", force=True).root_stage)
    assert faults_in_sight(shot.output, [shown]) == []
    assert faults_in_sight(other.output, [shown, new]) == []
    assert "another content" in faults_in_sight(shot.output, [new])[0]
    mixed = ({**new[0], 1.0: shown[0][1.0]}, new[1])
    assert faults_in_sight(shot.output, [new, mixed]) != []
    text_only = (shown[0], new[1])
    assert faults_in_sight(shot.output, [text_only]) == ["the layer's text is another one"]


def test_half_a_file_and_a_vanished_one_are_faults(
    shot: Shot, result: StylizeResult, shown: Outcome
) -> None:
    frame = result.frames[1]
    whole = frame.read_bytes()
    frame.write_bytes(whole[: len(whole) // 2])
    assert "cannot be read" in faults_in_sight(shot.output, [shown])[0]
    frame.unlink()
    assert f"{frame.name}, which is not there" in faults_in_sight(shot.output, [shown])[0]
    result.look_layer.unlink()
    assert faults_in_sight(shot.output, [shown]) == ["there is a stage without its look layer"]


def test_no_result_is_a_fault_only_where_one_has_to_stay(tmp_path: Path) -> None:
    assert faults_in_sight(tmp_path, []) == []
    assert faults_in_sight(tmp_path, [], must_be_there=True) == ["the old result has gone"]
