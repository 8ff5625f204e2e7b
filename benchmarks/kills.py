"""Kill -9 at random moments: the next run ends in the same bits, and no half result is ever seen.

    python -m benchmarks.kills [--kills 200] [--seed 0] [--report benchmarks/results/kills.md]

Commands on a tiny shot (`benchmarks/kill_scenes.py`) are killed with all the processes that they
have started. Half of the moments are drawn evenly over the time that the command still needs, half
at the coming of a file, which is up to 30 ms after one has begun to be written. A process of
usdsmoke is a fork of one that has imported everything (`benchmarks/warm_processes.py`); one in
twelve, and the reference, is a new interpreter in which nothing is replaced.

After a kill nobody tidies up. What can be seen is checked; a copy of the folder is brought to its
end and compared with the reference; and the next command goes on in the folder itself, to be killed
again, up to three times. Linux only; four seconds a kill.
"""

import argparse
import itertools
import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.kill_report import Kill, Length, report
from benchmarks.kill_scenes import (
    OTHER_SEED,
    SCENES,
    Arguments,
    Scene,
    faults_in_sight,
    is_complete,
    make_tiny_shot,
    stylize,
)
from benchmarks.warm_processes import (
    Process,
    Watch,
    call_apart,
    command_line,
    usdsmoke_apart,
    warm_up,
)
from tests.fixtures.farm_fixtures import Outcome, outcome
from tests.fixtures.pipeline_fixtures import Shot

__all__ = ["Bench", "all_kills", "main"]

AGAIN = 3  # kills in one folder, at most
COLD = 1 / 12
AT_FILES = 0.5  # share of moments drawn at the coming of a file
AFTER_FILE_S = 0.03
PATIENCE_S = 120.0  # a run that takes longer is stuck
POLL_S = 0.002


@dataclass
class Bench:
    """The shot, the states that commands begin in, and the result that they must end in."""

    folder: Path
    shot: Shot
    cold: float = COLD  # share of processes that are new interpreters; 0 for the reference too
    keep: Path | None = None  # gets folders in which something was wrong
    new: Outcome = ({}, "")
    old: Outcome = ({}, "")
    warm: Length = field(
        default_factory=lambda: Length(0.0, 0)
    )  # of an uninterrupted run, as a fork
    import_s: float = 0.0  # that a new interpreter takes longer
    lengths: dict[str, Length] = field(default_factory=dict)  # by scene: see length_of

    def prepare(self) -> None:
        """Make the reference in a new interpreter, and another seed's result by a fork."""
        whole, old = self._folder_of("new"), self._folder_of("old")
        cold = self.run([stylize(self.shot, whole)], whole, apart=self.cold > 0)
        self.warm = self.run([stylize(self.shot, old, *OTHER_SEED)], old)
        self.import_s = max(cold.seconds - self.warm.seconds, 0.0)
        self.new, self.old = (
            call_apart(outcome, output / "shot_look.usda", scratch=self.folder)
            for output in (whole, old)
        )
        if set(self.old[0].values()) & set(self.new[0].values()):
            raise RuntimeError("another seed gave the same frames: the comparison is blind")

    def state(self, name: str) -> Path:
        """The output folder that a scene begins in, to be copied; made when it is first wanted."""
        folder = self._folder_of(name)
        if not folder.exists():
            windows = [stylize(self.shot, folder, "--window", number) for number in "01"]
            self.run(windows, folder)
        return folder

    def length_of(self, scene: Scene) -> Length:
        """What a scene takes from its first state, left alone."""
        if scene.begins in ("", "old"):
            return self.warm
        if scene.name not in self.lengths:
            output = self.shot.folder / "measured"
            shutil.copytree(self.state(scene.begins), output)
            commands = scene.ends(self.shot, output, random.Random(0))
            self.lengths[scene.name] = self.run(commands, output)
            shutil.rmtree(output)
        return self.lengths[scene.name]

    def _folder_of(self, state: str) -> Path:
        return self.shot.folder / f"state-{state}"

    def start(self, arguments: Arguments, apart: bool = False) -> Process:
        """Begin a command."""
        action = usdsmoke_apart(arguments) if apart else command_line(arguments)
        name = f"log-{time.monotonic_ns()}"
        return Process(action, self.folder / name)

    def run(self, commands: Sequence[Arguments], output: Path, apart: bool = False) -> Length:
        """Commands one after the other, left alone.

        Raises:
            RuntimeError: one fails or is stuck; with what it printed.
        """
        watch, began = Watch(output), time.monotonic()
        for arguments in commands:
            process, limit = self.start(arguments, apart), time.monotonic() + PATIENCE_S
            while process.poll() is None:
                watch.look()
                time.sleep(POLL_S)
                if time.monotonic() > limit:
                    process.kill()
            if process.code != 0:
                log = process.log.read_text(errors="replace")[-2000:]
                raise RuntimeError(f"{arguments[0]} ended with code {process.code}: {log}")
            process.log.unlink()
        return Length(time.monotonic() - began, watch.count)

    def faults(self, output: Path, allowed: list[Outcome], must_be_there: bool) -> list[str]:
        """See ``faults_in_sight``."""
        found: list[str] = call_apart(
            faults_in_sight, output, allowed, must_be_there, scratch=self.folder
        )
        return found


