"""Runs that are killed at random moments, and what the next run makes of what they leave.

    python -m benchmarks.kills [COUNT] [SEED]

Each time a shot of seven frames in three windows is stylized by stand-ins for the core and for
OpenVDB's process, whole, window by window or as an assembly, and killed with SIGKILL: in the place
of a random step that changes the disk, or after a random time. The same command is then run again,
and what comes of it must be what an undisturbed run gives: the same content hash for every
timeCode, and the same layer but for clock times and the run's id. Exits with 1 at the first that
does not.
"""

import io
import json
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from tests.farm_fixtures import OPTIONS, Outcome, outcome
from tests.pipeline_fixtures import PROJECT, FakeCore, Shot, copied, make_shot, pose, run_until
from usdsmoke.cli import main as usdsmoke

__all__ = ["main"]

_WAYS = ("whole", "coarse", "window", "assemble", "frames", "replace")


def main(count: int = 200, seed: int = 0) -> int:
    """Kill ``count`` runs; 0 when all of them ended well."""
    pose(FakeCore())
    chance, seen, started = random.Random(seed), Counter[str](), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        shot = make_shot(Path(folder) / "shot", n_frames=7)
        expected = _finish(copied(shot, "whole"), "whole")
        ready = {way: _prepare(shot, way) for way in _WAYS}
        n_steps = {way: _count_steps(ready[way], way) for way in _WAYS}
        for number in range(count):
            way = _WAYS[number % len(_WAYS)]
            killed = copied(ready[way], "killed")
            moment = _kill(killed, way, chance, n_steps[way])
            wrong = _what_differs(_finish(killed, way), expected, killed)
            if wrong:
                print(f"run {number} ({way}, killed at {moment}) ended otherwise: {wrong}")
                return 1
            seen[f"{way} {moment.split()[0]}"] += 1
            shutil.rmtree(killed.folder)
    for kind, n in sorted(seen.items()):
        print(f"{kind:<18} {n:>4}")
    print(f"{count} runs killed, seed {seed}: all ended in the same bits")
    print(f"{time.monotonic() - started:.0f} s")
    return 0


def _command(shot: Shot, way: str) -> list[str]:
    """What is killed."""
    more = {"coarse": ["--coarse"], "window": ["--window", "1"], "frames": ["--frames", "5"]}
    if way == "assemble":
        return ["assemble", str(shot.output)]
    return shot.arguments(*OPTIONS, *more.get(way, []), *(["--force"] if way == "replace" else []))


def _prepare(shot: Shot, way: str) -> Shot:
    """The shot with what must be there before a command of this way."""
    ready = copied(shot, f"ready_{way}")
    if way == "assemble":
        for window in range(3):
            _call(ready.arguments(*OPTIONS, "--window", str(window)))
    if way == "frames":
        _call(ready.arguments(*OPTIONS))
    if way == "replace":
        _call(ready.arguments(*OPTIONS, "--seed", "1"))
    return ready


def _count_steps(ready: Shot, way: str) -> int:
    alive = copied(ready, "alive")
    code, steps = run_until(0, *_command(alive, way))
    shutil.rmtree(alive.folder)
    assert code == 0
    return len(steps)


def _kill(shot: Shot, way: str, chance: random.Random, n_steps: int) -> str:
    """Run a command and kill it; when."""
    if chance.random() < 0.7:
        step = chance.randrange(1, n_steps + 1)
        run_until(step, *_command(shot, way))
        return f"step {step}"
    seconds = chance.uniform(0.2, 1.2)
    command = [sys.executable, "-m", "tests.run_to_be_killed", "0", *_command(shot, way)]
    process = subprocess.Popen(
        command, cwd=PROJECT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    time.sleep(seconds)
    process.kill()
    process.wait()
    return f"time {seconds:.3f}"


def _finish(shot: Shot, way: str) -> Outcome:
    """Go on until there is the result that was asked for, as a user would."""
    root_stage = shot.output / "shot_look.usda"
    if way == "frames":
        _call(_command(shot, way))
    elif not _is_complete(shot):
        _call(shot.arguments(*OPTIONS, *(["--force"] if way == "replace" else [])))
    return outcome(root_stage)


def _is_complete(shot: Shot) -> bool:
    """Whether there is one run, with nothing left to do, and not the one to be replaced."""
    records = [json.loads(path.read_text()) for path in shot.output.glob("vdb/*/run.json")]
    seeds = [record["description"]["settings"]["optimize"]["seed"] for record in records]
    return seeds == [0] and records[0]["complete"]


def _what_differs(found: Outcome, expected: Outcome, shot: Shot) -> str:
    """In words; "" when nothing does."""
    if found[0] != expected[0]:
        codes = [code for code in expected[0] if found[0].get(code) != expected[0][code]]
        return f"content hashes of timeCodes {codes}"
    if found[1] != expected[1]:
        lines = zip(found[1].splitlines(), expected[1].splitlines(), strict=False)
        return "the layer: " + "; ".join(f"{one} / {other}" for one, other in lines if one != other)
    return ", ".join(str(path) for path in _leftovers(shot))


def _leftovers(shot: Shot) -> list[Path]:
    return [path for path in shot.output.rglob(".*") if path.is_file()]


def _call(arguments: list[str]) -> None:
    told = io.StringIO()
    with redirect_stdout(told), redirect_stderr(told):
        code = usdsmoke(arguments)
    if code:
        raise RuntimeError(f"usdsmoke {' '.join(arguments)} ended with {code}: {told.getvalue()}")


if __name__ == "__main__":
    sys.exit(main(*(int(text) for text in sys.argv[1:])))
