"""``python -m benchmarks.fuzz``: damaged inputs by the thousand, and what became of them.

    python -m benchmarks.fuzz [--cases 100000] [--seed 0] [--jobs 2] [--minutes M]
    python -m benchmarks.fuzz --case 4711 --keep FOLDER     # one again, with its files and output

A sound stage, VDB file, style, settings file, network, unfinished run or result is damaged in
bytes, words or values, and one command reads it in a fork of a warm process. It must end by itself
with exit code 0, 1 or 2, name what is wrong, leave its inputs as they are and nothing behind. Most
commands read and plan; a share of ``--runs`` stylizes or draws. Linux only; about 0.07 CPU seconds
a case that reads and 1.5 for one that stylizes.
"""

import argparse
import gc
import importlib
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.circumstances import circumstances
from benchmarks.fuzz.case import Case, Outcome, faults, run_case
from benchmarks.fuzz.forked_worker import fork_workers
from benchmarks.fuzz.seeds import KINDS, make_seeds
from benchmarks.warm_processes import call_apart

CHUNK = 500  # cases between two reports
_LOADED = (
    "encodings.ascii", "prov.model", "prov.serializers.provjson",
    "prov.serializers.provjsonld", "prov.serializers.provn", "pxr.UsdValidation",
    "pydantic.dataclasses",
    "usdsmoke.audit.prov", "usdsmoke.audit.verification", "usdsmoke.farm.openjd",
    "usdsmoke.farm.processes", "usdsmoke.pipeline", "usdsmoke.ui.cli.main", "usdsmoke.usd.crates",
    "usdsmoke.usd.gate", "usdsmoke.usd.inspect", "usdsmoke.usd.rules.validation",
    "usdsmoke.usd.source_stage",
)  # fmt: skip


@dataclass
class Tally:
    """What became of many cases."""

    exits: Counter[tuple[str, str]] = field(default_factory=Counter)  # by kind and exit code
    errors: Counter[tuple[str, str]] = field(default_factory=Counter)  # by kind and error type
    slowest: tuple[float, int] = (0.0, 0)  # CPU seconds, case
    largest: tuple[float, int] = (0.0, 0)  # MiB, case
    faults: dict[int, list[str]] = field(default_factory=dict)  # by case

    def add(self, case: Case, outcome: Outcome) -> None:
        """Count one case."""
        self.exits[case.kind, str(outcome.exit_code)] += 1
        if outcome.error:
            self.errors[case.kind, outcome.error] += 1
        self.slowest = max(self.slowest, (outcome.cpu_seconds, case.number))
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
    parser.add_argument("--runs", type=float, default=0.005, help="share that stylizes or draws")
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
            case = Case.drawn(options.seed, options.case, options.runs)
            return _one(case, seeds, options.keep or Path(name))
        tally, text, start = Tally(), "", time.monotonic()
        numbers = range(options.first, options.first + options.cases)
        cases = [Case.drawn(options.seed, number, options.runs) for number in numbers]
        for part in _parts(cases, options.jobs, seeds):
            tally.merge(part)
            seconds = time.monotonic() - start
            text = _report(tally, seconds)
            if options.report:
                options.report.write_text(text, encoding="utf-8")
            n_cases = sum(tally.exits.values())
            print(f"{n_cases} cases, {seconds:.0f} s, faults: {len(tally.faults)}", file=sys.stderr)
            if options.minutes and seconds > 60 * options.minutes:
                break
    print(text)
    return 1 if tally.faults else 0


def _one(case: Case, seeds: Path, folder: Path) -> int:
    _warm_up(case.with_torch)
    outcome = run_case(case, seeds, folder / f"case{case.number}")
    print(case.kind, *outcome.command, f"[{outcome.damaged}]", f"exit {outcome.exit_code}")
    print(outcome.output)
    print("\n".join(faults(outcome)))
    return 1 if faults(outcome) else 0


def _parts(cases: Sequence[Case], jobs: int, seeds: Path) -> Iterator[Tally]:
    """Tallies of chunks of cases, as they come.

    They run in forks of processes that have imported everything; of those without torch where the
    command needs none, as a fork of a process with torch takes thrice as long.
    """
    with (
        ProcessPoolExecutor(jobs, initializer=_warm_up, initargs=(False,)) as light,
        ProcessPoolExecutor(jobs, initializer=_warm_up, initargs=(True,)) as heavy,
    ):
        for k in range(0, len(cases), CHUNK):
            tally = Tally()
            for pool, with_torch in ((light, False), (heavy, True)):
                chunk = [case for case in cases[k : k + CHUNK] if case.with_torch == with_torch]
                shares = [chunk[n::jobs] for n in range(jobs)]
                for part in pool.map(_run_cases, shares, [seeds] * jobs):
                    tally.merge(part)
            yield tally


def _run_cases(cases: Sequence[Case], seeds: Path) -> Tally:
    tally = Tally()
    with tempfile.TemporaryDirectory(prefix="usdsmoke_fuzz_") as name:
        for case in cases:
            folder = Path(name) / f"case{case.number}"
            tally.add(case, run_case(case, seeds, folder))
            shutil.rmtree(folder, ignore_errors=True)
            shutil.rmtree(folder.with_name(folder.name + ".tmp"), ignore_errors=True)
    return tally


def _warm_up(with_torch: bool) -> None:
    """Import what a command needs. Nothing is computed: threads would not survive a fork."""
    import pxr.Work
    from PIL import Image
    from pxr import Usd

    from usdsmoke.ui.cli.arguments import build_parser
    from usdsmoke.vdb.binding import find_binding

    pxr.Work.SetConcurrencyLimit(1)  # USD starts no threads either
    for name in _LOADED:
        importlib.import_module(name)
    Usd.Stage.CreateInMemory()  # plug-ins and schemas
    Image.init()
    build_parser()
    find_binding()
    fork_workers()
    if with_torch:
        import torch

        torch.set_num_threads(1)
    gc.collect()
    gc.freeze()  # a collection in a fork would copy every page


def _report(tally: Tally, seconds: float) -> str:
    lines = ["# Damaged inputs", "", *circumstances([Path(sys.executable).name, *sys.argv]), ""]
    lines += [
        f"{sum(tally.exits.values())} cases in {seconds:.0f} s. Slowest {tally.slowest[0]:.1f} CPU "
        f"seconds (case {tally.slowest[1]}), largest process {tally.largest[0]:.0f} MiB (case "
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
