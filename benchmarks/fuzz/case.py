"""One damaged input: made from a seed and a number, read by one command, judged."""

import hashlib
import json
import os
import re
import resource
import shutil
import signal
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.fuzz.seeds import KINDS, READ_NETWORK
from benchmarks.warm_processes import Process

__all__ = ["Case", "Outcome", "faults", "run_case"]

CPU_S = 120  # a command that takes longer does not end; the files are tiny
WALL_S = 1200.0  # one that takes longer waits for something; others may keep the processors busy
MEMORY_MIB = 3072  # of a process; torch alone has 500
_READ_ONLY = ("inspect", "validate", "provenance", "verify", READ_NETWORK)


@dataclass(frozen=True)
class Case:
    """What is damaged and what reads it; the same seed and number give the same case.

    Attributes:
        kind: a key of ``KINDS``.
        number: of the case.
        seed: of the study.
        command: what reads it, as arguments.
        with_torch: the command computes with torch.
    """

    kind: str
    number: int
    seed: int
    command: tuple[str, ...]
    with_torch: bool

    @classmethod
    def drawn(cls, seed: int, number: int, runs: float) -> "Case":
        """The case of a number: the kinds take turns.

        Args:
            seed: of the study.
            number: of the case.
            runs: share of cases whose command stylizes or draws, where the kind has such commands.
        """
        draw = np.random.default_rng([seed, number, 1])
        name = list(KINDS)[number % len(KINDS)]
        kind = KINDS[name]
        is_run = bool(kind.runs) and draw.random() < runs
        choices = kind.runs if is_run else kind.commands
        command = choices[int(draw.integers(len(choices)))]
        return cls(name, number, seed, command, is_run or command[0] == READ_NETWORK)


@dataclass(frozen=True)
class Outcome:
    """What a command did with a damaged input.

    Attributes:
        command: its arguments.
        damaged: the file, relative to the case's folder.
        exit_code: negative for a signal; None if it had to be stopped.
        error: the type of the error that it named; "" if it named none.
        output: stdout; stderr follows.
        cpu_seconds: of it and its children.
        memory_mib: of the largest process.
        changed: files that are new, gone or different afterwards.
        left: files that are left in the folder for temporary files.
    """

    command: tuple[str, ...]
    damaged: str
    exit_code: int | None
    error: str
    output: str
    cpu_seconds: float
    memory_mib: float
    changed: tuple[str, ...]
    left: tuple[str, ...]


def run_case(case: Case, seeds: Path, folder: Path) -> Outcome:
    """Damage a copy of a seed folder and run a command in it, in a fork of this process.

    Args:
        case: what to do.
        seeds: from ``make_seeds``.
        folder: made here; stays.
    """
    draw = np.random.default_rng([case.seed, case.number])
    kind = KINDS[case.kind]
    place = shutil.copytree(seeds / kind.folder, folder, symlinks=True)
    files = [item for item in sorted(place.glob(kind.pattern)) if item.is_file()]
    target = files[int(draw.integers(len(files)))]
    target.write_bytes(kind.damage(target.read_bytes(), draw))
    temporary = folder.with_name(folder.name + ".tmp")
    temporary.mkdir()
    before = _contents(place)
    log = folder.with_name(folder.name + ".log")
    process = _call_forked(case.command, place, temporary, log)
    after = _contents(place)
    output = log.read_text(errors="replace")
    return Outcome(
        case.command,
        str(target.relative_to(place)),
        process.code,
        _error_type(output),
        output,
        process.cpu_seconds,
        process.memory_mib,
        tuple(sorted(name for name, _ in before.items() ^ after.items())),
        tuple(sorted(str(item.relative_to(temporary)) for item in temporary.rglob("*"))),
    )


def faults(outcome: Outcome) -> list[str]:
    """What must not happen with any input and did, one sentence each."""
    found = []
    if outcome.exit_code is None:
        found.append(f"no end after {WALL_S:.0f} s")
    elif outcome.exit_code == -signal.SIGXCPU:
        found.append(f"no end after {CPU_S} CPU seconds")
    elif outcome.exit_code not in (0, 1, 2):
        found.append(f"exit code {outcome.exit_code}")
    for word in (r"unexpected [A-Z]\w+:", r"Traceback \(most", "report it"):
        if said := re.search(word, outcome.output):
            found.append(f"the output says {said[0]!r}")
    if outcome.exit_code == 1 and "{" not in outcome.output:
        found.append("no JSON value on stdout")
    if outcome.memory_mib > MEMORY_MIB:
        found.append(f"{outcome.memory_mib:.0f} MiB of memory")
    inputs = [name for name in outcome.changed if name.startswith("in/")]
    if inputs:
        found.append(f"inputs were changed: {', '.join(inputs)}")
    reads = outcome.command[0] in _READ_ONLY and "--mend" not in outcome.command
    reads = reads or "--dry-run" in outcome.command
    fails = outcome.exit_code != 0 and outcome.command[0] == "preview"
    if outcome.changed and not inputs and (reads or fails):
        found.append(f"files were changed: {', '.join(outcome.changed)}")
    if outcome.left:
        found.append(f"left behind: {', '.join(outcome.left[:3])}")
    return found


def _call_forked(command: Sequence[str], place: Path, temporary: Path, log: Path) -> Process:
    """A command that has ended, run in a fork within a folder; without a code if it was stopped.

    A fork need not import anything again. This process must have no other threads.
    """
    process = Process(lambda: _run_command(command, place, temporary), log)
    end = time.monotonic() + WALL_S
    while process.poll() is None:
        if time.monotonic() > end:
            process.kill()
            process.code = None
            return process
        time.sleep(0.002)
    return process


def _run_command(command: Sequence[str], place: Path, temporary: Path) -> int:
    """The command itself, in the fork; its exit code."""
    from usdsmoke.vdb.child import end_worker

    os.chdir(place)
    os.environ["TMPDIR"] = str(temporary)
    tempfile.tempdir = None
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 5))
    try:
        code = _read_network(command[1]) if command[0] == READ_NETWORK else _run_main(command)
    except SystemExit as stop:
        code = int(stop.code or 0)
    end_worker()
    return code


def _run_main(command: Sequence[str]) -> int:
    from usdsmoke.ui.cli.main import main

    return main([*command, "--json"])


def _read_network(file: str) -> int:
    """What a run does with a network's file before it stylizes."""
    from usdsmoke.base.errors import UsdSmokeError
    from usdsmoke.core.features.vgg19 import Vgg19Features

    try:
        Vgg19Features.from_file(file)
    except UsdSmokeError as error:
        print(json.dumps({"error": {"type": type(error).__name__, "message": str(error)}}))
        return 1
    return 0


def _contents(folder: Path) -> dict[str, str]:
    return {
        str(item.relative_to(folder)): hashlib.sha256(item.read_bytes()).hexdigest()
        for item in folder.rglob("*")
        if item.is_file() and not item.is_symlink()
    }


def _error_type(output: str) -> str:
    """The type in the one JSON value that stdout holds after an error."""
    for line in output.splitlines():
        if line.startswith('{"error"'):
            return str(json.loads(line)["error"]["type"])
    begin = output.find('"error": {')
    if begin < 0:
        return ""
    return str(output[begin:].split('"type": "')[-1].split('"')[0])
