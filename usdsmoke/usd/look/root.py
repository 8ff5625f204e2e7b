"""The stage to open: the look over the source, or an asset with a variant for every look.

USD takes upAxis, metersPerUnit, the time range and the like from a stage's root layer alone and
ignores those of sublayers, so every root that is written repeats them. Values the source leaves to
USD's defaults are spelt out: they mean the same and no longer depend on anybody's default.

In an asset, a variant is weaker than local opinions, so it can only replace opinions that come from
further away. The source's root prims are therefore referenced, one by one and under their own
paths, and the variants of the set ``look`` reference the look layers. ``original`` is empty.

A reference brings one root prim and what is below it. It drops targets and connections that lead to
other root prims (external targets), and parts of path expressions: the asset authors these again.
Opinions of a class that a prim inherits from come along with the prim. A reference to the class
itself would make them stronger than those of the inheriting prim.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pxr import Sdf, Tf, Usd, UsdGeom

from usdsmoke.base.errors import LayerError, StageError
from usdsmoke.base.naming import (
    ASSET_SOURCE,
    ORIGINAL,
    VARIANT_SET,
    find_look_layers,
    relative_asset_path,
)
from usdsmoke.usd.diagnostics import captured_diagnostics
from usdsmoke.usd.layer_record import RECORD_KEY, record_values
from usdsmoke.usd.values import anchored_asset

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
    expression variables, colour management, and what plug-ins have added; no default prim that is
    not there. timeCodesPerSecond is always authored, because USD rescales the samples of a layer
    whose rate differs.

    Args:
        folder: where ``layer`` will be.

    Raises:
        StageError: a value has another type than its key.
    """
    root = stage.GetRootLayer()
    left_out = {*_NOT_COPIED, *([] if stage.GetDefaultPrim() else ["defaultPrim"])}
    for key in root.pseudoRoot.ListInfoKeys():
        if key in left_out:
            continue
        value = root.pseudoRoot.GetInfo(key)
        try:
            layer.pseudoRoot.SetInfo(key, _reanchored(value, root, folder))
        except TypeError:  # a damaged file has a value of any type
            raise StageError(
                f"{key} of {root.identifier} has a value of another type ({value!s:.80}). Correct "
                "the layer's metadata."
            ) from None
    layer.pseudoRoot.SetInfo("upAxis", UsdGeom.GetStageUpAxis(stage))
    layer.pseudoRoot.SetInfo("metersPerUnit", UsdGeom.GetStageMetersPerUnit(stage))
    layer.timeCodesPerSecond = stage.GetTimeCodesPerSecond()
    layer.framesPerSecond = stage.GetFramesPerSecond()


def author_root(stage: Usd.Stage, look_layer: Path, folder: Path) -> Sdf.Layer:
    """A new layer for ``folder`` that puts the look over the source and keeps its layer data."""
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
    if isinstance(value, (list, Sdf.AssetPathArray)):
        return type(value)([_reanchored(item, layer, folder) for item in value])
    if isinstance(value, Sdf.AssetPath) and not os.path.isabs(value.path):
        return anchored_asset(value, layer, folder)
    return value


_EXPRESSION = Sdf.ValueTypeNames.PathExpression
_ADVICE = "Set layer.mode to sublayer (--mode sublayer), or"


@dataclass(frozen=True)
class _ExternalTargets:
    """What referencing root prims one by one takes."""

    roots: list[Usd.Prim] = field(default_factory=list)  # to be referenced, in the stage's order
    relationships: dict[Sdf.Path, list[Sdf.Path]] = field(default_factory=dict)  # leading out
    connections: dict[Sdf.Path, list[Sdf.Path]] = field(default_factory=dict)  # likewise
    expressions: dict[Sdf.Path, Sdf.PathExpression] = field(default_factory=dict)  # all


@dataclass(frozen=True)
class _Look:
    """A look layer of the folder, as far as the asset needs it."""

    file_path: Path
    roots: tuple[Sdf.Path, ...]  # root prims that it has opinions on
    relationships: Mapping[Sdf.Path, list[Sdf.Path]]  # that it authors, with their targets


def check_asset(stage: Usd.Stage) -> None:
    """Refuse a source that an asset cannot hold, before anything is computed.

    Raises:
        LayerError: a reference cannot carry the source (see ``_find_external_targets``), or a root
            prim already has a variant set called look.
    """
    _checked_targets(stage)


