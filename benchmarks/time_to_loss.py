"""How long this checkout takes to the unseen loss that another one ends with.

    python -m benchmarks.time_to_loss STAGE STYLE --tree OTHER [--frames 1-9] [--report FILE.md]

Runs the other checkout with its defaults, then this one with more and more of its own iterations,
each a whole ``usdsmoke stylize`` from the start: preset ``draft``, shares of the default
iterations, two of them with views from the front alone, the defaults. The unseen loss
(``benchmarks.held_out``) is the mean over held-out views of the first and the last file that were
written, within the default range (all round) and within the front that the other checkout was made
for; this checkout measures it for both. One thread unless ``--set optimize.threads=N``; CPU seconds
depend little on other work, wall seconds are worth something on a quiet machine alone.
"""

import sys
from pathlib import Path

from benchmarks.circumstances import publish, table_page
from benchmarks.speed import HERE, checkout_parser, measure
from usdsmoke.config.settings import Config

__all__ = ["main"]

SHARES = (0.05, 0.1, 0.2, 0.4)  # of the default iterations
FRONT = ("--set", "views.azimuth=12", "--set", "views.elevation=6")  # as be60f8a has them
COLUMNS = ("CPU", "wall", "unseen loss", "unseen loss, front")
PARTS = {  # wall seconds of a run
    "shape": ("shape",),
    "colour": ("colour",),
    "transport": ("transport",),
    "files": ("reading", "writing", "assembling"),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = checkout_parser(__doc__)
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    given = parser.parse_args(arguments)
    options = [word for item in ["optimize.threads=1", *given.settings] for word in ("--set", item)]
    options += ["--frames", given.frames] if given.frames else []
    runs = [("the other checkout", given.tree.resolve(), [])]
    runs += [("preset draft", HERE, ["--preset", "draft"])]
    runs += [(f"{share:g} of the iterations", HERE, _iterations(share)) for share in SHARES]
    runs += [
        (f"{share:g} of the iterations, views from the front", HERE, [*FRONT, *_iterations(share)])
        for share in SHARES[:2]
    ]
    runs += [("the defaults", HERE, [])]
    lines, first = [], {}
    for name, tree, more in runs:
        found = measure(tree, given.stage.resolve(), given.style.resolve(), [*options, *more])
        first = first or found
        cells = [f"{found[column]:.2f}" for column in COLUMNS]
        cells += [f"{first[column] / found[column]:.2f}" for column in COLUMNS[:2]]
        parts = [sum(found[part] for part in names) for names in PARTS.values()]
        cells += [f"{seconds:.1f}" for seconds in (*parts, found["wall"] - sum(parts))]
        lines.append(f"| {name} | {' | '.join(cells)} |")
        print(lines[-1], file=sys.stderr, flush=True)
    intro = [
        "# Time to equal unseen loss",
        "",
        "Whole runs: seconds, and the style loss of held-out views all round and",
        "from the front. *Times less*: the other checkout's seconds by the row's. The parts are",
        "seconds by the clock; to begin, the coarse step and estimates are in the rest.",
    ]
    columns = ["run", "CPU s", "wall s", "unseen loss", "from the front"]
    columns += ["times less CPU", "times less wall", *PARTS, "the rest"]
    command = ["python -m benchmarks.time_to_loss"]
    command += arguments if arguments is not None else sys.argv[1:]
    publish(table_page(intro, columns, lines, command), given.report)
    return 0


def _iterations(share: float) -> list[str]:
    config, words = Config(), list[str]()
    for step in ("shape", "colour"):
        counts = [max(1, round(share * n)) for n in getattr(config, step).iterations]
        words += ["--set", f"{step}.iterations={counts}"]
    return words


if __name__ == "__main__":
    sys.exit(main())
