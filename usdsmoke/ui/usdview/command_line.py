"""The command that stylizes Volumes of an open stage, as text to paste into a terminal."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pxr import Sdf, Usd

from usdsmoke.base.errors import StageError
from usdsmoke.base.sections import StageConfig
from usdsmoke.base.time_codes import format_time_code, format_time_codes
from usdsmoke.base.volume import VolumeSource
from usdsmoke.ui.usdview.look_request import LookRequest, read_look_request
from usdsmoke.ui.usdview.looks import Look, find_looks, looks_of, shown_run
from usdsmoke.usd.stage import find_volumes

__all__ = ["NO_STYLE", "CommandText", "stylize_command"]

NO_STYLE = "STYLE.png"  # where nothing tells which image


@dataclass(frozen=True)
class CommandText:
    """A command line and what to know before it is run."""

    command: str
    notes: tuple[str, ...] = ()


def stylize_command(
    stage: Usd.Stage, volumes: Sequence[Usd.Prim], time_code: float | None
) -> CommandText:
    """``usdsmoke stylize`` for Volumes of an open stage, quoted for a POSIX shell.

    Where the Volumes have a look, the stage, the style images and the settings are those that it
    was made with, as far as its record tells; else the stage is the open one, and Volumes that name
    images themselves get no others. The output folder is a new one beside the stage.

    Args:
        stage: the open stage; its root layer needs a file.
        volumes: prims of it, one at least.
        time_code: the frame that is held at this timeCode, or the first; None takes all frames.

    Raises:
        StageError: the stage has no file, or a Volume's files cannot be found.
    """
    root = stage.GetRootLayer()
    if root.anonymous or not root.realPath:
        raise StageError(f"the stage {root.identifier} has no file; save it first")
    paths = [str(volume.GetPath()) for volume in volumes]
    source = find_volumes(stage, StageConfig(prims=paths))
    look, root_file = _shown_look(stage, volumes), Path(root.realPath)
    request = LookRequest(root_file, (), {})
    notes: list[str] = []
    if look is not None:
        request, notes = _of_look(read_look_request(look), root_file)
    elif not all(volume.request.styles for volume in source.volumes):
        request = replace(request, styles=(NO_STYLE,))
        notes = [f"{NO_STYLE} stands for your style image"]
    if unsaved := _unsaved(stage):
        notes.append(f"unsaved edits are not in the command's stage: {', '.join(unsaved)}")
    words = ["usdsmoke", "stylize", str(request.stage_file)]
    words += [word for path in paths for word in ("--prim", path)]
    if any(volume.animated for volume in source.volumes):
        words += ["--frames", _frames(source.volumes, time_code)]
    words += [word for style in request.styles for word in ("--style", style)]
    own = _own_settings(source.volumes) - request.explicit
    for name, value in request.settings.items():
        if name not in own:  # an option is stronger than what a Volume asks for
            words += ["--set", f"{name}={json.dumps(value, ensure_ascii=False)}"]
    words += ["-o", str(_new_folder(request.stage_file or root_file))]
    return CommandText(shlex.join(words), tuple(notes))


def _shown_look(stage: Usd.Stage, volumes: Sequence[Usd.Prim]) -> Look | None:
    """The look that the Volumes show, or the newest that they could show."""
    looks = looks_of(volumes, find_looks(stage))
    runs = {shown_run(volume) for volume in volumes}
    return next((look for look in looks if look.run in runs), looks[-1] if looks else None)


def _of_look(request: LookRequest, stage_file: Path) -> tuple[LookRequest, list[str]]:
    """What a look was asked for, with its stage in any case, and notes on what is not known."""
    notes = []
    if request.stage_file is None:
        notes.append(f"{stage_file.name} has a look already; name its source where you can")
    if any(not Path(style).is_file() for style in request.styles):
        notes.append("a style image is not where it was; correct its path")
    return replace(request, stage_file=request.stage_file or stage_file), notes


def _own_settings(volumes: Sequence[VolumeSource]) -> set[str]:
    """Settings that a Volume's prim asks for, as section.key."""
    requests = [volume.request.settings for volume in volumes]
    return {f"{section}.{key}" for one in requests for section in one for key in one[section]}


def _frames(volumes: Sequence[VolumeSource], time_code: float | None) -> str:
    """The selection of frames: all, or those that are held at a timeCode."""
    animated = [volume for volume in volumes if volume.animated]
    codes = [[frame.time_code for frame in volume.frames] for volume in animated]
    if time_code is None:
        return format_time_codes({code for each in codes for code in each})
    held = {max((code for code in each if code <= time_code), default=each[0]) for each in codes}
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
