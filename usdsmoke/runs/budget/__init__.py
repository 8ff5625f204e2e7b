"""The error budget and the time of a run, from the reports of its frames.

``rows`` declares every error once, ``planned`` says why one is absent, ``error_budget`` puts
figures together, and ``findings`` says what deserves a look. ``clock`` measures the parts of a run.
"""

from usdsmoke.runs.budget.clock import (
    ELSEWHERE,
    PartClock,
    run_seconds,
    step_seconds,
    timed_items,
)
from usdsmoke.runs.budget.error_budget import (
    ErrorBudget,
    make_budget,
    mean_entries,
    run_budget,
    summarize_figures,
)
from usdsmoke.runs.budget.findings import Finding
from usdsmoke.runs.budget.rows import ROWS

__all__ = [
    "ELSEWHERE",
    "ROWS",
    "ErrorBudget",
    "Finding",
    "PartClock",
    "make_budget",
    "mean_entries",
    "run_budget",
    "run_seconds",
    "step_seconds",
    "summarize_figures",
    "timed_items",
]
