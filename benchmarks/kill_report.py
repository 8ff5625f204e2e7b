"""What `benchmarks.kills` has seen, as tables."""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from benchmarks.circumstances import circumstances

__all__ = ["Kill", "Length", "report"]

# In the order in which they happen; "blend" goes on until the layer is there.
STEPS = {
    "start": "start: stage, plan, record",
    "check": "every frame read, scenes measured",
    "coarse": "coarse step",
    "shape": "shape step",
    "colour": "colour step",
    "write": "frames written",
    "blend": "frames blended, layer written",
    "picture": "contact sheet, tidying up",
}


@dataclass(frozen=True)
class Length:
    """What a command takes when it is left alone."""

    seconds: float
    n_files: int  # that came into the folder


@dataclass
class Kill:
    """What was killed, and what came of it."""

    scene: str
    step: str  # what was going on
    is_cold: bool  # a new interpreter
    seconds: float  # after which it was killed
    n_half: int = 0  # files left half-written, or whole and not yet in their places
    end: Length = Length(0.0, 0)  # of the run that followed, to the end
    faults: list[str] = field(default_factory=list)


def report(kills: Sequence[Kill], warm_s: float, arguments: Sequence[str]) -> str:
    """Markdown: kills by step and by command, and the circumstances.

    Args:
        kills: all of them.
        warm_s: what an uninterrupted run takes.
        arguments: of the command.
    """
    n_faults = sum(bool(kill.faults) for kill in kills)
    lines = [
        "# Kill -9 at random moments",
        "",
        f"{len(kills)} kills of commands on a tiny shot, with all the processes they had started;",
        "after each one what can be seen was checked, and a run from the state that was left was",
        "compared with an uninterrupted one: content hash of every frame, and the layer's text but",
        "for clock times and the run's id. See `benchmarks/kills.py`.",
        "",
        f"**{n_faults} of {len(kills)} went wrong.** An uninterrupted run takes {warm_s:.1f} s.",
        "",
        "By what was going on, as the command last told. *Half-written*: kills that left a",
        "temporary file behind. *To the end*: seconds of the run that followed.",
        "",
        *_table(
            "going on", kills, lambda kill: STEPS.get(kill.step, kill.step), list(STEPS.values())
        ),
        "",
        "By command.",
        "",
        *_table("killed", kills, lambda kill: kill.scene, ()),
        "",
        f"{sum(kill.is_cold for kill in kills)} of the kills hit new interpreters, the others",
        "forks of one that had imported everything, with 10 ms before every change of a folder.",
        "",
    ]
    lines += [f"- Kill {n}: {'; '.join(k.faults)}" for n, k in enumerate(kills, 1) if k.faults]
    return "\n".join([*lines, *circumstances(["python -m benchmarks.kills", *arguments])]) + "\n"


def _table(
    title: str, kills: Sequence[Kill], name_of: Callable[[Kill], str], order: Sequence[str]
) -> list[str]:
    """One row for each name, in the given order and then in the order of coming."""
    names = list(dict.fromkeys([*order, *(name_of(kill) for kill in kills)]))
    rows = [
        f"| {title} | kills | half-written | killed after s | to the end s | went wrong |",
        "|---|---|---|---|---|---|",
    ]
    for name in names:
        if mine := [kill for kill in kills if name_of(kill) == name]:
            rows.append(_row(name, mine))
    return [*rows, _row("all", kills)]


def _row(name: str, kills: Sequence[Kill]) -> str:
    half = sum(kill.n_half > 0 for kill in kills)
    cells = [
        name,
        str(len(kills)),
        str(half),
        _span([kill.seconds for kill in kills]),
        _span([kill.end.seconds for kill in kills]),
        str(sum(bool(kill.faults) for kill in kills)),
    ]
    return f"| {' | '.join(cells)} |"


def _span(values: Sequence[float]) -> str:
    return f"{min(values):.2f} to {max(values):.2f}, median {statistics.median(values):.2f}"
