"""``python -m tests.baselines``: make the golden runs, and compare or record them."""

import argparse
import json
import shutil
import sys
import tempfile
from pathlib import Path

from tests.baselines.record import (
    GOLDEN,
    differences,
    read_record,
    same_circumstances,
    write_record,
)
from tests.baselines.runs import RUNS, make_results, make_results_in_processes

__all__ = ["main"]


def main() -> int:
    """Read the command line and do what it says; 1 if results differ from the record."""
    parser = argparse.ArgumentParser(prog="python -m tests.baselines", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(RUNS), help="some runs alone")
    task = parser.add_mutually_exclusive_group()
    task.add_argument(
        "--write", nargs="?", const=GOLDEN, type=Path, metavar="FILE", help="replace the record"
    )
    task.add_argument("--against", type=Path, default=GOLDEN, metavar="FILE", help="another record")
    task.add_argument("--results", type=Path, metavar="FOLDER", help=argparse.SUPPRESS)
    parser.add_argument("--inputs", type=Path, metavar="FOLDER", help=argparse.SUPPRESS)
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="leave everything made here")
    options = parser.parse_args()
    if options.results:  # one of the processes that the runs are shared among
        results = make_results(options.results, options.only, options.inputs)
        (options.results / "results.json").write_text(json.dumps(results))
        return 0
    if options.write and options.only:
        parser.error("--write records all runs; leave out --only")
    folder = options.keep or Path(tempfile.mkdtemp(prefix="usdsmoke_golden_"))
    names = options.only or [name for name in RUNS if name != "another seed"]
    try:
        results = make_results_in_processes(folder, names)
    finally:
        if not options.keep:
            shutil.rmtree(folder, ignore_errors=True)
    if options.write:
        print(write_record(options.write, results))
        return 0
    record = read_record(options.against)
    exact = same_circumstances(record)
    found = [
        f"{name}: {text}" for name in names for text in differences(record, name, results[name])
    ]
    compared = "bit by bit" if exact else "by statistics (other processor or packages)"
    print("\n".join([*found, f"{len(names)} runs compared {compared}: {len(found)} differences"]))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
