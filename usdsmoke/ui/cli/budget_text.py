"""The error budget of a run as the command prints it."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from usdsmoke.ui.cli.text import columns, format_seconds

if TYPE_CHECKING:
    from usdsmoke.planning.plan import Omission
    from usdsmoke.runs.budget import ErrorBudget

_HINT = "--verbose lists all error estimates and what was left out; see docs/errors.md"


def budget_text(
    budget: "ErrorBudget",
    seconds: Mapping[str, float] | None = None,
    omitted: Sequence["Omission"] = (),
    everything: bool = True,
    starting: float = 0.0,
) -> str:
    """The verdicts on a result, and the time that the parts of the run took.

    Args:
        seconds: of all parts of the run; None or empty takes the budget's.
        omitted: what the plan left out; the reasons stand there.
        everything: also all errors, why others are missing, and what was left out.
        starting: seconds from the beginning of the process to the command; 0: not known.
    """
    lines = columns(_verdict_rows(budget))
    if everything:
        lines += ["", *_all_errors(budget)]
        unusual = dict.fromkeys(item.what for item in omitted if not item.expected)
        lines += [f"left out, for the reasons in the plan: {'; '.join(unusual)}"] if unusual else []
    else:
        lines.append(_HINT)
    return "\n".join([*lines, _time(dict(seconds or budget.seconds), starting)])


def _verdict_rows(budget: "ErrorBudget") -> list[tuple[str, ...]]:
    """A row for each part of the result, worst first."""
    header = ("verdict", "on", "why")
    rows = [(item.verdict, item.about, item.why) for item in budget.verdicts]
    return [header, *rows] if rows else []


def _all_errors(budget: "ErrorBudget") -> list[str]:
    """A row for each error in the order of its verdict, notes, and why others are missing."""
    header = ("error", "mean", "largest", "of", "frames", "took", "verdict")
    rows = [
        (
            item.name,
            f"{item.mean:.2%}",
            f"{item.largest:.2%}",
            item.relative_to,
            str(item.n_frames),
            f"{item.seconds:.2f} s" if item.seconds else "-",
            budget.verdict(item.name),
        )
        for item in budget.worst_first
    ]
    reasons: dict[str, list[str]] = {}
    for name, why in budget.left_out.items():
        reasons.setdefault(why, []).append(name)
    return [
        *columns([header, *rows]),
        *(f"{name}: {note}" for name, note in budget.notes.items()),
        *(f"without {'; '.join(names)}: {why}" for why, names in reasons.items()),
    ]


def _time(parts: dict[str, float], starting: float) -> str:
    whole = parts.pop("all", None)
    if starting and whole is not None:
        parts, whole = {"starting": starting, **parts}, starting + whole
    took = ", ".join(f"{name} {_short(value)}" for name, value in parts.items())
    return f"time: {took}" + (f"; {_short(whole)} in all" if whole is not None else "")


def _short(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 60 else format_seconds(seconds)
