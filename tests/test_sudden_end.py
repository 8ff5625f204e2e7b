"""kill -9 and a full disk, in processes of their own: the old result or none, and it can go on."""

import random
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.grids_fixtures import check_content
from tests.pipeline_fixtures import FakeCore, Shot, make_shot, run, shown_files
from tests.usd_fixtures import file_hashes
from usdsmoke.grids.header import read_header

PROJECT = Path(__file__).resolve().parents[1]


def run_until(step: int, shot: Shot, *more: str) -> tuple[int, list[str]]:
    """The command, killed at a step; its exit code and, when it lives, the steps it took."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.run_to_be_killed", str(step), *shot.arguments(*more)],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=60,
    )
    return done.returncode, done.stderr.splitlines()[-1].split() if done.returncode == 0 else []


def contents(root_stage: Path) -> dict[float, object]:
    """The hash of what every timeCode shows, each checked against what the file really holds."""
    files = shown_files(root_stage)
    for file_path in files.values():
        check_content(file_path)
    return {
        code: read_header(file_path).metadata["usdsmoke:content_sha256"]
        for code, file_path in files.items()
    }


def copied(shot: Shot, name: str) -> Shot:
    """The whole folder once more."""
    folder = shutil.copytree(shot.folder, shot.folder.with_name(name))
    return Shot(folder, folder / "in/shot.usda", folder / "in/style.png", folder / "out")


@pytest.mark.usefixtures("core")
def test_a_killed_run_leaves_no_result_and_is_finished_by_the_same_command(tmp_path: Path) -> None:
    shot = make_shot(tmp_path / "shot")
    code, steps = run_until(0, copied(shot, "whole"))
    assert code == 0
    expected = contents(tmp_path / "whole/out/shot_look.usda")
    n_root = len(steps) - steps[::-1].index("replace")  # the last renaming completes the record
    for number, step in enumerate(sorted(random.Random(20).sample(range(1, n_root - 9), 2))):
        killed = copied(shot, f"killed{number}")
        assert run_until(step, killed)[0] == -9
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
    code, steps = run_until(0, copied(shot, "whole"), *options)
    assert code == 0
    new = contents(tmp_path / "whole/out/shot_look.usda")
    assert new != old
    late = range(len(steps) - 12, len(steps))  # around the look's renaming and the tidying up
    chosen = [*random.Random(20).sample(range(1, late[0]), 2), *random.Random(20).sample(late, 3)]
    seen = []
    for number, step in enumerate(chosen):
        killed = copied(shot, f"killed{number}")
        assert run_until(step, killed, *options)[0] == -9
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
        [sys.executable, "-m", "tests.run_to_be_killed", "0", *shot.arguments()],
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
