"""kill -9 and a full disk, in processes of their own: the old result or none, and it can go on."""

import random
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fixtures.pipeline_fixtures import (
    PROJECT,
    FakeCore,
    Shot,
    contents,
    copied,
    make_shot,
    run,
    run_until,
)
from tests.fixtures.usd_fixtures import file_hashes


@pytest.mark.usefixtures("core")
def test_a_killed_run_leaves_no_result_and_is_finished_by_the_same_command(tmp_path: Path) -> None:
    shot = make_shot(tmp_path / "shot")
    code, steps = run_until(0, *copied(shot, "whole").arguments())
    assert code == 0
    expected = contents(tmp_path / "whole/out/shot_look.usda")
    n_root = len(steps) - steps[::-1].index("replace")  # the last renaming completes the record
    for number, step in enumerate(sorted(random.Random(20).sample(range(1, n_root - 9), 2))):
        killed = copied(shot, f"killed{number}")
        assert run_until(step, *killed.arguments())[0] == -9
        assert not (killed.output / "shot_look.usda").exists(), step
        assert contents(run(killed).root_stage) == expected
        assert not [path for path in killed.output.rglob(".*") if path.is_file()]
        assert file_hashes(killed.stage.parent) == file_hashes(shot.stage.parent)


@pytest.mark.usefixtures("core")
def test_killed_while_replacing_the_stage_shows_the_old_result_or_the_new_one(
    tmp_path: Path,
) -> None:
    shot = make_shot(tmp_path / "shot")
    old = contents(run(shot).root_stage)
    options = ("--force", "--seed", "1")
    code, steps = run_until(0, *copied(shot, "whole").arguments(*options))
    assert code == 0
    new = contents(tmp_path / "whole/out/shot_look.usda")
    assert new != old
    late = range(len(steps) - 12, len(steps))  # around the look's renaming and the tidying up
    chosen = [*random.Random(20).sample(range(1, late[0]), 2), *random.Random(20).sample(late, 3)]
    seen = []
    for number, step in enumerate(chosen):
        killed = copied(shot, f"killed{number}")
        assert run_until(step, *killed.arguments(*options))[0] == -9
        seen.append(contents(killed.output / "shot_look.usda"))
        assert contents(run(killed, "optimize.seed=1", force=True).root_stage) == new
        assert len(list(killed.output.glob("vdb/*"))) == 1
        assert not [path for path in killed.output.rglob(".*") if path.is_file()]
    assert all(shown in (old, new) for shown in seen)
    assert old in seen and new in seen


def test_a_limit_on_file_sizes_is_told_and_leaves_nothing(shot: Shot, core: FakeCore) -> None:
    """The system's own refusal, by a limit that is too small for any VDB file."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1500, 1500))

    done = subprocess.run(
        [sys.executable, "-m", "tests.fixtures.run_to_be_killed", "0", *shot.arguments()],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=60,
        preexec_fn=limit,
        env={"PATH": "/usr/bin:/bin", "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert done.returncode == 1, done.stderr
    assert "usdsmoke: cannot write" in done.stderr
    assert "Traceback" not in done.stderr
    assert not shot.output.exists()
    assert len(run(shot).frames) == 3
