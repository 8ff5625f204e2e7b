"""Opening a stage, with usdSmoke's own schema known to USD."""

import os
from pathlib import Path
from typing import TypeAlias

from pxr import Usd

from usdsmoke.base.errors import StageError
from usdsmoke.usd.diagnostics import open_quietly
from usdsmoke.usd.schema import register_schema

__all__ = ["StageOrFile", "layer_files", "open_stage", "stage_file"]

StageOrFile: TypeAlias = str | os.PathLike[str] | Usd.Stage


def open_stage(file_path: str | os.PathLike[str]) -> Usd.Stage:
    """The composed stage of a .usda, .usdc, .usd or .usdz file, all payloads loaded.

    Raises:
        StageError: the file is missing, of no USD format, or cannot be parsed.
    """
    register_schema()  # the schema registry, built with the first stage, never looks again
    return open_quietly(os.fspath(file_path))


def stage_file(stage: StageOrFile) -> Path:
    """The absolute path of a stage's file; an open stage must be as it is on disk.

    Raises:
        StageError: the open stage has no file, or holds edits that no file has.
    """
    if isinstance(stage, (str, os.PathLike)):
        return Path(stage).absolute()
    root, session = stage.GetRootLayer(), stage.GetSessionLayer()
    if not root.realPath:
        raise StageError(
            f"the stage {root.identifier} exists in memory only. Export it and give the file."
        )
    layers = [layer for layer in stage.GetUsedLayers() if layer != session]
    unsaved = [layer.identifier for layer in layers if layer.dirty]
    if session is not None and not session.empty:
        unsaved.append(session.identifier)
    if unsaved:
        raise StageError(
            f"the stage {root.identifier} has unsaved edits (in {', '.join(unsaved)}). "
            "Save them, or export the stage and give the file."
        )
    if stage.GetMutedLayers():
        raise StageError(
            f"the stage {root.identifier} has muted layers ({', '.join(stage.GetMutedLayers())}). "
            "Unmute them, or export the stage and give the file."
        )
    return Path(root.realPath)


def layer_files(stage: Usd.Stage) -> list[str]:
    """The files of all layers that a stage uses."""
    return [layer.realPath for layer in stage.GetUsedLayers() if layer.realPath]
