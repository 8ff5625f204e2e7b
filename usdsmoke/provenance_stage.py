"""What a stage says about its Volumes, piece by piece, so that a change can be named later."""

import dataclasses
import hashlib
import json
from typing import Any

import numpy as np

from usdsmoke.volume import StageSource, VolumeSource

__all__ = ["stage_values"]

_METADATA = (
    "up_axis",
    "meters_per_unit",
    "time_codes_per_second",
    "frames_per_second",
    "start_time_code",
    "end_time_code",
    "default_prim",
)


def stage_values(source: StageSource) -> dict[str, str]:
    """Stage metadata as texts by name, and by ``<prim path>`` a digest of each Volume's values.

    A Volume's values are its timeCodes, fields, grids, places, cameras and controls; where its
    files lie on the disk is no part of them. What its prim asks for itself stands by the name
    ``<prim path> request``, where there is anything.
    """
    values = {
        _camel(name): "none" if (value := getattr(source, name)) is None else str(value)
        for name in _METADATA
    }
    for volume in source.volumes:
        values[f"<{volume.prim_path}>"] = _digest(volume)
        if volume.request.settings:
            settings = {key: dict(value) for key, value in volume.request.settings.items()}
            values[f"<{volume.prim_path}> request"] = json.dumps(settings, sort_keys=True)
    return values


def _digest(volume: VolumeSource) -> str:
    values = dataclasses.asdict(volume)
    del values["request"]
    for frame in values["frames"]:
        for field in frame["fields"].values():
            del field["file_path"]
    text = json.dumps(values, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()


def _camel(name: str) -> str:
    first, *rest = name.split("_")
    return first + "".join(word.capitalize() for word in rest)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else str(value)
