"""Attribute values; asset paths: what is wrong with one, and how a layer elsewhere spells it."""

import os
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pxr import Ar, Gf, Sdf, Usd, UsdGeom, Vt

from usdsmoke.base.naming import relative_asset_path
from usdsmoke.vdb.boxes import union_extent

Box = tuple[np.ndarray, np.ndarray]  # smallest and largest corner, [3] float64 each

_Value = TypeVar("_Value")


def value_at(attribute: Usd.Attribute, time_code: float | Usd.TimeCode) -> Any:
    """An attribute's value; None where it has none or is blocked.

    Before 26.03, OpenUSD returns the ``Sdf.ValueBlock`` itself between two blocked time samples.
    """
    value = attribute.Get(time_code)
    return None if isinstance(value, Sdf.ValueBlock) else value


def typed_value_at(
    attribute: Usd.Attribute, time_code: float | Usd.TimeCode, kind: type[_Value]
) -> _Value | None:
    """An attribute's value; None where it has none, or one of another type than its schema says.

    A layer may declare any type. OpenUSD's own validators name what differs from the schema.
    """
    value = value_at(attribute, time_code)
    return value if isinstance(value, kind) else None


def extent_value(low: np.ndarray, high: np.ndarray) -> Vt.Vec3fArray:
    """A box from its corners, [3] float64 each, as an ``extent``: rounded outwards to floats."""
    least, most = low.astype(np.float32), high.astype(np.float32)
    least = np.where(least > low, np.nextafter(least, np.float32(-np.inf)), least)
    most = np.where(most < high, np.nextafter(most, np.float32(np.inf)), most)
    return Vt.Vec3fArray([Gf.Vec3f(least.tolist()), Gf.Vec3f(most.tolist())])


def union_of(boxes: Iterable[Box | None]) -> Box | None:
    """The box around those that are known; None where none is."""
    known = [box for box in boxes if box is not None]
    return union_extent(known) if known else None


def held_extents(boxes: Mapping[float, Box | None]) -> dict[float, Vt.Vec3fArray]:
    """Time samples of an ``extent``, of files that are held from one timeCode to the next.

    USD interpolates extents linearly. Each sample therefore also encloses the box of the sample
    before it, so that what is shown lies inside at every moment in between.

    Args:
        boxes: by timeCode, smallest and largest corner; None where nothing is known.
    """
    whole, before = union_of(boxes.values()), None
    extents: dict[float, Vt.Vec3fArray] = {}
    for code in sorted(boxes):
        if box := union_of((before, boxes[code])) or whole:
            extents[code] = extent_value(*box)
        before = boxes[code]
    return extents


def ancestors(prim: Usd.Prim) -> list[Usd.Prim]:
    """A prim and all above it, without the pseudo-root."""
    found = []
    while prim and not prim.IsPseudoRoot():
        found.append(prim)
        prim = prim.GetParent()
    return found


def selected_variants(volume: Usd.Prim, without: str) -> dict[str, str]:
    """The variants that are selected on a Volume and the prims above it, by ``</prim>{set}``.

    Args:
        without: a variant set that is left out.
    """
    found = {}
    for prim in ancestors(volume):
        sets = prim.GetVariantSets()
        for name in sorted(set(sets.GetNames()) - {without}):
            found[f"<{prim.GetPath()}>{{{name}}}"] = sets.GetVariantSelection(name)
    return found


def authored_path(asset: Sdf.AssetPath) -> str:
    """The path as the layer spells it. Before 25.05, OpenUSD only keeps an expression's value."""
    return str(getattr(asset, "authoredPath", asset.path))


# how users of Houdini, Blender and Nuke write the number of a frame
FRAME_PATTERN = re.compile(r"#+|\$F\d*|%0?\d*d|<F\d*>")
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")  # two letters at least: C: is a drive


def vdb_problem(authored_path: str, file_path: str, attribute: Usd.Attribute | None = None) -> str:
    """Why a field's file cannot be opened, and what to do about it; "" when nothing is wrong.

    The text continues a sentence that names the path; only the path is looked at, not the file.

    Args:
        attribute: the ``filePath``, whose layer and stage say where the files are and in which
            units; None where only whether there is a problem matters.
    """
    if not authored_path and not file_path:
        return "it is empty. Author the path of a .vdb file."
    if authored_path.startswith("op:"):
        return (
            "that is a node inside Houdini, unknown outside it. "
            "Write the volumes to files there (USD ROP), and use the stage it writes."
        )
    if package := package_of(file_path) or package_of(authored_path):
        return f"that is {packed_problem(package)}"
    if not file_path and FRAME_PATTERN.search(authored_path):
        return (
            "OpenUSD expands no frame patterns. Author a time sample for each file or value clips, "
            f"or make a stage of the files: {_stage_command(authored_path, attribute)}."
        )
    if not file_path:
        return "there is no such file. Check the path, and whether the files were copied too."
    if os.path.isdir(file_path):
        return f"{file_path} is a folder. Author the path of a .vdb file."
    if not os.path.isfile(file_path):
        return (
            f"it resolves to {file_path}, where there is no file. Check the resolver and the disk."
        )
    return ""