def _checked_targets(stage: Usd.Stage) -> _ExternalTargets:
    external = _find_external_targets(stage)
    for prim in external.roots:
        if prim.GetVariantSets().HasVariantSet(VARIANT_SET):
            raise LayerError(
                f"<{prim.GetPath()}> already has a variant set {VARIANT_SET!r}, which would clash "
                "with the looks of an asset. Set layer.mode to sublayer (--mode sublayer)."
            )
    return external


def author_asset(stage: Usd.Stage, look: str, look_layer: Path, folder: Path) -> Sdf.Layer:
    """A new layer for ``folder`` with all looks of this source that lie there as variants.

    Raises:
        LayerError: see ``check_asset``.
    """
    source, external = stage.GetRootLayer(), _checked_targets(stage)
    looks = {**_find_looks(folder, Path(source.realPath)), look: _read_look(look_layer)}
    layer = Sdf.Layer.CreateAnonymous(".usda")
    copy_stage_metadata(stage, layer, folder)
    path_to_source = relative_asset_path(source.realPath, folder)
    layer.documentation = (
        f"{Path(source.realPath).name} with its stylized looks as variants; written by "
        "usdsmoke and rewritten when a look is added."
    )
    layer.customLayerData = {**copied_layer_data(source, folder), ASSET_SOURCE: path_to_source}
    for prim in external.roots:
        spec = Sdf.CreatePrimInLayer(layer, prim.GetPath())
        reference = Sdf.Reference(path_to_source, prim.GetPath())
        spec.referenceList.prependedItems = [reference]
        if prim.GetMetadata("instanceable") and not prim.IsInstance():
            spec.instanceable = False  # without a reference it had no effect
    for path in sorted({path for item in looks.values() for path in item.roots}):
        _author_variants(Sdf.CreatePrimInLayer(layer, path), looks, look, folder)
    _author_targets(layer, stage, external, looks)
    return layer


def _find_looks(folder: Path, source_file: Path) -> dict[str, _Look]:
    """The looks of this source by name, in the order of names."""
    found = {}
    for file_path in find_look_layers(folder):
        try:
            with captured_diagnostics():
                layer = Sdf.Layer.OpenAsAnonymous(str(file_path), metadataOnly=True)
        except Tf.ErrorException:
            continue  # no layer
        record = record_values(layer)
        name, theirs = record.get("look", ""), record.get("stage", "")
        if name and theirs and (folder / theirs).resolve() == source_file.resolve():
            found[str(name)] = _read_look(file_path)
    return dict(sorted(found.items()))


def _read_look(file_path: Path) -> _Look:
    layer = Sdf.Layer.OpenAsAnonymous(str(file_path))
    relationships: dict[Sdf.Path, list[Sdf.Path]] = {}

    def visit(path: Sdf.Path) -> None:
        spec = layer.GetObjectAtPath(path)
        if isinstance(spec, Sdf.RelationshipSpec):
            relationships[path] = list(spec.targetPathList.explicitItems)

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return _Look(file_path, tuple(spec.path for spec in layer.rootPrims), relationships)


def _author_variants(
    spec: Sdf.PrimSpec, looks: Mapping[str, _Look], selected: str, folder: Path
) -> None:
    """The variant set on a root prim, the same names everywhere."""
    spec.variantSetNameList.prependedItems = [VARIANT_SET]
    spec.variantSelections[VARIANT_SET] = selected
    variants = Sdf.VariantSetSpec(spec, VARIANT_SET)
    Sdf.VariantSpec(variants, ORIGINAL)
    for name, look in looks.items():
        variant = Sdf.VariantSpec(variants, name)
        if spec.path in look.roots:
            reference = Sdf.Reference(relative_asset_path(look.file_path, folder), spec.path)
            variant.primSpec.referenceList.prependedItems = [reference]


