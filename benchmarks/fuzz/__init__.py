"""Damaged inputs by the thousand: every answer is a result or a named error."""

from benchmarks.fuzz.case import Case, Outcome, faults, run_case
from benchmarks.fuzz.seeds import KINDS, make_seeds

__all__ = ["KINDS", "Case", "Outcome", "faults", "make_seeds", "run_case"]
