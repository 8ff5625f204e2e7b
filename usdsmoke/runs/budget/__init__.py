"""The error budget and the time of a run, from the reports of its frames.

``rows`` declares every error once, ``planned`` says why one is absent, ``error_budget`` puts
figures together. ``finding`` is what deserves a look, ``findings``, ``light_findings``,
``look_findings`` and ``sight_findings`` find it, ``watch`` tells it during the run, and
``verdicts`` says what to make of each part of a result.
``clock`` measures the parts of a run.
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
    mean_entries,
    run_budget,
    summarize_figures,
)
from usdsmoke.runs.budget.finding import Finding, finding_texts
from usdsmoke.runs.budget.watch import WindowFindings

__all__ = [
    "ELSEWHERE",
    "ErrorBudget",
    "Finding",
    "PartClock",
    "WindowFindings",
    "finding_texts",
    "mean_entries",
    "run_budget",
    "run_seconds",
    "step_seconds",
    "summarize_figures",
    "timed_items",
]
