"""What the command line prints about errors: the budget at the end of a run."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from usdsmoke.ui.cli.progress_bar import format_seconds
from usdsmoke.ui.cli.text import columns

if TYPE_CHECKING:
    from usdsmoke.planning.plan import Omission
    from usdsmoke.runs.budget.error_budget import ErrorBudget, Verdict


def budget_text(
    budget: "ErrorBudget",
    seconds: Mapping[str, float] | None = None,
    omitted: Sequence["Omission"] = (),
) -> str:
    """The error budget as a table, with what was left out and the time that the parts took.

    Args:
        budget: of the run.
        seconds: of all parts of the run; None or empty takes the budget's.
        omitted: what the plan left out; the reasons stand there.
    """
    rows: list[tuple[str, ...]] = [("error", "mean", "largest", "of", "frames", "took")]
    rows += [
        (
            estimate.name,
            f"{estimate.mean:.2%}",
            f"{estimate.largest:.2%}",
            estimate.relative_to,
            str(estimate.n_frames),
            f"{estimate.seconds:.2f} s" if estimate.seconds else "-",
        )
        for estimate in budget.estimates
    ]
    verdict = []
    if budget.tolerance is not None:
        bounds = {item.name: _bound(item) for item in budget.tolerance.rows}
        rows = [(*rows[0], "bound"), *((*row, bounds.get(row[0], "-")) for row in rows[1:])]
        verdict = [f"tolerance of {budget.tolerance}"]
    notes = [f"{name}: {note}" for name, note in budget.notes.items()]
    left_out = [f"without {name}: {why}" for name, why in budget.left_out.items()]
    parts = dict(seconds or budget.seconds)
    whole = parts.pop("all", None)
    took = ", ".join(f"{name} {_short(value)}" for name, value in parts.items())
    time = f"time: {took}" + (f"; {_short(whole)} in all" if whole is not None else "")
    rest = [_left_out(omitted)] if omitted else []
    return "\n".join([*columns(rows), *notes, *left_out, *rest, time, *verdict])


def _short(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 60 else format_seconds(seconds)


def _left_out(omitted: Sequence["Omission"]) -> str:
    """What was not read, computed or written, without the reasons."""
    names = "; ".join(dict.fromkeys(item.what for item in omitted))
    return f"left out, for the reasons in the plan and the record: {names}"


def _bound(item: "Verdict") -> str:
    return f"{item.bound:.2%} {'kept' if item.kept else 'NOT KEPT'}"
