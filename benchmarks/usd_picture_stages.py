"""What `benchmarks.usd_pictures` draws: a sequence, its look switched off, and single frames of it.

The sequence is small and stylized in its middle only, so there is a frame before and a frame after
the look. Nothing that is authored here touches a file of the result.
"""

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

from benchmarks.client_stages import author_overlay
from usdsmoke import pipeline
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.vdb.write import write_frame

__all__ = [
    "Case",
    "author_original_stage",
    "author_shot_stage",
    "author_stage_without_looks",
    "author_still_stage",
    "files_shown",
    "make_cases",
]

LOOK_SET, ORIGINAL = "look", "original"  # variant set and variant of an asset
GREY_COLOUR = 0.5  # of smoke without an emission, as `usdsmoke preview` shows it


@dataclass(frozen=True)
class Case:
    """One picture that every program draws."""

    title: str
    stage_file: Path
    frame: int


def make_cases(result: Path, shot: str, mode: str, first: int, last: int) -> list[Case]:
    """The look, the look switched off, the frame before and the frame after it.

    Args:
        result: output folder of a stylization of the frames first to last.
        shot: name of the source stage without its suffix.
        mode: ``reference`` or ``sublayer``: which root stage of the result is drawn.

    Raises:
        UsdSmokeError: the result cannot be put together in this mode.
        ValueError: the mode makes no stage.
    """
    root = pipeline.assemble(result, mode=mode).root_stage
    if root is None:
        raise ValueError(f"mode {mode!r} makes no stage to draw; wanted reference or sublayer")
    middle, off = (first + last) // 2, result.parent / f"{shot}_{mode}_off.usda"
    if mode == "reference":
        original = Case(f"variant {ORIGINAL}", author_original_stage(root, off), middle)
    else:
        original = Case("look layer off", author_stage_without_looks(root, off), middle)
    return [
        Case("the look", root, middle),
        original,
        Case("frame before", root, first - 1),
        Case("frame after", root, last + 1),
    ]


def author_shot_stage(source_file: Path, shot_file: Path, camera_path: str) -> Path:
    """A shot over the plume whose camera is nearer, so that the smoke fills its square picture."""
    shot_file.unlink(missing_ok=True)
    stage = author_overlay(source_file, shot_file)
    camera = UsdGeom.Camera.Get(stage, camera_path)
    UsdGeom.XformCommonAPI(camera).SetTranslate(Gf.Vec3d(0.0, 0.72, 5.0))
    camera.GetFocalLengthAttr().Set(68.0)
    layer = stage.GetRootLayer()
    relative = os.path.relpath(source_file.resolve(), shot_file.resolve().parent)
    layer.subLayerPaths = [f"./{Path(relative).as_posix()}"]
    layer.Save()
    return shot_file


def author_original_stage(asset_file: Path, out_file: Path) -> Path:
    """A stage over an asset of looks in which every root prim that has looks shows the original."""
    stage = author_overlay(asset_file, out_file)
    for prim in stage.GetPseudoRoot().GetChildren():
        if LOOK_SET in prim.GetVariantSets().GetNames():
            prim.GetVariantSet(LOOK_SET).SetVariantSelection(ORIGINAL)
    stage.GetRootLayer().Save()
    return out_file


def author_stage_without_looks(root_file: Path, out_file: Path) -> Path:
    """A root stage with all sublayers of another one but its looks.

    It composes as the other one with its looks muted; programs that are given a file alone cannot
    be told to mute.
    """
    root = Sdf.Layer.FindOrOpen(str(root_file))
    layer = Sdf.Layer.CreateNew(str(out_file))
    layer.TransferContent(root)
    kept = [root.ComputeAbsolutePath(path) for path in root.subLayerPaths]
    layer.subLayerPaths = [path for path in kept if not _is_look(path)]
    layer.Save()
    return out_file


def author_still_stage(case: Case, out_file: Path, gamma_w: float) -> Path:
    """The case's frame as a stage that does not change in time, smoke without emission in grey.

    Where the frame has an emission, its fields name the result's own file, nothing else. Where it
    has none, a file beside ``out_file`` holds the density and the emission 0.5 gamma_w density:
    what the preview takes for such smoke, so that the other programs can be given the same.

    Args:
        gamma_w: extinction per density, 1/stage unit.
    """
    stage = author_overlay(case.stage_file, out_file)
    for prim in list(stage.Traverse()):
        if not prim.IsA(UsdVol.Volume):
            continue
        volume = UsdVol.Volume(prim)
        files = {
            name: UsdVol.OpenVDBAsset.Get(stage, path).GetFilePathAttr().Get(case.frame)
            for name, path in volume.GetFieldPaths().items()
        }
        for name in set(files) - {"density", "emission"}:
            volume.BlockFieldRelationship(name)
        if "emission" not in files or files["emission"].path != files["density"].path:
            grey = _write_grey(Path(files["density"].resolvedPath), out_file, gamma_w)
            files = dict.fromkeys(("density", "emission"), Sdf.AssetPath(str(grey)))
        for name in ("density", "emission"):
            path = volume.GetFieldPath(name) or prim.GetPath().AppendChild(name)
            asset = UsdVol.OpenVDBAsset.Define(stage, path)
            asset.CreateFieldNameAttr(name)
            asset.CreateFilePathAttr(Sdf.AssetPath(files[name].resolvedPath or files[name].path))
            volume.CreateFieldRelationship(name, path)
    stage.GetRootLayer().Save()
    return out_file


def _is_look(layer_path: str) -> bool:
    layer = Sdf.Layer.FindOrOpen(layer_path)
    return layer is not None and "usdsmoke" in layer.customLayerData


def _write_grey(vdb_file: Path, out_file: Path, gamma_w: float) -> Path:
    """The file's density and an even grey emission, beside ``out_file``."""
    (density,) = read_grids(vdb_file, [GridRequest("density", components=1)], GridsConfig())
    light = GREY_COLOUR * gamma_w * np.maximum(density.values, 0.0)
    emission = replace(
        density,
        name="emission",
        grid_class="unknown",
        values=np.repeat(light[..., None], 3, axis=-1).astype(np.float32),
        background=(0.0, 0.0, 0.0),
    )
    grey_file = out_file.with_suffix(".vdb")
    write_frame(grey_file, [density, emission], {}, half=False)
    return grey_file


def files_shown(case: Case) -> list[str]:
    """Names of the VDB files that USD shows for the case's density and emission."""
    stage = Usd.Stage.Open(str(case.stage_file))
    found = []
    for prim in stage.Traverse():
        if prim.IsA(UsdVol.OpenVDBAsset) and prim.GetName() in ("density", "emission"):
            file = UsdVol.OpenVDBAsset(prim).GetFilePathAttr().Get(case.frame)
            found.append(Path(file.resolvedPath or file.path).name)
    return list(dict.fromkeys(found))
