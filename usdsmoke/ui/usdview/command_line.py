"""The command that stylizes Volumes of an open stage, as text to paste into a terminal."""

import json
import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd

from usdsmoke.base.errors import LayerError, StageError
from usdsmoke.base.record_format import RunRecord
from usdsmoke.base.time_codes import format_time_code, format_time_codes
from usdsmoke.base.volume import VolumeSource
from usdsmoke.config.resolve import PATH_SETTINGS
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.config.settings import Config
from usdsmoke.ui.usdview.looks import Look, find_looks, looks_of, shown_run
from usdsmoke.usd.field_samples import held_time_code
from usdsmoke.usd.layer_record import read_record
from usdsmoke.usd.stage import find_volumes

NO_STYLE = "STYLE.png"  # stands for an image that is not known
_GIVEN_OTHERWISE = ("stage.prims", "stage.frames")  # by options of their own


@dataclass(frozen=True)
class CommandText:
    """A command line and what to know before it is run."""

    command: str
    notes: tuple[str, ...] = ()


def stylize_command(
    stage: Usd.Stage, volumes: Sequence[Usd.Prim], time_code: float | None
) -> CommandText:
    """``usdsmoke stylize`` for Volumes of an open stage, quoted for a POSIX shell.

    Where the Volumes have a look, the stage, the style images and the settings are those of its
    record. Otherwise the stage is the open one, and Volumes that name images themselves get no
    others. The output folder is a new one beside the stage.

    Args:
        stage: the open stage; its root layer needs a file.
        volumes: prims of it, one at least.
        time_code: the frame that is held at this timeCode, or the first; None takes all frames.

    Raises:
        StageError: the stage has no file, or a Volume's files cannot be found.
    """
    root = stage.GetRootLayer()
    if root.anonymous or not root.realPath:
        raise StageError(f"the stage {root.identifier} has no file. Save it first.")
    paths = [str(volume.GetPath()) for volume in volumes]
    found = find_volumes(stage, StageConfig(prims=paths))
    look, stage_file = _shown_look(stage, volumes), Path(root.realPath)
    styles, settings, explicit = [], dict[str, Any](), frozenset[str]()
    notes: list[str] = []
    if look is not None:
        folder, record = Path(look.layer.realPath).parent, _record_of(look)
        styles = [_place(folder, name) for name in record.style_request]
        settings, explicit = _given_settings(record, folder), frozenset(record.explicit)
        source = Path(_place(folder, record.stage))
        if source.is_file():
            stage_file = source
        else:
            notes.append(
                f"{stage_file.name} already has a look. Give its source stage, if you have it."
            )
        if not all(map(os.path.isfile, styles)):
            notes.append("a style image has been moved or deleted. Correct its path.")
    elif not all(volume.request.styles for volume in found.volumes):
        styles, notes = [NO_STYLE], [f"replace {NO_STYLE} with your style image"]
    if unsaved := _unsaved(stage):
        notes.append(f"unsaved edits are not in the command's stage: {', '.join(unsaved)}")
    words = ["usdsmoke", "stylize", str(stage_file)]
    words += [word for path in paths for word in ("--prim", path)]
    if any(volume.animated for volume in found.volumes):
        words += ["--frames", _frames(found.volumes, time_code)]
    words += [word for style in styles for word in ("--style", style)]
    own = _own_settings(found.volumes) - explicit
    for name, value in settings.items():
        if name not in own:  # an option is stronger than a Volume's own request
            words += ["--set", f"{name}={json.dumps(value, ensure_ascii=False)}"]
    words += ["-o", str(_new_folder(stage_file))]
    return CommandText(shlex.join(words), tuple(notes))


def _shown_look(stage: Usd.Stage, volumes: Sequence[Usd.Prim]) -> Look | None:
    """The look that the Volumes show, or the newest that they could show."""
    looks = looks_of(volumes, find_looks(stage))
    runs = {shown_run(volume) for volume in volumes}
    return next((look for look in looks if look.run in runs), looks[-1] if looks else None)


def _record_of(look: Look) -> RunRecord:
    try:
        return read_record(look.layer)
    except LayerError as error:
        raise StageError(str(error)) from None


def _given_settings(record: RunRecord, folder: Path) -> dict[str, Any]:
    """Settings of a record by section.key: those that were given, or are no default of today."""
    found = {}
    for section, defaults in Config().model_dump().items():
        values: Mapping[str, Any] = record.settings.get(section, {})
        for key in (key for key in defaults if key in values):
            name, value = f"{section}.{key}", values[key]
            if (value == defaults[key] and name not in record.explicit) or name in _GIVEN_OTHERWISE:
                continue
            if name in PATH_SETTINGS and value.startswith(("./", "../")):
                value = _place(folder, value)
            found[name] = value
    return found


def _place(folder: Path, name: str) -> str:
    """The absolute path of a file in a record."""
    return str((folder / name).resolve())


def _own_settings(volumes: Sequence[VolumeSource]) -> set[str]:
    """Settings that the Volumes' prims request, as section.key."""
    requests = [volume.request.settings for volume in volumes]
    return {f"{section}.{key}" for one in requests for section in one for key in one[section]}


def _frames(volumes: Sequence[VolumeSource], time_code: float | None) -> str:
    """The selection of frames: all, or those that are held at a timeCode."""
    animated = [volume for volume in volumes if volume.animated]
    codes = [[frame.time_code for frame in volume.frames] for volume in animated]
    if time_code is None:
        return format_time_codes({code for each in codes for code in each})
    held = {held_time_code(each, time_code) for each in codes}
    return ",".join(format_time_code(code) for code in sorted(held))


def _unsaved(stage: Usd.Stage) -> list[str]:
    """Names of layers with edits that their files do not have."""
    layers: list[Sdf.Layer] = stage.GetUsedLayers()
    return sorted(layer.GetDisplayName() for layer in layers if layer.dirty and not layer.anonymous)


def _new_folder(stage_file: Path) -> Path:
    """A folder beside the stage that does not exist: NAME_look, NAME_look_2, ..."""
    first = stage_file.parent / f"{stage_file.stem}_look"
    folder, number = first, 2
    while folder.exists():
        folder, number = first.with_name(f"{first.name}_{number}"), number + 1
    return folder
