"""``usdsmoke report`` from its arguments to its files: scene, sweeps, diagrams, page."""

import datetime
import json
import os
import platform
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from usdsmoke import __version__
from usdsmoke.base.errors import ConfigError, Interrupted, OutputExists, WriteFailed
from usdsmoke.base.json_records import read_json
from usdsmoke.base.machine import (
    check_packages,
    package_versions,
    platform_name,
    prepare_torch_environment,
    usable_cpus,
)
from usdsmoke.base.publish import make_folders, publish_file, remove_empty
from usdsmoke.base.time_codes import format_time_code, format_time_codes
from usdsmoke.config.resolve import FilePath, Settings, Styles
from usdsmoke.core.smoke.tasks import n_sharing
from usdsmoke.planning.job import Request, prepare_job
from usdsmoke.planning.plan import Omission
from usdsmoke.usd.stage import StageOrFile
from usdsmoke.work_precision.case import Case, open_case
from usdsmoke.work_precision.engine import Budget, Clock, Sweep, Tell, run_sweeps, too_long
from usdsmoke.work_precision.files import FILES
from usdsmoke.work_precision.one_pass import ONE_PASS
from usdsmoke.work_precision.page import draw_sweep, make_page
from usdsmoke.work_precision.records import Report, SweepResult
from usdsmoke.work_precision.sweeps import (
    ITERATIONS,
    NETWORK,
    OCTAVES,
    VIEWS,
    VIEWS_COUNT,
    check_network,
)
from usdsmoke.work_precision.windows import WINDOWS

PAGE, DATA = "report.html", "report.json"

# The most useful first: what decides a run's time and look.
SWEEPS: tuple[Sweep, ...] = (
    *ITERATIONS, VIEWS, *WINDOWS, ONE_PASS, OCTAVES, VIEWS_COUNT, NETWORK, FILES,
)  # fmt: skip
_LONGEST, _LONGEST_PATIENT = 64, 128  # voxels along the longest side of the small copy
_PATIENT = 1800.0  # seconds from which on the larger copy is used
_NEVER = (
    Omission(
        "Settings of the look",
        "layers, statistic, weights of losses, learning rates, extinction and the style's size "
        "change the goal, so no error can compare them",
    ),
    Omission("Memory", "it is not measured; the plan of a run (--dry-run) estimates it"),
    Omission(
        "What the eye sees", "the report measures errors and losses; look at pictures for the rest"
    ),
)


@dataclass(frozen=True)
class ReportResult:
    """What was written."""

    page: Path
    files: tuple[Path, ...]  # page, diagrams, animations and JSON
    report: Report

    def __str__(self) -> str:
        verdicts = (f"{sweep.title}: {sweep.verdict}" for sweep in self.report.sweeps)
        return "\n".join((str(self.page), *verdicts))


def make_report(
    stage: StageOrFile,
    style: Styles,
    output: FilePath,
    settings: Settings = None,
    seconds: float = 300.0,
    progress: Tell | None = None,
    sweeps: Sequence[Sweep] | None = None,
) -> ReportResult:
    """Measure the settings around the configured ones in a scene and write a page about it.

    Args:
        stage: a USD file, or an open stage without unsaved edits.
        style: one image file or several; None if each Volume's prim names its own.
        output: the folder of the report; made if missing. A new report replaces an old one.
        settings: as in ``usdsmoke.stylize``.
        seconds: time for the measurements. A point that has begun is finished.
        progress: called with the sweep, the point, and the share of the time that is used.
        sweeps: what is measured, the most useful first; None takes ``SWEEPS``.

    Raises:
        MissingPackage: matplotlib is not installed.
        UsdSmokeError: the scene cannot be used, or the time is too short to measure anything;
            nothing is written then.
        WriteFailed, OutputExists: the report cannot be written there.
        FeatureError: a named VGG-19 file cannot be read.
        Interrupted: by Ctrl-C; an old report stays as it was.

    Everything but the last is raised before the first measurement.
    """
    # What can be refused is refused first.
    check_packages("matplotlib", "jinja2")
    prepare_torch_environment()
    tell = progress or (lambda sweep, point, share: None)
    target = Path(output).absolute()
    tell("scene", "reading", 0.0)
    job = prepare_job(Request(stage, style, target, settings), fits=False)
    check_network(job.plan)
    sweeps = SWEEPS if sweeps is None else sweeps
    names = [f"{sweep.name}.{kind}" for sweep in sweeps for kind in ("png", "webp")]
    names += [DATA, PAGE]
    with _report_folder(target, names) as old:
        try:
            # The scene, and its sweeps as far as the time goes.
            longest = _LONGEST_PATIENT if seconds >= _PATIENT else _LONGEST
            case, budget = open_case(job, longest, seconds), Budget(seconds)
            results, omitted = run_sweeps(sweeps, case, budget, _clock_of(case), tell)
            _check_measured(results, omitted, budget)
        except KeyboardInterrupt:
            raise Interrupted(
                f"stopped. No measurement is kept, and {target} is unchanged."
            ) from None
        # The page.
        tell("page", "writing", 1.0)
        report = _report(case, results, omitted, budget)
        return _write(report, target, old)


