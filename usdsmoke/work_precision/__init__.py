"""Work-precision report: what settings gain and cost in one scene, measured (``usdsmoke report``).

- ``report``: the way through, from the arguments to the files
- ``case``: the scene: one frame and a smaller copy of it for trials
- ``sweeps``, ``windows``, ``one_pass``, ``files``: the questions, each a sweep over some settings
- ``trial``, ``unseen_loss``: one step on the small copy, and its error
- ``engine``: takes points while there is time
- ``final``, ``path_tracer``: a look under its lights with many bounces, drawn by Mitsuba
- ``film``: frames alone, in windows and of the source, as an animation
- ``page`` (with ``page.html.j2``): what is written
- ``records``: points, sweeps, the report
"""

from usdsmoke.work_precision.engine import Sweep
from usdsmoke.work_precision.final import FinalCheck, check_final
from usdsmoke.work_precision.records import Plan, Report, Task
from usdsmoke.work_precision.report import SWEEPS, ReportResult, make_report, report_as_dict

__all__ = [
    "SWEEPS",
    "FinalCheck",
    "Plan",
    "Report",
    "ReportResult",
    "Sweep",
    "Task",
    "check_final",
    "make_report",
    "report_as_dict",
]