def _stage_command(authored_path: str, attribute: Usd.Attribute | None) -> str:
    """The command that makes a stage of the files of a pattern, with this stage's units."""
    if attribute is None:
        return "usdsmoke stage"
    stage = attribute.GetStage()
    layer = _authoring_layer(attribute, Usd.TimeCode.EarliestTime())
    files = authored_path
    if layer is not None and not layer.anonymous:
        files = Sdf.ComputeAssetPathRelativeToLayer(layer, authored_path)
    units, up_axis = UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)
    return (
        f"usdsmoke stage {shlex.quote(files)} -o NEW.usda --meters-per-unit {units:g} "
        f"--up-axis {up_axis}"
    )


def package_of(path: str) -> str:
    """The file of the package (.usdz) that a path leads into; "" for a path of a plain file."""
    if not Ar.IsPackageRelativePath(path):
        return ""
    return str(Ar.SplitPackageRelativePathOuter(path)[0])


def packed_problem(package: str) -> str:
    """Why a field's file in a package cannot be opened, as the end of a sentence."""
    return (
        f"inside the package {package}, and OpenVDB reads plain files only. "
        "Unpack it (a .usdz is a zip), and use the stage inside."
    )


def file_name(path: str) -> str:
    """The last part of a path, which may lead into a package.

    >>> file_name("/shot/smoke.usdz[1/pyro.1001.vdb]")
    'pyro.1001.vdb'
    """
    if Ar.IsPackageRelativePath(path):
        path = str(Ar.SplitPackageRelativePathInner(path)[1])
    return os.path.basename(path)


def asset_value(
    attribute: Usd.Attribute, time_code: float | None, folder: Path
) -> Sdf.AssetPath | Sdf.ValueBlock:
    """A composed asset value, re-anchored to a layer in ``folder``; a block where there is none.

    Args:
        folder: of the layer that the value will stand in.
    """
    at = Usd.TimeCode.Default() if time_code is None else Usd.TimeCode(time_code)
    value = value_at(attribute, at)
    if value is None:
        return Sdf.ValueBlock()
    return anchored_asset(value, _authoring_layer(attribute, at), folder)


def anchored_asset(value: Sdf.AssetPath, layer: Sdf.Layer | None, folder: Path) -> Sdf.AssetPath:
    """An asset path of ``layer`` as a layer in ``folder`` has to spell it.

    Addresses of a resolver's own (``asset:...``) stay as they are; a path that resolves to nothing
    keeps pointing to the place where its file should be. Expressions are replaced by their value.
    A search path stays as it is where it leads to the same file from ``folder``.
    """
    authored = str(value.path)
    if not authored or _SCHEME.match(authored):
        return Sdf.AssetPath(authored)
    resolved = str(value.resolvedPath)
    if not resolved and layer is not None and not layer.anonymous:
        resolved = Sdf.ComputeAssetPathRelativeToLayer(layer, authored)
    if not os.path.isabs(resolved):
        return Sdf.AssetPath(authored)
    if _is_found_from(authored, resolved, folder):
        return Sdf.AssetPath(authored)
    return Sdf.AssetPath(relative_asset_path(resolved, folder))


def _is_found_from(authored: str, resolved: str, folder: Path) -> bool:
    """Whether a search path leads to a file from a layer in ``folder``."""
    if os.path.isabs(authored) or authored.startswith(("./", "../")):
        return False
    resolver = Ar.GetResolver()
    layer = Ar.ResolvedPath(str(folder / "look.usda"))
    found = str(resolver.Resolve(resolver.CreateIdentifier(authored, layer)))
    return bool(found) and os.path.normpath(found) == os.path.normpath(resolved)


def _authoring_layer(attribute: Usd.Attribute, at: Usd.TimeCode) -> Sdf.Layer | None:
    for spec in attribute.GetPropertyStack(at):
        if spec.HasInfo("timeSamples") or spec.HasInfo("default"):
            return spec.layer
    return None
