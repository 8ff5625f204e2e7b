"""Opens a stage, checks its units, and finds its file, its layers and a prim by its path."""

import math
import os
from pathlib import Path
from typing import TypeAlias

from pxr import Ar, Sdf, Usd, UsdGeom

from usdsmoke.base.errors import StageError, UsdSmokeError
from usdsmoke.usd.diagnostics import check_is_stage, open_quietly
from usdsmoke.usd.schema import register_schema

StageOrFile: TypeAlias = str | os.PathLike[str] | Usd.Stage


def open_stage(stage: StageOrFile) -> Usd.Stage:
    """The composed stage of a .usda, .usdc, .usd or .usdz file, all payloads loaded.

    Raises:
        StageError: the file is missing, of no USD format, or cannot be parsed; or there is none.
    """
    check_is_stage(stage)
    register_schema()  # USD reads its schemas when the first stage is opened, and never again
    return stage if isinstance(stage, Usd.Stage) else open_quietly(os.fspath(stage))


def stage_file(stage: StageOrFile) -> Path:
    """The absolute path of a stage's file; an open stage must be as it is on disk.

    Raises:
        StageError: the open stage has no file, or holds edits that no file has; or there is none.
    """
    check_is_stage(stage)
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
    if part := _seen_otherwise(stage):
        raise StageError(
            f"the stage {root.identifier} {part}, and its file, which the run reads, shows "
            "something else. Open the stage as it is in the file, or give the file."
        )
    return Path(root.realPath)


def _seen_otherwise(stage: Usd.Stage) -> str:
    """How an open stage shows something else than its file does; "" where it does not."""
    everything = Usd.StagePopulationMask.All()
    if stage.GetPopulationMask() != everything:
        return "has a population mask"
    if not set(stage.FindLoadable()) <= set(stage.GetLoadSet()):
        return "has payloads that are not loaded"
    usual = Ar.GetResolver().CreateDefaultContextForAsset(stage.GetRootLayer().realPath)
    if stage.GetPathResolverContext() != usual:
        return "has a resolver context of its own"
    return ""


def check_units(stage: Usd.Stage) -> None:
    """Refuse rates and units that times and lengths cannot be divided by, and other up axes.

    Raises:
        StageError: one is not positive, or the up axis is neither Y nor Z.
    """
    found = {
        "timeCodesPerSecond": stage.GetTimeCodesPerSecond(),
        "framesPerSecond": stage.GetFramesPerSecond(),
        "metersPerUnit": UsdGeom.GetStageMetersPerUnit(stage),
    }
    for name, value in found.items():
        if not 0 < value < math.inf:
            raise StageError(
                f"{name} of {stage.GetRootLayer().identifier} is {value:g}. Author a positive "
                "number in the layer's metadata."
            )
    if (up := UsdGeom.GetStageUpAxis(stage)) not in (UsdGeom.Tokens.y, UsdGeom.Tokens.z):
        raise StageError(
            f'upAxis of {stage.GetRootLayer().identifier} is "{up}". Author Y or Z in the '
            "layer's metadata."
        )


def layer_files(stage: Usd.Stage) -> list[str]:
    """The files of all layers that a stage uses."""
    return [layer.realPath for layer in stage.GetUsedLayers() if layer.realPath]


def named_prim(
    stage: Usd.Stage, path: str, example: str, advice: str, error: type[UsdSmokeError]
) -> Usd.Prim:
    """The active prim at a path, of whatever type.

    Args:
        example: a path of the right form.
        advice: the last sentence of every message: what to choose from.

    Raises:
        UsdSmokeError: of the kind ``error``: no path of a prim, no such prim, or an inactive one.
    """
    if not (
        path.startswith("/") and Sdf.Path.IsValidPathString(path) and Sdf.Path(path).IsPrimPath()
    ):
        raise error(
            f"{path!r} is not a prim path. A path starts with '/', such as {example}. {advice}"
        )
    prim = stage.GetPrimAtPath(path)
    if not prim:
        raise error(f"there is no prim <{path}> on the stage. {advice}")
    if not prim.IsActive():
        raise error(f"the prim <{path}> is inactive. Activate it, or choose another. {advice}")
    return prim


def type_words(prim: Usd.Prim) -> str:
    """What type a prim has, as the middle of a message: "is of type Xform"."""
    return f"is of type {prim.GetTypeName()}" if prim.GetTypeName() else "is of no type"
