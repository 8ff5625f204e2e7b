"""Which run a call belongs to.

- ``choose``: a run that is begun, continued, joined, repeated or refused
- ``growth``: a result that gets more frames or whose source changed in part: what stays
"""

from usdsmoke.runs.opening.choose import (
    find_refusal,
    frames_again,
    join_run,
    open_run,
    open_run_to_assemble,
    refuse_result,
)
from usdsmoke.runs.opening.growth import find_growth, repetition_note

__all__ = [
    "find_growth",
    "find_refusal",
    "frames_again",
    "join_run",
    "open_run",
    "open_run_to_assemble",
    "refuse_result",
    "repetition_note",
]
