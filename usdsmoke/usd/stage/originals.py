"""The stage without its existing looks: the source of a result.

Layers are muted and variants are selected in memory only; no file changes.
"""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from pxr import Sdf, Tf, Usd, UsdVol

from usdsmoke.base.errors import StageError
from usdsmoke.base.naming import ASSET_SOURCE, ORIGINAL, VARIANT_SET
from usdsmoke.base.volume import EarlierLooks, StageSource
from usdsmoke.usd import schema
from usdsmoke.usd.diagnostics import captured_diagnostics
from usdsmoke.usd.field_samples import field_targets
from usdsmoke.usd.layer_record import record_values
from usdsmoke.usd.stage.opening import StageOrFile, open_stage
from usdsmoke.vdb.header import read_header

_MARK = "usdsmoke:run"  # in the metadata of every file that usdsmoke writes

_INSTEAD = "To start from the stylized smoke, set stage.restylize (--restylize)."


def open_source(
    file_path: str | os.PathLike[str], restylize: bool = False
) -> tuple[Usd.Stage, EarlierLooks]:
    """A stage without the looks that usdsmoke added, and what was left out.

    Where the file itself was made by usdsmoke, a root layer or an asset, the stage that it stands
    on is opened in its place. Other stages are opened as they are: of assets in them the variant
    ``original`` is selected, then look layers are muted, wherever in the stage they come in.

    Args:
        restylize: take it as it is.

    Raises:
        StageError: the stage, or the one that it was made from, cannot be opened; or it is a look
            layer without the smoke that it belongs to.
    """
    stage, notes = open_stage(file_path), []
    if is_look_layer(stage.GetRootLayer()) and not _field_names(stage):
        raise StageError(
            f"{os.fspath(file_path)} is a look layer alone, without the smoke that it belongs to. "
            "Give the stage that it was made for, or one that has both."
        )
    if restylize:
        return stage, EarlierLooks()
    seen = {_real_path(stage)}
    while base := _stands_on(stage.GetRootLayer()):
        before, stage = _real_path(stage), open_stage(base)
        notes.append(
            f"{before.name} is a result already: this one starts from {Path(base).name}. {_INSTEAD}"
        )
        if _real_path(stage) in seen:
            raise StageError(f"{before} records itself as its own source. Give the original stage.")
        seen.add(_real_path(stage))
    found = _leave_looks_out(stage)
    return stage, replace(found, notes=(*notes, *found.notes))


def _open_original(stage: StageOrFile) -> Usd.Stage:
    stage = _own_copy(stage)
    root = stage.GetRootLayer()
    if is_look_layer(root):
        raise StageError(
            f"{root.identifier} is a look layer itself, and USD cannot mute a stage's root layer. "
            "Use the root layer that was written beside it, NAME_look.usda."
        )
    if not _leave_looks_out(stage).layers:
        if lost := [path for path in root.subLayerPaths if _sublayer(root, path) is None]:
            raise StageError(
                f"{root.identifier} has sublayers that are missing or cannot be read: "
                f"{', '.join(lost)}. Restore them."
            )
        raise StageError(
            f"no layer of the stage {root.identifier} was made by usdsmoke, so it has no look. "
            "Use a root layer such as NAME_look.usda."
        )
    return stage


def open_look(stage: StageOrFile, name: str) -> Usd.Stage:
    """The stage with one look of the assets that have several, or without usdsmoke's looks.

    Args:
        stage: a file, or an open stage, which stays as it is.
        name: of the look, a variant of such assets, which is selected in the session layer.
            ``ORIGINAL``: none; look layers that are in use after that are muted.

    Raises:
        StageError: the stage cannot be opened, or no asset has a look of this name. For
            ``ORIGINAL``: no layer of it was made by usdsmoke, or its root layer was, which cannot
            be muted.
    """
    if name == ORIGINAL:
        return _open_original(stage)
    stage, is_there, others = _own_copy(stage), False, set[str]()
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for _, variants in _assets(stage):
            others |= set(variants.GetVariantNames())
            if variants.HasAuthoredVariant(name):
                is_there = variants.SetVariantSelection(name)
    if not is_there:
        found = f"found: {', '.join(sorted(others))}" if others else "no asset outside instances"
        raise StageError(
            f"no asset on the stage {stage.GetRootLayer().identifier} has a look {name} ({found}). "
            "Name one of its variants, or give the root layer of the look, NAME_look.usda."
        )
    return stage


def _own_copy(stage: StageOrFile) -> Usd.Stage:
    """A stage whose layers can be muted: of an open one, a second over the same layers."""
    if not isinstance(stage, Usd.Stage):
        return open_stage(stage)
    session = Sdf.Layer.CreateAnonymous()
    if stage.GetSessionLayer() is not None:
        session.TransferContent(stage.GetSessionLayer())
    copy = Usd.Stage.Open(stage.GetRootLayer(), session, stage.GetPathResolverContext())
    copy.MuteAndUnmuteLayers(stage.GetMutedLayers(), [])
    return copy


