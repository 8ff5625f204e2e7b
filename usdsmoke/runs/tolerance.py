"""A run's settings from a tolerance: one frame is calibrated, and the settings are chosen by it.

The calibration is kept in the output folder, ``OUT/vdb/calibration/<key>.json``. Its key is a
digest of the inputs, so another tolerance, or another process of a queue, finds it there.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from usdsmoke.base.json_records import plain_values
from usdsmoke.base.publish import make_folders, publish_new
from usdsmoke.base.settings import Config
from usdsmoke.planning.features import features_hashes
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job
from usdsmoke.runs.budget.choice import choose_settings
from usdsmoke.runs.identity import describe_run
from usdsmoke.runs.sheet import sample_frames

_VERSION = 2  # of what a calibration holds
_HEADING = "settings for a tolerance of"


def settle_tolerance(job: Job, prepare: Callable[[Config], Job], keep: bool = True) -> Job:
    """The job with settings chosen for ``optimize.target_error``; unchanged without one.

    What the user has set, by name or in a file, stays. The plan says what was chosen and why.

    Args:
        prepare: makes the same job with other settings.
        keep: put the calibration into the output folder, or take it from there.

    Raises:
        UsdSmokeError: the frame cannot be read or stylized, the calibration not be written.
    """
    if job.config.optimize.target_error is None:
        return job
    measured = _calibration(job) if keep else plain_values(_measure(job))
    return _settled(job, prepare, measured)


def foresee_tolerance(job: Job, prepare: Callable[[Config], Job]) -> Job:
    """The same from a calibration in the output folder; no frame is read, nothing is written.

    Without a calibration of these inputs, the settings stay and the plan says so.
    """
    target = job.config.optimize.target_error
    if target is None:
        return job
    folder = job.output / "vdb/calibration"
    found = _read(_file(job)) if folder.is_dir() else None
    if found is not None:
        return _settled(job, prepare, found)
    return _with_notes(
        job,
        f"these settings are not final: a run with --tolerance {target:g} first calibrates on one "
        "frame (a few seconds) and then chooses; the estimate changes with the settings",
    )


def _settled(job: Job, prepare: Callable[[Config], Job], measured: Mapping[str, Any]) -> Job:
    config, target = job.config, job.config.optimize.target_error
    assert target is not None  # callers have looked
    planned = {"shape": config.shape.iterations, "colour": config.colour.iterations}
    choice = choose_settings(measured, target, planned, config.given_values())
    settled = prepare(config.with_values(choice.settings))
    return _with_notes(settled, f"{_HEADING} {target:g}", *choice.notes)


def _with_notes(job: Job, *notes: str) -> Job:
    return replace(job, plan=replace(job.plan, notes=notes))


def _file(job: Job) -> Path:
    features = features_hashes(volume.config.features for volume in job.plan.volumes)
    described = describe_run(job, features)
    del described["settings"]["optimize"]["threads"]  # the first one's figures hold for all
    text = json.dumps([_VERSION, described], sort_keys=True, ensure_ascii=False)
    key = hashlib.sha256(text.encode()).hexdigest()[:12]
    return job.output / "vdb/calibration" / f"{key}.json"


def _calibration(job: Job) -> dict[str, Any]:
    """Of the frame with most smoke: read from the output folder, or measured and put there.

    Where two processes measure at once, the first one's figures hold for both: their settings must
    be the same.
    """
    target = _file(job)
    if (found := _read(target)) is not None:
        return found
    measured = json.dumps(plain_values(_measure(job)), indent=1)
    make_folders(target.parent)
    publish_new(target, measured)
    found = _read(target)
    return json.loads(measured) if found is None else found


def _measure(job: Job) -> dict[str, Any]:
    from usdsmoke.core.sequence.calibrate import calibrate

    volume = max(
        job.plan.volumes, key=lambda one: max(frame.size.active_voxels for frame in one.frames)
    )
    frames = sample_frames(volume)
    if not frames:
        return {}
    frame = max(frames, key=lambda frame: frame.size.active_voxels)
    read = FrameReader(job.plan).read(volume, frame)
    return calibrate(read, job.pictures(volume), volume.config, job.plan.source.up_axis)


def _read(file_path: Path) -> dict[str, Any] | None:
    try:
        found: dict[str, Any] = json.loads(file_path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found