def kill_once(
    bench: Bench, scene: Scene, output: Path, length: Length, rng: random.Random
) -> Kill | None:
    """Begin a scene's commands and kill them, at times only one; None if they were quicker.

    Raises:
        RuntimeError: nothing was killed, and a command has failed.
    """
    commands = scene.starts(bench.shot, output, rng)
    is_cold, lonely = rng.random() < bench.cold, len(commands) > 1 and rng.random() < 0.3
    at_file, moment = rng.random() < AT_FILES, rng.random()
    after = rng.uniform(0.0, AFTER_FILE_S)
    longest = length.seconds + bench.import_s * is_cold
    watch, began = Watch(output), time.monotonic()
    processes = [bench.start(arguments, is_cold) for arguments in commands]
    while any(process.poll() is None for process in processes):
        if at_file:
            is_due = watch.look() > moment * length.n_files
        else:
            is_due = time.monotonic() - began >= moment * longest
        if is_due:
            break
        time.sleep(POLL_S)
    if at_file:
        time.sleep(after)
    chosen = [rng.choice(processes)] if lonely else processes
    victims = [process for process in chosen if process.poll() is None]
    seconds = time.monotonic() - began
    for victim in victims:
        victim.kill()
    kill = None
    if victims:
        kill = Kill(scene.name, victims[0].step(), is_cold, seconds)
        kill.faults = bench.faults(output, _allowed(bench, scene), scene.keeps_result)
    failures = [_let_end(process) for process in processes if process not in victims]
    if kill is None and any(failures):
        raise RuntimeError("; ".join(failures))
    if kill is not None:
        kill.faults += [failure for failure in failures if failure]
        kill.n_half = sum(path.is_file() for path in output.rglob(".*"))
    return kill


def finish_copy(bench: Bench, scene: Scene, output: Path, kill: Kill, rng: random.Random) -> None:
    """Bring a copy of what a kill has left to its end, and compare; what is found goes to ``kill``.

    The copy stands beside the folder, as what is written there names the source by relative paths.
    """
    copy = output.with_name(f"{output.name}-copy")
    if output.exists():
        shutil.copytree(output, copy)
    try:
        kill.end = bench.run(scene.ends(bench.shot, copy, rng), copy)
        kill.faults += bench.faults(copy, [bench.new], must_be_there=True)
        if left := [path.name for path in (*copy.rglob(".*"), *copy.rglob("*.lock"))]:
            kill.faults.append(f"there is no use for what is left: {', '.join(left)}")
        if len(folders := list(copy.glob("vdb/*"))) != 1:
            kill.faults.append(f"{len(folders)} folders of runs are left")
    except RuntimeError as error:
        kill.faults.append(str(error))
    shutil.rmtree(copy, ignore_errors=True)


def kills_in_one_folder(bench: Bench, scene: Scene, rng: random.Random) -> Iterator[Kill]:
    """Kills until a command comes to its end, ``AGAIN`` at most."""
    output = bench.shot.folder / "out"
    shutil.rmtree(output, ignore_errors=True)
    if scene.begins:
        shutil.copytree(bench.state(scene.begins), output)
    length = bench.length_of(scene)
    for _ in range(rng.randint(1, AGAIN)):
        kill = kill_once(bench, scene, output, length, rng)
        if kill is None:
            if is_complete(output):
                break
            continue
        finish_copy(bench, scene, output, kill, rng)
        if kill.faults and bench.keep is not None:
            shutil.copytree(output, bench.keep / f"kill-{time.monotonic_ns()}")
        yield kill
        if is_complete(output) and scene.begins != "new":
            break  # killed when all was done
        length = kill.end


def all_kills(bench: Bench, n_kills: int, seed: int) -> Iterator[Kill]:
    """Kills of all scenes in a random order, which the seed decides like every draw."""
    folder, count = 0, 0
    while count < n_kills:
        rng = random.Random(f"{seed}/{folder}")
        (scene,) = rng.choices(SCENES, [scene.share for scene in SCENES])
        for kill in itertools.islice(kills_in_one_folder(bench, scene, rng), n_kills - count):
            count += 1
            yield kill
        folder += 1


def _allowed(bench: Bench, scene: Scene) -> list[Outcome]:
    """The results that may be in sight while a scene's command is at work."""
    return [bench.new, bench.old] if scene.begins == "old" else [bench.new]


def _let_end(process: Process) -> str:
    """Wait for a process that was not killed; what went wrong with it, "" for nothing."""
    limit = time.monotonic() + PATIENCE_S
    while process.poll() is None and time.monotonic() < limit:
        time.sleep(POLL_S)
    if process.code == 0:
        return ""
    process.kill()
    log = process.log.read_text(errors="replace")[-2000:]
    return f"a process that was not killed ended with code {process.code}: {log}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Kill, print what came of it; 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="benchmarks.kills", description=__doc__.split("\n")[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--report", type=Path, help="Markdown file to write")
    parser.add_argument("--keep", type=Path, help="folder for states in which something was wrong")
    parser.add_argument("--warm", action="store_true", help="start no new interpreter: quicker")
    parsed = parser.parse_args(arguments)
    os.environ["OMP_NUM_THREADS"] = "1"
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    warm_up()
    kills = []
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        tempfile.tempdir = os.environ["TMPDIR"] = name  # killed processes leave things there
        bench = Bench(Path(name), make_tiny_shot(Path(name)), COLD * (not parsed.warm), parsed.keep)
        bench.prepare()
        for kill in all_kills(bench, parsed.kills, parsed.seed):
            kills.append(kill)
            ending = "; ".join(kill.faults) or "same bits"
            print(f"{len(kills)} {kill.scene}: {kill.step} after {kill.seconds:.2f} s: {ending}")
            sys.stdout.flush()
    command = ["--kills", str(parsed.kills), "--seed", str(parsed.seed)]
    command += ["--warm"] if parsed.warm else []
    text = report(kills, bench.warm.seconds, command)
    print(text)
    if parsed.report is not None:
        parsed.report.write_text(text, encoding="utf-8")
    return int(any(kill.faults for kill in kills))


if __name__ == "__main__":
    sys.exit(main())