def _check_measured(
    results: Sequence[SweepResult], omitted: Sequence[Omission], budget: Budget
) -> None:
    late = [item for item in omitted if item.reason.startswith(too_long(budget))]
    if late and not results:
        raise ConfigError(
            f"{budget.seconds:g} s are too short for any measurement. {late[0].what} "
            f"{late[0].reason}. Give more time with --budget, in Python in seconds."
        )


def _report(
    case: Case, results: list[SweepResult], omitted: list[Omission], budget: Budget
) -> Report:
    plan = case.job.plan
    facts = {
        "Scene": _scene_facts(case),
        "Machine": _machine_facts(case, budget),
        "Versions": _version_facts(),
    }
    return Report(
        f"Work and precision: {Path(plan.source.file_path).name}, {case.volume.source.prim_path}",
        facts,
        tuple(results),
        (*omitted, *_simplified(case), *_NEVER),
        (_time_note(case), *plan.notes),
    )


def report_as_dict(report: Report) -> dict[str, Any]:
    """Everything on the page as JSON values."""
    return {
        "title": report.title,
        **{name.lower(): dict(facts) for name, facts in report.facts.items()},
        "notes": list(report.notes),
        "sweeps": [
            {
                "name": sweep.name,
                "title": sweep.title,
                "x": sweep.plan.x_label,
                "y": sweep.plan.y_label,
                "about": sweep.plan.about,
                "reference": sweep.plan.reference,
                "verdict": sweep.verdict,
                "missing": list(sweep.missing),
                "points": [asdict(point) for point in sweep.points],
            }
            for sweep in report.sweeps
        ],
        "omissions": [asdict(item) for item in report.omissions],
    }


