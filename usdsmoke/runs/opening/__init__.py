"""Which run a call belongs to.

- ``choose``: a run that is begun, continued, joined, repeated or refused
- ``course``: the same for the plan, before anything is written
- ``growth``: a result that gets more frames or whose source changed in part: what stays
- ``measured``: what frames share that a look gets later
- ``refusals``: what is in the way
"""

from usdsmoke.runs.opening.choose import (
    frames_again,
    join_run,
    open_run,
    open_run_to_assemble,
)
from usdsmoke.runs.opening.course import Course
from usdsmoke.runs.opening.growth import continued, find_growth
from usdsmoke.runs.opening.refusals import FORCE, refuse_result

__all__ = [
    "FORCE",
    "Course",
    "continued",
    "find_growth",
    "frames_again",
    "join_run",
    "open_run",
    "open_run_to_assemble",
    "refuse_result",
]
