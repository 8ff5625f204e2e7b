"""What is killed in `benchmarks.kills`: a tiny shot, commands on it, and what may be seen of them.

The shot has three frames of 12 x 10 x 14 voxels in two windows that share one frame, the real core
with three iterations a step, and OpenVDB files.
"""

import json
import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.warm_processes import call_apart
from tests.fixtures.farm_fixtures import Outcome, outcome
from tests.fixtures.grids_fixtures import check_content, raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import Shot, make_shot
from tests.runs.test_end_to_end import ball

__all__ = [
    "OTHER_SEED",
    "SCENES",
    "Arguments",
    "Scene",
    "faults_in_sight",
    "is_complete",
    "make_tiny_shot",
    "stylize",
]

Arguments = list[str]

N_WINDOWS = 2
SETTINGS = (
    "features.layers=[oriented1, oriented2]",
    "optimize.iterations=3",
    "optimize.threads=1",
    "views.image_size=16",
    "views.pool=2",
    "windows.size=2",
    "windows.overlap=1",
)
OTHER_SEED = ("--seed", "1")  # of the result that is being replaced


def make_tiny_shot(folder: Path) -> Shot:
    """Stage, frames and style image below a folder; nothing is stylized."""

    def make() -> Shot:
        shot = make_shot(folder / "shot", n_frames=3)
        for code in range(1, 4):
            grid = raw_grid(ball(0.05 * code))
            write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", grid)
        return shot

    made: Shot = call_apart(make, scratch=folder)
    return made


def stylize(shot: Shot, output: Path, *more: str) -> Arguments:
    """The command line of a whole run, or of a part of it."""
    settings = [part for setting in SETTINGS for part in ("--set", setting)]
    return Shot(shot.folder, shot.stage, shot.style, output).arguments(*settings, *more)


def missing_windows(output: Path) -> list[int]:
    """The windows without a manifest."""
    done = {int(path.stem) for path in output.glob("vdb/*/windows/[0-9]*.json")}
    return sorted(set(range(N_WINDOWS)) - done)


def is_complete(output: Path) -> bool:
    """Whether the result that is wanted stands there, with nothing left to do."""
    records = [json.loads(path.read_text()) for path in output.glob("vdb/*/run.json")]
    other = int(OTHER_SEED[1])
    return any(
        record["complete"] and record["description"]["settings"]["optimize"]["seed"] != other
        for record in records
    )


@dataclass(frozen=True)
class Scene:
    """A kind of command that is killed.

    ``begins`` names the state that the output folder is in at first: "" nothing, "windows" all
    windows finished, "old" a result of another seed, "new" a result of the same settings.
    """

    name: str
    begins: str
    share: int  # of the kills, relative to the other scenes
    starts: Callable[[Shot, Path, random.Random], list[Arguments]]  # at once
    ends: Callable[[Shot, Path, random.Random], list[Arguments]]  # one after the other

    @property
    def keeps_result(self) -> bool:
        """Whether a result must be in sight all the time."""
        return self.begins in ("old", "new")


def _whole(shot: Shot, output: Path, rng: random.Random) -> list[Arguments]:
    return [stylize(shot, output)]


def _coarse_or_windows(shot: Shot, output: Path, rng: random.Random) -> list[Arguments]:
    """Two windows at once, at times the same one twice or a coarse step; then the assembly."""
    missing = missing_windows(output)
    if not missing:
        return [["assemble", str(output)]]
    if len(missing) == N_WINDOWS and rng.random() < 0.15:
        return [stylize(shot, output, "--coarse") for _ in range(2)]
    pair = missing if len(missing) == 2 else [missing[0], missing[0]]
    return [stylize(shot, output, "--window", str(window)) for window in pair]


def _assemble(shot: Shot, output: Path, rng: random.Random) -> list[Arguments]:
    return [["assemble", str(output)]]


def _replace(shot: Shot, output: Path, rng: random.Random) -> list[Arguments]:
    return [stylize(shot, output, "--force")]


def _replace_to_the_end(shot: Shot, output: Path, rng: random.Random) -> list[Arguments]:
    """Once more only if the new result is not there yet: it would be replaced like the old one."""
    return _assemble(shot, output, rng) if is_complete(output) else _replace(shot, output, rng)


def _redo(shot: Shot, output: Path, rng: random.Random) -> list[Arguments]:
    return [stylize(shot, output, "--frames", "2")]


def _to_the_end(shot: Shot, output: Path, rng: random.Random) -> list[Arguments]:
    """A whole run, or windows in any order and the assembly."""
    if is_complete(output):  # a whole run would refuse to replace the result
        return [["assemble", str(output)]]
    if rng.random() < 0.7:
        return [stylize(shot, output)]
    windows = rng.sample(range(N_WINDOWS), N_WINDOWS)
    steps = [stylize(shot, output, "--window", str(window)) for window in windows]
    return [*steps, ["assemble", str(output)]]


SCENES = (
    Scene("stylize", "", 8, _whole, _to_the_end),
    Scene("stylize --window, two at once", "", 8, _coarse_or_windows, _to_the_end),
    Scene("assemble", "windows", 1, _assemble, _to_the_end),
    Scene("stylize --force", "old", 4, _replace, _replace_to_the_end),
    Scene("stylize --frames", "new", 2, _redo, _redo),
)


def faults_in_sight(output: Path, allowed: list[Outcome], must_be_there: bool = False) -> list[str]:
    """What is wrong with what a user can see in an output folder, whoever is at work there.

    Every path that the look layer names must exist, every VDB file must hold what its own hash
    promises, and stage and layer must show one of the allowed results as a whole.

    Args:
        output: the folder; need not exist.
        allowed: content hashes and layer text of the results that may be there.
        must_be_there: whether one of them must be.
    """
    look, root = output / "look.usda", output / "shot_look.usda"
    if not look.is_file():
        found = ["there is a stage without its look layer"] if root.exists() else []
        return [*found, "the old result has gone"] if must_be_there else found
    names = sorted(set(re.findall(r"@([^@]+)@", look.read_text())))
    gone = [f"the layer names {name}, which is not there" for name in names
            if not (output / name).exists()]  # fmt: skip
    if gone:
        return gone
    try:
        if root.is_file():
            shown = outcome(root)
            return [] if shown in allowed else [_difference(shown, allowed)]
        for name in names:
            if name.endswith(".vdb"):
                check_content(output / name)
    except Exception as error:
        return [f"the result cannot be read: {type(error).__name__}: {error}"]
    return []


def _difference(shown: Outcome, allowed: list[Outcome]) -> str:
    if not allowed:
        return "there is a result, and none was finished"
    known = [hashes for hashes, _ in allowed]
    if shown[0] in known:
        return "the layer's text is another one"
    codes = [code for code, value in shown[0].items() if value not in [k.get(code) for k in known]]
    if not codes:
        return "some frames are the old result's, some the new one's"
    return f"the frames {codes} have another content"