def processor_name() -> str:
    """The processor's name as the system gives it."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.processor() or "processor unknown"
    names = [line.split(":", 1)[1].strip() for line in text.splitlines() if "model name" in line]
    return names[0] if names else platform.processor() or "processor unknown"


def _clock_of(case: Case) -> Clock:
    if not case.on_gpu:
        return Clock()
    import torch

    return Clock(settle=torch.cuda.synchronize)


def _time_note(case: Case) -> str:
    if case.on_gpu:
        return "Times are wall-clock times, because CPU time says nothing on a GPU."
    return (
        "Times are CPU seconds of all threads, which depend little on other processes. The tables "
        "also have wall-clock seconds."
    )


def _scene_facts(case: Case) -> dict[str, str]:
    volume, small = case.volume, case.small_scene
    codes = [frame.source.time_code for frame in volume.frames]
    return {
        "stage": Path(case.job.plan.source.file_path).name,
        "Volume": volume.source.prim_path,
        "timeCodes": f"{format_time_codes(codes)} ({len(codes)} frames)",
        "measured frame": f"timeCode {format_time_code(case.frame.time_code)}",
        "its smoke": _smoke_text(case.smoke),
        "its pictures": f"{case.scene.image_size} pixels, extinction {case.scene.gamma_w:.4g} per "
        "density and stage unit",
        "small copy, for trials": f"{_smoke_text(case.small_smoke)}; {small.image_size} pixels",
        "steps": ", ".join(case.steps),
        "network": case.config.features.network,
        "styles": ", ".join(case.job.styles[n].name for n in volume.styles),
    }


def _smoke_text(smoke: Any) -> str:
    low, high = smoke.box
    sides = " x ".join(str(int(n)) for n in high - low + 1)
    return f"{sides} voxels, {len(smoke.ijk):,} active"


def _machine_facts(case: Case, budget: Budget) -> dict[str, str]:
    """Where and when; nothing that names the machine or its user."""
    import torch

    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    threads = "" if case.on_gpu else f", {n_sharing()} threads used"
    return {
        "date": datetime.date.today().isoformat(),
        "system": platform_name(),
        "processor": f"{processor_name()}, {usable_cpus()} cores{threads}",
        "memory": f"{memory:.0f} GiB",
        "GPU": torch.cuda.get_device_name(case.device) if case.on_gpu else "not used",
        "load": f"{os.getloadavg()[0]:.1f} at the end",
        "time": f"{budget.spent:.0f} s of {budget.seconds:.0f} s",
    }


def _version_facts() -> dict[str, str]:
    return {
        "usdsmoke": __version__,
        **package_versions(),
        "matplotlib": version("matplotlib"),
    }


def _simplified(case: Case) -> list[Omission]:
    """What is simpler in the report than in a run."""
    others = [v.source.prim_path for v in case.job.plan.volumes if v is not case.volume]
    losses = case.config.losses
    found = {
        "Other Volumes": f"only the largest was measured, not {', '.join(others)}"
        if others
        else "",
        "Other frames": "only the sweep of windows uses them; the others use the middle one"
        if len(case.volume.frames) > 1
        else "",
        "Full resolution of trials": f"voxels of the trials are {2**case.halvings} times as large "
        "along each side as the scene's"
        if case.halvings
        else "",
        "The mask": "trials stylize all of the smoke" if case.frame.mask is not None else "",
        "The camera's frustum": "trials stylize all of the smoke, seen from the camera's direction"
        if case.scene.camera is not None
        else "",
        "Content losses": "trials minimise them, but results are measured without them"
        if losses.content or losses.laplacian or losses.photorealism
        else "",
    }
    return [Omission(what, reason) for what, reason in found.items() if reason]


# ---- the folder: tried before anything is measured, and replaced as a whole


@contextmanager
def _report_folder(target: Path, names: Collection[str]) -> Iterator[list[str]]:
    """Make sure of the folder; yield the files of an old report in it.

    A folder that was made is removed after a failure.

    Raises:
        WriteFailed: it is a file, or cannot be made or written to.
        OutputExists: it holds files of these names that are not from a report.
    """
    if target.exists() and not target.is_dir():
        raise WriteFailed(f"cannot write a report to {target}: it is a file. Name a folder.")
    old = _files_of(target)
    strange = sorted(name for name in names if (target / name).exists() and name not in old)
    if strange:
        raise OutputExists(
            f"{target} holds {', '.join(strange)}, which no report of usdsmoke wrote. Move it away "
            "or name another folder."
        )
    made = make_folders(target)
    try:
        try:
            with tempfile.TemporaryFile(dir=target) as stream:
                stream.write(b"0")
        except OSError as error:
            raise WriteFailed(
                f"cannot write to the folder {target}: {error.strerror or error}. Choose another "
                "one or change its permissions."
            ) from None
        yield old
    except BaseException:
        remove_empty(made)
        raise


def _files_of(target: Path) -> list[str]:
    """The files that belong to the report in a folder."""
    try:
        names = read_json((target / DATA).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    if not isinstance(names, list):
        return []
    return [name for name in names if isinstance(name, str) and Path(name).name == name]


def _write(report: Report, target: Path, old: Sequence[str]) -> ReportResult:
    """Make everything, then write it, then remove the old report's other files.

    ``DATA`` lists the files of both reports until all is done, so that a killed process leaves
    nothing behind for good.
    """
    pictures = {result.name: draw_sweep(result) for result in report.sweeps}
    drawn = {result.name: result.plan.film() for result in report.sweeps if result.plan.film}
    films = {name: data for name, data in drawn.items() if data}
    contents = {f"{name}.png": data for name, data in pictures.items()}
    contents |= {f"{name}.webp": data for name, data in films.items()}
    contents[PAGE] = make_page(report, pictures, films).encode("utf-8")
    names = [*contents, DATA]

    def put_data(files: Sequence[str]) -> None:
        values = {**report_as_dict(report), "files": list(files)}
        publish_file(target / DATA, json.dumps(values, indent=1, ensure_ascii=False) + "\n")

    try:
        put_data(list(dict.fromkeys([*names, *old])))
        for name, content in contents.items():
            publish_file(target / name, content)
        for name in set(old) - set(names):
            (target / name).unlink(missing_ok=True)
        put_data(names)
    except KeyboardInterrupt:
        raise Interrupted(
            f"stopped while the report was written. {target} holds a part of it, which the next "
            "report replaces."
        ) from None
    return ReportResult(target / PAGE, tuple(target / name for name in names), report)
