"""The command that stylizes Volumes of an open stage, as text to paste into a terminal."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pxr import Sdf, Usd

from usdsmoke.config import StageConfig
from usdsmoke.errors import StageError
from usdsmoke.run_folder import find_runs
from usdsmoke.stage import find_volumes
from usdsmoke.time_codes import format_time_code, format_time_codes
from usdsmoke.usdview.looks import Look, find_looks, looks_of, shown_run
from usdsmoke.volume import VolumeSource

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

    Where the Volumes show a look whose run left its record in the folder of the result, the stage
    and the style images are those of that run; else the stage is the open one. The output folder
    is a new one beside the stage.

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
    looks = looks_of(volumes, find_looks(stage))
    runs = {shown_run(volume) for volume in volumes}
    shown = next((look for look in looks if look.run in runs), looks[-1] if looks else None)
    stage_file, styles, notes = _asked_for(shown, Path(root.realPath))
    if not styles:
        styles = [NO_STYLE]
        notes.append(f"{NO_STYLE} stands for your style image")
    if unsaved := _unsaved(stage):
        notes.append(f"unsaved edits are not in the command's stage: {', '.join(unsaved)}")
    words = ["usdsmoke", "stylize", str(stage_file)]
    words += [word for path in paths for word in ("--prim", path)]
    if any(volume.animated for volume in source.volumes):
        words += ["--frames", _frames(source.volumes, time_code)]
    words += [word for style in styles for word in ("--style", style)]
    words += ["-o", str(_new_folder(stage_file))]
    return CommandText(shlex.join(words), tuple(notes))


def _asked_for(look: Look | None, root_file: Path) -> tuple[Path, list[str], list[str]]:
    """The stage and the styles that a look was made from, as far as it is known, and notes."""
    if look is None:
        return root_file, [], []
    folder = Path(look.layer.realPath).parent
    for run in find_runs(folder):
        if run.run_id == look.run and run.request:
            files = [run.request["stage"], *run.request["styles"]]
            stage_file, *styles = [(folder / name).resolve() for name in files]
            return stage_file, [str(style) for style in styles], []
    names = [str(text).rpartition("=")[0] for text in look.record.get("styles", [])]
    notes = [f"{root_file.name} shows a look already; stylize its source where you can"]
    if names:
        notes.append("of the style images only the names are known")
    return root_file, names, notes


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
