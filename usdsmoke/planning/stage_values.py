"""Digests of a stage's values for each Volume, so that a later change can be named."""

import dataclasses
import hashlib
import json
from typing import Any

import numpy as np

from usdsmoke.base.volume import StageSource, VolumeSource

_METADATA = (
    "up_axis",
    "meters_per_unit",
    "time_codes_per_second",
    "frames_per_second",
    "start_time_code",
    "end_time_code",
    "default_prim",
)
_RANGE = ("start_time_code", "end_time_code")


def stage_values(source: StageSource) -> dict[str, str]:
    """Stage metadata as texts by name, and by ``<prim path>`` a digest of each Volume's values.

    A Volume's values are its timeCodes, fields, grids, transforms, cameras, lights and controls;
    the paths of its files on the disk are not part of them. The settings that its prim requests
    have the name ``<prim path> request``, if there are any.
    """
    values = {
        _camel(name): "none" if (value := getattr(source, name)) is None else str(value)
        for name in _METADATA
    }
    for volume in source.volumes:
        values[f"<{volume.prim_path}>"] = _digest(_plain_volume(volume))
        if volume.request.settings:
            settings = {key: dict(value) for key, value in volume.request.settings.items()}
            values[f"<{volume.prim_path}> request"] = json.dumps(settings, sort_keys=True)
    return values


def stage_pieces(source: StageSource) -> dict[str, Any]:
    """The same as JSON values in smaller parts, without the prims' requests, and without what only
    says which other frames there are: the stage's range and timeCodes that are not selected.

    Of a Volume: its density's, velocity's and mask's name, and digests of ``timeCodes``, ``fields``
    (prims, grids, types), ``places`` (transforms), ``cameras``, ``controls`` and ``otherFields``;
    ``lights`` where it has any.
    """
    pieces: dict[str, Any] = {
        _camel(name): getattr(source, name) for name in _METADATA if name not in _RANGE
    }
    pieces["leftOut"] = dict(source.omitted)
    for volume in source.volumes:
        pieces[f"<{volume.prim_path}>"] = _volume_pieces(_plain_volume(volume))
    return pieces


def _volume_pieces(values: dict[str, Any]) -> dict[str, Any]:
    frames = values["frames"]
    fields = [list(frame["fields"].items()) for frame in frames]
    places = [[field.pop("field_to_stage") for _, field in named] for named in fields]
    times = [[frame["time_code"] for frame in frames], values["animated"]]
    lights = [frame.get("lights", ()) for frame in frames]
    return {
        **({"lights": _digest(lights)} if any(lights) else {}),
        "density": values["density"],
        "velocity": list(values["velocity"]),
        "mask": values["mask"],
        "timeCodes": _digest(times),
        "fields": _digest(fields),
        "places": _digest(places),
        "cameras": _digest([frame["camera"] for frame in frames]),
        "controls": _digest([frame["controls"] for frame in frames]),
        "otherFields": _digest(values["other_fields"]),
    }


def _plain_volume(volume: VolumeSource) -> dict[str, Any]:
    values = dataclasses.asdict(volume)
    del values["request"]
    del values["materials"]  # they decide what the layer binds, not what the files hold
    del values["variants"]  # what they select counts
    del values["notes"]
    if not values["copied"]:
        del values["copied"]
    for frame in values["frames"]:
        if not frame["lights"]:
            del frame["lights"]  # values of stages without any stay what they were
        for field in frame["fields"].values():
            del field["file_path"]
            if field["code_stretch"] == field["time_stretch"] == 1:
                del field["code_stretch"], field["time_stretch"]
    return values


def _digest(values: Any) -> str:
    text = json.dumps(values, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()


def _camel(name: str) -> str:
    first, *rest = name.split("_")
    return first + "".join(word.capitalize() for word in rest)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else str(value)