def _leave_looks_out(stage: Usd.Stage) -> EarlierLooks:
    """Select originals and mute looks of an open stage, in memory; what that has taken away.

    Args:
        stage: its session layer is written to.
    """
    with captured_diagnostics():
        used = stage.GetUsedLayers()
        files = tuple(sorted(layer.realPath for layer in used if _can_be_muted(layer, stage)))
        if not files:
            return EarlierLooks()
        before = _field_names(stage)
        variants = _select_originals(stage) if any(map(_is_asset, used)) else []
        looks = [layer.identifier for layer in stage.GetUsedLayers() if _can_be_muted(layer, stage)]
        stage.MuteAndUnmuteLayers(looks, [])  # which forgets the layers themselves
        after = _field_names(stage)
    taken = [f"<{path}>" for path in variants]
    taken += [Path(name).name for name in looks]
    note = (
        f"the stage already has a look ({', '.join(taken)}). It is left out of this run: the new "
        f"look starts from the original. {_INSTEAD}"
    )
    gone = {
        path: tuple(sorted(names - after.get(path, set())))
        for path, names in before.items()
        if names - after.get(path, set())
    }
    return EarlierLooks((note,), files, tuple(variants), gone)


def check_originals(stage: Usd.Stage, source: StageSource) -> None:
    """Refuse smoke that was stylized before and has no look layer that could be left out.

    That is so when a stage was flattened or its files were collected by hand. Of a Volume that is
    not marked as stylized only the first file is looked at.

    Raises:
        StageError: a density's file is a result of usdsmoke.
        GridError: a file cannot be read.
    """
    for volume in source.volumes:
        files = [frame.fields[volume.density].file_path for frame in volume.frames]
        is_marked = stage.GetPrimAtPath(volume.prim_path).HasAttribute(schema.RUN)
        for file_path in dict.fromkeys(files if is_marked else files[:1]):
            if _MARK in read_header(file_path).metadata:
                raise StageError(
                    f"the density of <{volume.prim_path}> is stylized already: {file_path} was "
                    "written by usdsmoke, and the stage has no look layer that could be left out, "
                    "as after flattening. Give the stage it was made from, or stylize the result "
                    "once more with stage.restylize (--restylize)."
                )


def is_look_layer(layer: Sdf.Layer) -> bool:
    """Whether a layer is a look that usdsmoke has authored."""
    return bool(record_values(layer))


def _sublayer(root: Sdf.Layer, path: str) -> Sdf.Layer | None:
    """A sublayer; None where it is missing or cannot be read."""
    try:
        with captured_diagnostics():
            return Sdf.Layer.FindOrOpenRelativeToLayer(root, path)
    except Tf.ErrorException:
        return None


def _real_path(stage: Usd.Stage) -> Path:
    return Path(stage.GetRootLayer().realPath).resolve()


def _stands_on(root: Sdf.Layer) -> str:
    """The source of a root layer or an asset of ours; "" for any other layer.

    A root layer that somebody has added prims or sublayers to is theirs.
    """
    source = root.customLayerData.get(ASSET_SOURCE, "")
    if not source and len(root.subLayerPaths) == 2 and not root.rootPrims:
        first = _sublayer(root, root.subLayerPaths[0])
        if first is not None and is_look_layer(first):
            source = root.subLayerPaths[1]
    return Sdf.ComputeAssetPathRelativeToLayer(root, source) if source else ""


def _can_be_muted(layer: Sdf.Layer, stage: Usd.Stage) -> bool:
    """Look layers, except a root that sublayers were flattened into."""
    return is_look_layer(layer) and layer != stage.GetRootLayer()


def _is_asset(layer: Sdf.Layer) -> bool:
    return ASSET_SOURCE in layer.customLayerData


def _field_names(stage: Usd.Stage) -> dict[str, set[str]]:
    """The names of all Volumes' field relationships, by prim path."""
    return {
        str(prim.GetPath()): set(field_targets(prim))
        for prim in stage.Traverse()
        if prim.IsA(UsdVol.Volume)
    }


def _select_originals(stage: Usd.Stage) -> list[str]:
    """Select the variant without a look of every asset of ours, in memory; the prims' paths."""
    chosen = []
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for prim, variants in _assets(stage):
            if variants.GetVariantSelection() not in ("", ORIGINAL):
                variants.SetVariantSelection(ORIGINAL)
                chosen.append(str(prim.GetPath()))
    return chosen


def _assets(stage: Usd.Stage) -> Iterator[tuple[Usd.Prim, Usd.VariantSet]]:
    """The assets of ours and their looks; a selection may add and remove prims meanwhile."""
    for prim in list(stage.TraverseAll()):
        if prim and _has_looks(prim):  # its own variants may have been its reason to be
            yield prim, prim.GetVariantSet(VARIANT_SET)


def _has_looks(prim: Usd.Prim) -> bool:
    """Whether an asset of ours has put its variant set on a prim."""
    return prim.HasVariantSets() and any(
        _is_asset(spec.layer) and VARIANT_SET in spec.variantSets.keys()
        for spec in prim.GetPrimStack()
    )