def _author_targets(
    layer: Sdf.Layer, stage: Usd.Stage, external: _ExternalTargets, looks: Mapping[str, _Look]
) -> None:
    """Author what references drop: of the source, and of each look in its variant."""
    by_looks = {path for look in looks.values() for path in look.relationships}
    for path, targets in external.relationships.items():
        if path not in by_looks:
            _relationship(layer, path.GetPrimPath(), path, targets)
    for path in sorted(by_looks):
        source = external.relationships.get(path)
        said = {name: look.relationships.get(path, source) for name, look in looks.items()}
        for name, targets_there in {ORIGINAL: source, **said}.items():
            if targets_there and _leads_out(path, targets_there):
                _relationship(layer, _in_variant(path.GetPrimPath(), name), path, targets_there)
    for path, targets in external.connections.items():
        _attribute(layer, stage.GetAttributeAtPath(path)).connectionPathList.explicitItems = targets
    for path, expression in external.expressions.items():
        _attribute(layer, stage.GetAttributeAtPath(path)).default = expression


def _in_variant(prim_path: Sdf.Path, name: str) -> Sdf.Path:
    """The place of a prim's opinions in a variant of its root prim."""
    root = _root_of(prim_path)
    return prim_path.ReplacePrefix(root, root.AppendVariantSelection(VARIANT_SET, name))


def _relationship(
    layer: Sdf.Layer, owner: Sdf.Path, path: Sdf.Path, targets: list[Sdf.Path]
) -> None:
    spec = Sdf.RelationshipSpec(Sdf.CreatePrimInLayer(layer, owner), path.name, custom=False)
    spec.targetPathList.explicitItems = targets


def _attribute(layer: Sdf.Layer, composed: Usd.Attribute) -> Sdf.AttributeSpec:
    """The attribute's place in the layer; one with both a value and connections has one."""
    found = layer.GetAttributeAtPath(composed.GetPath())
    return found or Sdf.AttributeSpec(
        Sdf.CreatePrimInLayer(layer, composed.GetPrim().GetPath()),
        composed.GetName(),
        composed.GetTypeName(),
        composed.GetVariability(),
        composed.IsCustom(),
    )


def _find_external_targets(stage: Usd.Stage) -> _ExternalTargets:
    """The root prims of a stage, and what about them has to be said again.

    Raises:
        LayerError: something cannot be carried: a target that leads out of an instance and its root
            prim, or a root prim that is itself shown and that another one inherits from.
    """
    found = _ExternalTargets()
    bases: dict[Sdf.Path, Sdf.Path] = {}  # root prims: who inherits from them
    predicate = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)
    for prim in Usd.PrimRange.Stage(stage, predicate):
        if prim.HasAuthoredInherits():
            for path in prim.GetInherits().GetAllDirectInherits():
                if _root_of(path) != _root_of(prim.GetPath()):
                    bases.setdefault(_root_of(path), prim.GetPath())
        for item in prim.GetAuthoredProperties():
            _look_at(item, found)
    for prim in stage.GetPseudoRoot().GetAllChildren():
        if prim.GetPath() not in bases:
            found.roots.append(prim)
        elif prim.IsDefined() and not prim.IsAbstract():
            raise LayerError(
                f"cannot make an asset: <{bases[prim.GetPath()]}> inherits from "
                f"<{prim.GetPath()}>, which is not a class. {_ADVICE} make <{prim.GetPath()}> a "
                "class."
            )
    return found


def _root_of(path: Sdf.Path) -> Sdf.Path:
    """The root prim that a path lies in.

    >>> _root_of(Sdf.Path("/World/smoke.field:density"))
    Sdf.Path('/World')
    """
    return path.GetPrefixes()[0]


def _leads_out(prim_path: Sdf.Path, targets: list[Sdf.Path]) -> bool:
    """Whether a target lies in another root prim than ``prim_path``."""
    return any(_root_of(target) != _root_of(prim_path) for target in targets)


def _look_at(item: Usd.Property, found: _ExternalTargets) -> None:
    if isinstance(item, Usd.Relationship):
        targets, noted = item.GetTargets(), found.relationships
    else:
        targets = item.GetConnections() if item.HasAuthoredConnections() else []
        noted = found.connections
        is_expression = item.GetTypeName() == _EXPRESSION
        if is_expression and not item.GetPrim().IsInstanceProxy():
            found.expressions[item.GetPath()] = item.Get() or Sdf.PathExpression()
    if not targets or not _leads_out(item.GetPath(), targets):
        return
    if item.GetPrim().IsInstanceProxy():
        raise LayerError(
            f"cannot make an asset: <{item.GetPath()}> lies in an instance and points to "
            f"{', '.join(f'<{path}>' for path in targets)}, outside its root prim. {_ADVICE} put "
            "both below one root prim."
        )
    noted[item.GetPath()] = list(targets)
