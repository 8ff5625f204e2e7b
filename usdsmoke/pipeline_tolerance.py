"""A run's settings from a tolerance: one frame is calibrated, and the settings are chosen by it.

The calibration is kept in the output folder, ``OUT/vdb/calibration/<key>.json``, with a digest of
the inputs as its key: another tolerance, or another process of a queue, finds it there.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from usdsmoke.config import Config, config_to_dict, resolve_config
from usdsmoke.error_choice import choose_settings, user_values
from usdsmoke.pipeline_features import features_hashes
from usdsmoke.pipeline_frames import FrameReader
from usdsmoke.pipeline_inputs import Job, describe_run
from usdsmoke.pipeline_outputs import plain_values
from usdsmoke.pipeline_pictures import sample_frames
from usdsmoke.plan import VolumePlan
from usdsmoke.publish import make_folders, publish_new

__all__ = ["settle_tolerance"]


def settle_tolerance(job: Job, prepare: Callable[[Config], Job]) -> Job:
    """The job with the settings that ``optimize.target_error`` comes to; as it is without one.

    What the user has set, by name or in a file, stays. The plan tells what was chosen and why.

    Args:
        job: as it was asked for.
        prepare: makes the same job with other settings.

    Raises:
        UsdSmokeError: the frame cannot be read or stylized, the calibration not be written.
    """
    config = job.config
    target = config.optimize.target_error
    if target is None:
        return job
    settings = config_to_dict(config)
    set_by_user = user_values(settings, config_to_dict(Config()), job.explicit)
    planned = {"shape": config.shape.iterations, "colour": config.colour.iterations}
    choice = choose_settings(_calibration(job), target, planned, set_by_user)
    settled = prepare(resolve_config(settings, choice.settings))
    notes = (f"settings for a tolerance of {target:g}", *choice.notes)
    return replace(settled, plan=replace(settled.plan, needed=(*settled.plan.needed, *notes)))


def _calibration(job: Job) -> dict[str, Any]:
    """Of the frame with most smoke: read from the output folder, or measured and put there.

    Where two processes measure at once, the first one's figures hold for both: their settings must
    be the same.
    """
    features = features_hashes(volume.config.features for volume in job.plan.volumes)
    text = json.dumps(describe_run(job, features), sort_keys=True, ensure_ascii=False)
    key = hashlib.sha256(text.encode()).hexdigest()[:12]
    target = job.output / "vdb/calibration" / f"{key}.json"
    if (found := _read(target)) is not None:
        return found
    measured = json.dumps(plain_values(_measure(job)), indent=1)
    make_folders(target.parent)
    publish_new(target, lambda file_path: _write(file_path, measured))
    found = _read(target)
    return json.loads(measured) if found is None else found


def _measure(job: Job) -> dict[str, Any]:
    from usdsmoke.core.calibrate import calibrate

    volume = max(job.plan.volumes, key=_most_voxels)
    frames = sample_frames(volume)
    if not frames:
        return {}
    frame = max(frames, key=lambda frame: frame.size.active_voxels)
    read = FrameReader(job.plan).read(volume, frame)
    return calibrate(read, job.pictures(volume), volume.config, job.plan.source.up_axis)


def _most_voxels(volume: VolumePlan) -> int:
    return max(frame.size.active_voxels for frame in volume.frames)


def _read(file_path: Path) -> dict[str, Any] | None:
    try:
        found: dict[str, Any] = json.loads(file_path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found


def _write(file_path: Path, text: str) -> None:
    file_path.write_text(text, encoding="utf-8")
