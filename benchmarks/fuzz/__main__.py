"""``python -m benchmarks.fuzz``: damaged inputs by the thousand, and what became of them.

    python -m benchmarks.fuzz [--cases 100000] [--seed 0] [--jobs 2] [--minutes M]
    python -m benchmarks.fuzz --case 4711 --keep FOLDER     # one again, with its files and output

A sound stage, VDB file, style, settings file, network, unfinished run or result is damaged in
bytes, words or values, and one command reads it in a fork of a warm process. It must end by itself
with exit code 0, 1 or 2, name what is wrong, leave its inputs as they are and nothing behind.
Linux only; about 0.4 CPU seconds a case.
"""

import argparse
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.circumstances import circumstances
from benchmarks.fuzz.case import Case, Outcome, faults, run_case
from benchmarks.fuzz.seeds import KINDS, make_seeds
from benchmarks.warm_processes import call_apart

CHUNK = 50  # cases that a process is given at a time


@dataclass
class Tally:
    """What became of many cases."""

    exits: Counter[tuple[str, str]] = field(default_factory=Counter)  # by kind and exit code
    errors: Counter[tuple[str, str]] = field(default_factory=Counter)  # by kind and error type
    slowest: tuple[float, int] = (0.0, 0)  # seconds, case
    largest: tuple[float, int] = (0.0, 0)  # MiB, case
    faults: dict[int, list[str]] = field(default_factory=dict)  # by case

    def add(self, case: Case, outcome: Outcome) -> None:
        """Count one case."""
        self.exits[case.kind, str(outcome.exit_code)] += 1
        if outcome.error:
            self.errors[case.kind, outcome.error] += 1
        self.slowest = max(self.slowest, (outcome.seconds, case.number))
        self.largest = max(self.largest, (outcome.memory_mib, case.number))
        if found := faults(outcome):
            name = f"{case.kind}: {' '.join(outcome.command)}, {outcome.damaged}"
            self.faults[case.number] = [name, *found]

    def merge(self, other: "Tally") -> None:
        """Add another tally's cases."""
        self.exits += other.exits
        self.errors += other.errors
        self.slowest = max(self.slowest, other.slowest)
        self.largest = max(self.largest, other.largest)
        self.faults |= other.faults


def main() -> int:
    """Read the command line and run; 1 if a fault was found."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.fuzz", description=(__doc__ or "").split("\n\n")[0]
    )
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--minutes", type=float, help="stop after this time")
    parser.add_argument("--report", type=Path, metavar="FILE.md")
    parser.add_argument("--case", type=int, metavar="N", help="this case alone")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="for the files of --case")
    options = parser.parse_args()
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    with tempfile.TemporaryDirectory(prefix="usdsmoke_fuzz_") as name:
        seeds = Path(name) / "seeds"
        call_apart(make_seeds, seeds, scratch=Path(name))  # this process stays free of threads
        if options.case is not None:
            return _one(Case.drawn(options.seed, options.case), seeds, options.keep or Path(name))
        tally, n_cases, start = Tally(), 0, time.monotonic()
        numbers = range(options.first, options.first + options.cases)
        for part in _parts(numbers, options.seed, options.jobs, seeds):
            tally.merge(part)
            n_cases = sum(tally.exits.values())
            _show(tally, n_cases, time.monotonic() - start)
            if options.minutes and time.monotonic() - start > 60 * options.minutes:
                break
    text = _report(tally, n_cases, time.monotonic() - start)
    if options.report:
        options.report.write_text(text, encoding="utf-8")
    print(text)
    return 1 if tally.faults else 0


def _one(case: Case, seeds: Path, folder: Path) -> int:
    _warm_up()
    outcome = run_case(case, seeds, folder / f"case{case.number}")
    print(case.kind, *outcome.command, f"[{outcome.damaged}]", f"exit {outcome.exit_code}")
    print(outcome.output)
    print("\n".join(faults(outcome)))
    return 1 if faults(outcome) else 0


def _parts(numbers: range, seed: int, jobs: int, seeds: Path) -> Iterator[Tally]:
    """Tallies of chunks of cases, as they come, in processes that have imported everything."""
    chunks = [numbers[k : k + CHUNK] for k in range(0, len(numbers), CHUNK)]
    with ProcessPoolExecutor(jobs, initializer=_warm_up, max_tasks_per_child=None) as pool:
        try:
            yield from pool.map(_chunk, chunks, [seed] * len(chunks), [seeds] * len(chunks))
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _chunk(numbers: range, seed: int, seeds: Path) -> Tally:
    tally = Tally()
    with tempfile.TemporaryDirectory(prefix="usdsmoke_fuzz_") as name:
        for number in numbers:
            case = Case.drawn(seed, number)
            folder = Path(name) / f"case{number}"
            tally.add(case, run_case(case, seeds, folder))
            shutil.rmtree(folder, ignore_errors=True)
            shutil.rmtree(folder.with_name(folder.name + ".tmp"), ignore_errors=True)
    return tally


def _warm_up() -> None:
    """Import what a command needs. Nothing is computed: threads would not survive a fork."""
    import torch

    import usdsmoke.core.sequence.stylize
    import usdsmoke.core.views.march
    import usdsmoke.pipeline
    import usdsmoke.ui.cli.main  # noqa: F401

    torch.set_num_threads(1)


def _show(tally: Tally, n_cases: int, seconds: float) -> None:
    print(f"{n_cases} cases, {seconds:.0f} s, {len(tally.faults)} with faults", file=sys.stderr)


def _report(tally: Tally, n_cases: int, seconds: float) -> str:
    lines = ["# Damaged inputs", "", *circumstances([Path(sys.executable).name, *sys.argv]), ""]
    lines += [
        f"{n_cases} cases in {seconds:.0f} s. Slowest {tally.slowest[0]:.1f} s (case "
        f"{tally.slowest[1]}), largest process {tally.largest[0]:.0f} MiB (case "
        f"{tally.largest[1]}), cases with a fault: {len(tally.faults)}.",
        "",
        "| damaged | exit 0 | exit 1 | exit 2 | other | errors named |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for kind in KINDS:
        exits = {code: n for (name, code), n in tally.exits.items() if name == kind}
        known = [exits.pop(code, 0) for code in ("0", "1", "2")]
        errors = Counter({name: n for (of, name), n in tally.errors.items() if of == kind})
        named = ", ".join(f"{name} {n}" for name, n in errors.most_common())
        cells = [kind, *map(str, known), str(sum(exits.values())), named]
        lines.append(f"| {' | '.join(cells)} |")
    for number, found in sorted(tally.faults.items()):
        lines += ["", f"Case {number}: {'; '.join(found)}."]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
