"""What the command line prints about errors: the budget at the end of a run."""

from typing import TYPE_CHECKING

from usdsmoke.cli_text import columns
from usdsmoke.progress import format_seconds

if TYPE_CHECKING:
    from usdsmoke.error_bounds import Verdict
    from usdsmoke.error_budget import ErrorBudget

__all__ = ["budget_text"]


def budget_text(budget: "ErrorBudget") -> str:
    """The error budget as a table, with what was left out and the time that the parts took."""
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
        bounds = {item.name: _bound(item) for item in budget.tolerance.verdicts}
        rows = [(*rows[0], "bound"), *((*row, bounds.get(row[0], "-")) for row in rows[1:])]
        verdict = [f"tolerance of {budget.tolerance}"]
    notes = [f"{name}: {note}" for name, note in budget.notes.items()]
    left_out = [f"without {name}: {why}" for name, why in budget.left_out.items()]
    took = [f"{name} {format_seconds(seconds)}" for name, seconds in budget.seconds.items()]
    return "\n".join([*columns(rows), *notes, *left_out, f"time: {', '.join(took)}", *verdict])


def _bound(item: "Verdict") -> str:
    return f"{item.bound:.2%} {'kept' if item.kept else 'NOT KEPT'}"
