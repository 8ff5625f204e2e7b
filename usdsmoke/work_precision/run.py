"""A report from end to end: scene, sweeps, diagrams, page."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from usdsmoke.base.errors import Interrupted
from usdsmoke.base.given_settings import (
    FilePath,
    Settings,
    Styles,
    explicit_values,
    resolve_settings,
)
from usdsmoke.base.machine import prepare_torch_environment
from usdsmoke.planning.job import Request, prepare_job
from usdsmoke.runs.tolerance import choice_notes, settle_tolerance
from usdsmoke.work_precision import (
    sweep_backtrace,
    sweep_files,
    sweep_interpolation,
    sweep_iterations,
    sweep_network,
    sweep_octaves,
    sweep_precision,
    sweep_projection,
    sweep_quadrature,
    sweep_views,
    sweep_windows,
)
from usdsmoke.work_precision.budget import Budget
from usdsmoke.work_precision.case import Case, open_case
from usdsmoke.work_precision.circumstances import machine_figures, scene_figures, version_figures
from usdsmoke.work_precision.data import report_as_csv, report_as_json
from usdsmoke.work_precision.diagrams import check_matplotlib, draw_sweep
from usdsmoke.work_precision.engine import Sweep, Tell, run_sweeps
from usdsmoke.work_precision.folder import DATA, PAGE, TABLE, ReportFolder, report_folder
from usdsmoke.work_precision.measure import Clock
from usdsmoke.work_precision.page import make_page
from usdsmoke.work_precision.records import Omission, Report
from usdsmoke.work_precision.sweep_network import check_network

__all__ = ["SWEEPS", "ReportResult", "make_report"]

# The most useful first: what decides a run's time and look, then its parts.
SWEEPS: tuple[Sweep, ...] = (
    *sweep_iterations.SWEEPS,
    sweep_views.SWEEPS[0],
    *sweep_windows.SWEEPS,
    sweep_octaves.SWEEP,
    sweep_views.SWEEPS[1],
    sweep_network.SWEEP,
    sweep_projection.SWEEP,
    sweep_quadrature.SWEEP,
    sweep_interpolation.SWEEP,
    sweep_backtrace.SWEEP,
    sweep_precision.SWEEP,
    sweep_files.SWEEP,
)
_LONGEST, _LONGEST_PATIENT = 64, 128  # voxels of the small copy
_PATIENT = 1800.0  # seconds from which on the larger copy is taken
_NEVER = (
    Omission(
        "Settings of the look",
        "layers, statistic, weights of losses, learning rates, extinction and the style's size are "
        "not swept: they change what is wanted, and no error tells which is right",
    ),
    Omission("Memory", "it is not measured; the plan of a run (--dry-run) estimates it"),
    Omission(
        "What the eye sees",
        "errors and losses are measured; whether a difference shows, only pictures can tell",
    ),
)


@dataclass(frozen=True)
class ReportResult:
    """What was written."""

    page: Path
    files: tuple[Path, ...]  # page, CSV, JSON and pictures
    report: Report


def make_report(
    stage: FilePath,
    style: Styles,
    output: FilePath,
    config: Settings = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
    seconds: float = 300.0,
    progress: Tell | None = None,
    clock: Clock | None = None,
    sweeps: Sequence[Sweep] | None = None,
    now: Callable[[], float] = time.monotonic,
) -> ReportResult:
    """Measure a scene's choices around the configured ones and write what that says.

    Args:
        stage: a USD file.
        style: one image file or several; None where every Volume's prim brings its own.
        output: the folder of the report; made if missing. An old report in it is replaced as a
            whole once the new one is measured.
        config, settings: as in ``pipeline.stylize``.
        seconds: that the measurements may take; a point that is begun is finished.
        progress: called with the sweep, the point, and the share of the time that is used.
        clock: of the measurements, for tests.
        sweeps: which, the most useful first; None takes all.
        now: clock of the budget, for tests.

    Raises:
        MissingExtra: matplotlib is not installed.
        UsdSmokeError: the scene cannot be used, see ``prepare_job``; nothing is written then.
        WriteFailed, OutputExists: the report cannot be written there, see ``report_folder``.
        FeatureError: VGG-19 is named and cannot be read.
        Interrupted: by Ctrl-C; nothing is kept, and an old report stays as it was.

    All of them but the last come before the first measurement.
    """
    check_matplotlib()
    prepare_torch_environment()
    tell = progress or (lambda sweep, point, share: None)
    target = Path(output).absolute()
    taken = SWEEPS if sweeps is None else sweeps
    resolved, explicit = resolve_settings(config, settings)
    tell("scene", "reading", 0.0)

    request = Request(stage, style, target, [resolved, explicit_values(resolved, explicit)])
    first = prepare_job(request, fits=False)
    check_network(first.plan)
    with report_folder(target, [*(f"{s.name}.png" for s in taken), TABLE, DATA, PAGE]) as folder:
        try:
            job = settle_tolerance(first, first.with_config, keep=False)
            longest = _LONGEST_PATIENT if seconds >= _PATIENT else _LONGEST
            case = open_case(job, longest, seconds)
            report = _measured(case, taken, Budget(seconds, now), clock or _clock_of(case), tell)
        except KeyboardInterrupt:
            raise Interrupted(
                f"stopped; nothing that was measured is kept, and {target} is as it was"
            ) from None
        tell("page", "writing", 1.0)
        return _write(report, folder)


def _measured(
    case: Case, sweeps: Sequence[Sweep], budget: Budget, clock: Clock, tell: Tell
) -> Report:
    results, omitted = run_sweeps(sweeps, case, budget, clock, tell)
    plan = case.job.plan
    return Report(
        f"Work and precision: {Path(plan.source.file_path).name}, {case.volume.source.prim_path}",
        (scene_figures(case), machine_figures(case, budget.spent), version_figures()),
        tuple(results),
        (*omitted, *_simplified(case)),
        (*_notes(case), *choice_notes(plan)),
    )


def _clock_of(case: Case) -> Clock:
    if not case.on_gpu:
        return Clock()
    import torch

    return Clock(settle=torch.cuda.synchronize)


def _notes(case: Case) -> list[str]:
    kind = (
        "Times are wall-clock times: CPU time says nothing on a GPU."
        if case.on_gpu
        else "Times are CPU seconds of all threads, which a busy machine changes little; "
        "wall-clock seconds stand in the tables."
    )
    return [kind, *case.notes]


def _simplified(case: Case) -> list[Omission]:
    """What is simpler in the report than in a run."""
    found = []
    volumes = case.job.plan.volumes
    others = [v.source.prim_path for v in volumes if v is not case.volume]
    if others:
        found.append(
            Omission("Other Volumes", f"only the largest was measured, not {', '.join(others)}")
        )
    if len(case.volume.frames) > 1:
        found.append(
            Omission("Other frames", "all sweeps but that of windows look at one frame, the middle "
                                     "one; others may differ")
        )  # fmt: skip
    if case.halvings:
        found.append(
            Omission("Full resolution of trials", f"voxels of the trials are {2**case.halvings} "
                     "times as large along each side as the scene's")
        )  # fmt: skip
    if case.frame.mask is not None:
        found.append(Omission("The mask", "trials stylize all of the smoke"))
    if case.scene.camera is not None:
        found.append(
            Omission("The camera's frustum", "trials stylize all of the smoke, seen from the "
                                             "camera's direction")
        )  # fmt: skip
    losses = case.config.losses
    if losses.content or losses.laplacian or losses.photorealism:
        found.append(
            Omission("Losses of the content", "trials minimise them; results are judged without")
        )
    return [*found, *_NEVER]


def _write(report: Report, folder: ReportFolder) -> ReportResult:
    """Everything is made before anything is written."""
    pictures = {result.name: draw_sweep(result) for result in report.sweeps}
    contents = {f"{name}.png": data for name, data in pictures.items()}
    contents[TABLE] = report_as_csv(report).encode("utf-8")
    contents[PAGE] = make_page(report, pictures).encode("utf-8")
    files = folder.write(contents, lambda names: report_as_json(report, names))
    return ReportResult(files[0].parent / PAGE, files, report)
