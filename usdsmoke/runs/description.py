"""What decides a result, in JSON values: equal descriptions give equal results."""

import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from usdsmoke import __version__
from usdsmoke.base.config import Config, config_to_dict
from usdsmoke.base.record_format import hash_file
from usdsmoke.base.request_attributes import REQUEST_ATTRIBUTES
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.pictures.png import StyleImage
from usdsmoke.planning.job import Job
from usdsmoke.planning.plan import Plan, VolumePlan
from usdsmoke.planning.stage_values import stage_pieces

__all__ = ["describe_run", "requested_values"]

# Settings that change when or whether a result comes about, but not the result.
_NEUTRAL = {
    "features": ("vgg19_file",),  # what it holds counts: features_hash
    "grids": ("memory_limit_gib", "time_limit_s"),
    "optimize": ("memory_limit_gib", "error_budget", "target_error"),
    "layer": ("mode",),
}


def describe_run(
    job: Job,
    features_hash: str,
    known: Mapping[str, str] | None = None,
    wanted: Collection[str] | None = None,
) -> dict[str, Any]:
    """Everything that decides a result, as JSON values: equal descriptions give equal results.

    Files are named relative to the stage, so that a moved shot is still the same run. Threads and
    device stand there as asked for; they may be left to the machine.

    Args:
        job: gives stage, files, settings and styles.
        features_hash: of what pictures are compared by.
        known: digests of an earlier description's ``files``, for those that are not read.
        wanted: the files that are read and compared, as the plan names them; None: all.
    """
    source = job.plan.source
    folder = Path(source.file_path).parent
    requests = requested_values(job.plan, job.styles)
    files = {}
    for file_path in source.grid_files:
        name = os.path.relpath(file_path, folder)
        if wanted is None or known is None or file_path in wanted or name not in known:
            files[name] = _file_digest(job, file_path)
        else:
            files[name] = known[name]
    return {
        **({"requests": requests} if requests else {}),
        "version": __version__,
        "settings": _deciding_settings(job.config),
        "stage": {"file": Path(source.file_path).name, **stage_pieces(source)},
        "files": files,
        "styles": [f"{style.name} {style.sha256}" for style in job.styles],
        "features_hash": features_hash,
    }


def _file_digest(job: Job, file_path: str) -> str:
    """SHA-256 of a file, taken once."""
    if file_path not in job.digests:
        job.digests[file_path] = hash_file(file_path)
    return job.digests[file_path]


def requested_values(plan: Plan, styles: Sequence[StyleImage]) -> dict[str, Any]:
    """What each Volume's prim asks for and gets, as JSON values that name no folder.

    Args:
        plan: of the run.
        styles: all images of the run.

    Returns:
        ``settings``, ``styles`` (name and SHA-256) and, where values change over time, ``samples``
        (by setting and timeCode) by prim path; nothing for Volumes that ask for nothing.
    """
    found: dict[str, Any] = {}
    for volume in plan.volumes:
        request = volume.source.request
        if request.settings or request.styles:
            images = [styles[place] for place in volume.styles] if request.styles else []
            found[volume.source.prim_path] = {
                "settings": {key: dict(values) for key, values in request.settings.items()},
                "styles": [f"{image.name} {image.sha256}" for image in images],
            }
            if samples := _requested_samples(volume):
                found[volume.source.prim_path]["samples"] = samples
    return found


def _requested_samples(volume: VolumePlan) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for row in (row for row in REQUEST_ATTRIBUTES if row.control):
        for frame in volume.source.frames:
            value = getattr(frame.controls, row.control)
            if value is not None:
                code = format_time_code(frame.time_code)
                found.setdefault(row.setting, {})[code] = value
    return found


def _deciding_settings(config: Config) -> dict[str, dict[str, Any]]:
    settings = config_to_dict(config)
    for section, keys in _NEUTRAL.items():
        for key in keys:
            del settings[section][key]
    device = settings["optimize"]["device"]
    settings["optimize"]["device"] = device.partition(":")[
        0
    ]  # which one of several GPUs is as well
    return settings
