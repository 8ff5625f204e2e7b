"""The stage to open: the look over the source, with the source's own stage metadata.

USD takes upAxis, metersPerUnit, the time range and the like from a stage's root layer alone and
ignores those of sublayers, so every root that is written repeats them. Values the source leaves to
USD's defaults are spelt out: they mean the same and no longer depend on anybody's default.
"""

from pathlib import Path
from typing import Any

from pxr import Sdf, Usd, UsdGeom

from usdsmoke.base.naming import ASSET_SOURCE, relative_asset_path
from usdsmoke.usd.layer_record import RECORD_KEY

# Composition, the source's own story, and rights of its owner: they stay with the source.
_NOT_COPIED = (
    "subLayers",
    "subLayerOffsets",
    "layerRelocates",
    "primChildren",
    "primOrder",
    "comment",
    "documentation",
    "customLayerData",
    "hasOwnedSubLayers",
    "owner",
    "sessionOwner",
)


def copy_stage_metadata(stage: Usd.Stage, layer: Sdf.Layer, folder: Path) -> None:
    """Give ``layer`` the metadata of the source's root layer.

    Everything is copied that says how to look at a stage: units, axis, rates, range, default prim,
    expression variables, colour management, and what plug-ins have added. timeCodesPerSecond is
    always authored, because USD rescales the samples of a layer whose rate differs.

    Args:
        stage: the source.
        layer: to be written to ``folder``.
        folder: where ``layer`` will be.
    """
    root = stage.GetRootLayer()
    for key in root.pseudoRoot.ListInfoKeys():
        if key not in _NOT_COPIED:
            layer.pseudoRoot.SetInfo(key, _reanchored(root.pseudoRoot.GetInfo(key), root, folder))
    layer.pseudoRoot.SetInfo("upAxis", UsdGeom.GetStageUpAxis(stage))
    layer.pseudoRoot.SetInfo("metersPerUnit", UsdGeom.GetStageMetersPerUnit(stage))
    layer.timeCodesPerSecond = stage.GetTimeCodesPerSecond()
    layer.framesPerSecond = stage.GetFramesPerSecond()


def author_root(stage: Usd.Stage, look_layer: Path, folder: Path) -> Sdf.Layer:
    """A new layer for ``folder`` that puts the look over the source; ``customLayerData`` is kept.

    Args:
        stage: the source.
        look_layer: the override layer's file.
        folder: where the root will be.
    """
    source = stage.GetRootLayer()
    root = Sdf.Layer.CreateAnonymous(".usda")
    copy_stage_metadata(stage, root, folder)
    root.documentation = f"A stylized look over {Path(source.realPath).name}; made by usdsmoke."
    root.customLayerData = copied_layer_data(source, folder)
    root.subLayerPaths.append(relative_asset_path(look_layer, folder))
    root.subLayerPaths.append(relative_asset_path(source.realPath, folder))
    return root


def copied_layer_data(source: Sdf.Layer, folder: Path) -> dict[str, Any]:
    """``customLayerData`` of a source's root layer, for a layer in ``folder``."""
    copied: dict[str, Any] = _reanchored(source.customLayerData, source, folder)
    for key in (ASSET_SOURCE, RECORD_KEY):
        copied.pop(key, None)  # they describe that layer only
    return copied


def _reanchored(value: Any, layer: Sdf.Layer, folder: Path) -> Any:
    """``value`` with the asset paths in it spelt for a layer in ``folder``."""
    if isinstance(value, dict):
        return {key: _reanchored(item, layer, folder) for key, item in value.items()}
    if isinstance(value, Sdf.AssetPath) and value.path.startswith(("./", "../")):
        there = Sdf.ComputeAssetPathRelativeToLayer(layer, value.path)
        return Sdf.AssetPath(relative_asset_path(there, folder))
    return value
