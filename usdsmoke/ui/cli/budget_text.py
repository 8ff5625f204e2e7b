"""The error budget of a run as the command prints it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from usdsmoke.ui.cli.text import columns, format_seconds

if TYPE_CHECKING:
    from usdsmoke.planning.plan import Omission
    from usdsmoke.runs.budget import ErrorBudget


def budget_text(
    budget: "ErrorBudget",
    seconds: Mapping[str, float] | None = None,
    omitted: Sequence["Omission"] = (),
    everything: bool = True,
) -> str:
    """The error budget as a table, with what was left out and the time that the parts took.

    Args:
        seconds: of all parts of the run; None or empty takes the budget's.
        omitted: what the plan left out; the reasons stand there.
        everything: also rows that are fine, and why others are missing; False: the former's names.
    """
    if not everything:
        return _urgent_budget_text(budget, seconds, omitted)
    rows = _budget_rows(budget, [item.name for item in budget.estimates])
    notes = [f"{name}: {note}" for name, note in budget.notes.items()]
    reasons: dict[str, list[str]] = {}
    for name, why in budget.left_out.items():
        reasons.setdefault(why, []).append(name)
    left_out = [f"without {'; '.join(names)}: {why}" for why, names in reasons.items()]
    return "\n".join([*columns(rows), *notes, *left_out, *_end(budget, seconds, omitted)])


def _urgent_budget_text(
    budget: "ErrorBudget", seconds: Mapping[str, float] | None, omitted: Sequence["Omission"]
) -> str:
    fine = [item for item in budget.estimates if budget.verdict(item.name) == "fine"]
    others = [item for item in budget.estimates if item not in fine]
    table = columns(_budget_rows(budget, [item.name for item in others])) if others else []
    notes = [
        f"{item.name}: {budget.notes[item.name]}" for item in others if item.name in budget.notes
    ]
    if fine:
        names = "; ".join(f"{item.name} {item.mean:.2%}" for item in fine)
        table.append(f"estimated errors that are fine: {names}")
    table.append("--verbose lists all errors; docs/errors.md explains them")
    return "\n".join([*table, *notes, *_end(budget, seconds, omitted)])


def _budget_rows(budget: "ErrorBudget", names: Iterable[str]) -> list[tuple[str, ...]]:
    header = ("error", "mean", "largest", "of", "frames", "took", "verdict")
    rows = [
        (
            estimate.name,
            f"{estimate.mean:.2%}",
            f"{estimate.largest:.2%}",
            estimate.relative_to,
            str(estimate.n_frames),
            f"{estimate.seconds:.2f} s" if estimate.seconds else "-",
            budget.verdict(estimate.name),
        )
        for estimate in (budget[name] for name in sorted(names, key=_least_urgent(budget)))
    ]
    return [header, *rows]


def _end(
    budget: "ErrorBudget", seconds: Mapping[str, float] | None, omitted: Sequence["Omission"]
) -> list[str]:
    """What the plan left out, and the time that the parts took."""
    parts = dict(seconds or budget.seconds)
    whole = parts.pop("all", None)
    took = ", ".join(f"{name} {_short(value)}" for name, value in parts.items())
    time = f"time: {took}" + (f"; {_short(whole)} in all" if whole is not None else "")
    unusual = [item for item in omitted if not item.expected]
    return [*([_left_out(unusual)] if unusual else []), time]


def _least_urgent(budget: "ErrorBudget") -> Callable[[str], int]:
    """Puts rows that ask for a setting first, then those that deserve a look, then the others."""

    def urgency(name: str) -> int:
        verdict = budget.verdict(name)
        return 2 if verdict == "fine" else 1 if verdict == "look at it" else 0

    return urgency


def _short(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 60 else format_seconds(seconds)


def _left_out(omitted: Sequence["Omission"]) -> str:
    """What was not read, computed or written, without the reasons."""
    names = "; ".join(dict.fromkeys(item.what for item in omitted))
    return f"left out, for the reasons in the plan and the record: {names}"
