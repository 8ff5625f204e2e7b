"""What is kept of a result: hashes of voxels and pixels, statistics, the structure of layers."""

import hashlib
import os
import platform
import re
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pxr import Sdf, Usd, UsdVol

from tests.baselines.inputs import openvdb

__all__ = ["circumstances", "layer_structure", "measure_picture", "measure_stage", "measure_vdb"]

PACKAGES = ("torch", "numpy", "scipy", "pillow")
FLAGS = ("avx2", "avx512f", "asimd", "sve")

# Names that hold a date, a run's identifier or the record of how a result was made.
_RECORD = re.compile(r"authorship:|usdSmoke:run$|usdSmoke:style$")
_RUN_FOLDER = re.compile(r"(vdb/)[^/@]+/(?=[^/]+$)")
_PRIM_FIELDS = ("specifier", "typeName", "active", "kind", "variantSelection", "instanceable")
_LAYER_FIELDS = (
    "defaultPrim", "upAxis", "metersPerUnit", "startTimeCode", "endTimeCode",
    "timeCodesPerSecond", "framesPerSecond",
)  # fmt: skip


def circumstances() -> dict[str, str]:
    """What the bits of a result depend on beside its inputs and the code."""
    found = {"model name": "", "cpu family": "", "model": "", "flags": "", "Features": ""}
    cpuinfo = Path("/proc/cpuinfo")
    for line in cpuinfo.read_text().splitlines() if cpuinfo.is_file() else ():
        name, _, value = (part.strip() for part in line.partition(":"))
        if name in found and not found[name]:
            found[name] = value
    flags = [flag for flag in FLAGS if flag in f"{found['flags']} {found['Features']}".split()]
    model = [found["model name"] or platform.processor(), found["cpu family"], found["model"]]
    versions = {name: metadata.version(name) for name in PACKAGES}
    return {
        "processor": " ".join([platform.machine(), *model, *flags]),
        "capability": os.environ.get("ATEN_CPU_CAPABILITY", "default"),
        "openvdb": ".".join(str(number) for number in openvdb().LIBRARY_VERSION),
        **versions,
    }


def measure_vdb(file_path: str | Path) -> dict[str, Any]:
    """Hash and statistics of a VDB file, and what each of its grids is."""
    digest, described = hashlib.sha256(), {}
    grids, _ = openvdb().readAll(str(file_path))
    for grid in sorted(grids, key=lambda item: item.name):
        first, values = _dense(grid)
        background = np.asarray(grid.background, np.float32)
        used = np.any(values != background, axis=-1) if values.ndim == 4 else values != background
        shape = {
            "kind": grid.valueTypeName,
            "class": grid.gridClass,
            "vector": grid.vectorType if values.ndim == 4 else "",
            "half": bool(grid.saveFloatAsHalf),
            "background": background.tolist(),
            "to_world": _to_world(grid.transform),
        }
        digest.update(repr((grid.name, sorted(shape.items()))).encode())
        places = np.argwhere(used) + first
        for array in (places.astype("<i8"), values[used].astype("<f4") + np.float32(0)):
            digest.update(f"{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
        described[grid.name] = {**shape, "statistics": _statistics(values, first)}
        digest.update(str(grid.activeVoxelCount()).encode())
    return {"hash": digest.hexdigest(), "grids": described}


def _dense(grid: Any) -> tuple[np.ndarray, np.ndarray]:
    """First index of the active box, and its values."""
    low, high = grid.evalActiveVoxelBoundingBox()
    shape = [max(0, int(b) - int(a) + 1) for a, b in zip(low, high, strict=True)]
    is_vector = isinstance(grid.background, (tuple, list))
    if 0 in shape:
        return np.zeros(3, int), np.zeros((0, 0, 0, 3) if is_vector else (0, 0, 0), np.float32)
    values = np.empty((*shape, 3) if is_vector else shape, np.float32)
    grid.copyToArray(values, ijk=low)
    return np.asarray(low), values


def _to_world(transform: Any) -> list[list[float]]:
    corner = np.asarray(transform.indexToWorld((0.0, 0.0, 0.0)))
    rows = [np.asarray(transform.indexToWorld(tuple(axis))) - corner for axis in np.eye(3)]
    return [[float(f"{number:.8g}") + 0.0 for number in row] for row in (*rows, corner)]


def _statistics(values: np.ndarray, first: np.ndarray) -> dict[str, Any]:
    """Sums, centre of mass in voxels, and the means of 3 x 3 x 3 blocks, channel by channel."""
    if values.size == 0:
        return {"sum": [], "centre": [], "blocks": []}
    wide = values.astype(np.float64).reshape(*values.shape[:3], -1)
    amount = np.abs(wide).sum(axis=-1)
    centre = [
        float((np.moveaxis(amount, axis, 0).sum(axis=(1, 2)) * (np.arange(n) + first[axis])).sum())
        / (amount.sum() or 1.0)
        for axis, n in enumerate(amount.shape)
    ]
    return {
        "sum": _plain(wide.sum(axis=(0, 1, 2))),
        "centre": _plain(np.asarray(centre)),
        "blocks": _plain(_blocks(wide, 3)),
    }


def _blocks(values: np.ndarray, n_axes: int) -> np.ndarray:
    """Means over a third of each of the first axes; the channels come last."""
    for axis in range(n_axes):
        parts = np.array_split(values, 3, axis=axis)
        kept = [part.mean(axis=axis, keepdims=True) for part in parts if part.shape[axis]]
        values = np.concatenate(kept, axis=axis)
    return values.ravel()


def _plain(values: np.ndarray) -> list[float]:
    return [float(f"{number:.5g}") for number in np.asarray(values).ravel()]


def measure_picture(file_path: str | Path) -> dict[str, Any]:
    """Hash and statistics of a picture's pixels; of an OpenEXR file all channels by name."""
    file_path = Path(file_path)
    if file_path.suffix == ".exr":
        import OpenEXR

        with OpenEXR.File(str(file_path), separate_channels=True) as file:
            channels = {name: item.pixels.copy() for name, item in file.channels().items()}
        names, pixels = sorted(channels), np.stack([channels[n] for n in sorted(channels)], -1)
    else:
        with Image.open(file_path) as picture:
            names, pixels = [picture.mode], np.asarray(picture)
    data = (
        f"{names} {pixels.dtype} {pixels.shape}".encode() + np.ascontiguousarray(pixels).tobytes()
    )
    wide = pixels.astype(np.float64).reshape(*pixels.shape[:2], -1)
    return {
        "hash": hashlib.sha256(data).hexdigest(),
        "channels": names,
        "size": list(pixels.shape[1::-1]),
        "statistics": {"sum": _plain(wide.sum(axis=(0, 1))), "blocks": _plain(_blocks(wide, 2))},
    }


def measure_stage(stage_file: Path) -> dict[str, Any]:
    """Each file that a stage's Volumes show at each timeCode, and which grid each field names.

    Files below the stage's folder belong to the result and are measured.
    """
    stage = Usd.Stage.Open(str(stage_file))
    measured: dict[Path, dict[str, Any]] = {}
    shown: dict[str, Any] = {}
    for prim in stage.Traverse():
        if not prim.IsA(UsdVol.Volume):
            continue
        for name, path in sorted(UsdVol.Volume(prim).GetFieldPaths().items()):
            field = UsdVol.OpenVDBAsset(stage.GetPrimAtPath(path))
            files = field.GetFilePathAttr()
            for code in [*files.GetTimeSamples(), None]:
                asset = files.Get() if code is None else files.Get(code)
                if asset is None:
                    continue
                shown_file = Path(asset.resolvedPath)
                ours = shown_file.is_relative_to(stage_file.parent)
                if ours and shown_file not in measured:
                    measured[shown_file] = measure_vdb(shown_file)
                kind, grid = "result" if ours else "source", field.GetFieldNameAttr().Get()
                label = f"{kind} {shown_file.name} {grid}"
                shown.setdefault(f"{prim.GetPath()} {name}", {})[str(code)] = label
    files_by_name = {path.name: found for path, found in measured.items()}
    assert len(files_by_name) == len(measured), sorted(measured)
    return {"shown": shown, "files": dict(sorted(files_by_name.items()))}


def layer_structure(layer_file: Path) -> dict[str, Any]:
    """Prims, variants and properties of a layer with their values, by path.

    Dates, identifiers of runs and records of how the result was made are left out. Folders that
    are named after a run are replaced.
    """
    layer = Sdf.Layer.FindOrOpen(str(layer_file))
    root = layer.pseudoRoot
    found: dict[str, Any] = {
        "/": {name: _value(root.GetInfo(name)) for name in _LAYER_FIELDS if root.HasInfo(name)}
    }
    found["/"]["subLayers"] = [_asset(path) for path in layer.subLayerPaths]
    for prim in _prims(root):
        found[str(prim.path)] = _prim(prim)
        for item in prim.properties:
            if not _RECORD.match(item.name):
                found[str(item.path)] = _property(item)
    return found


def _prims(prim: Sdf.PrimSpec) -> Iterator[Sdf.PrimSpec]:
    for child in prim.nameChildren:
        yield child
        yield from _prims(child)
    for variants in getattr(prim, "variantSets", {}).values():
        for variant in variants.variants.values():
            yield variant.primSpec
            yield from _prims(variant.primSpec)


def _prim(prim: Sdf.PrimSpec) -> dict[str, Any]:
    told = {name: _value(prim.GetInfo(name)) for name in _PRIM_FIELDS if prim.HasInfo(name)}
    schemas = prim.GetInfo("apiSchemas").GetAppliedItems() if prim.HasInfo("apiSchemas") else []
    told["apiSchemas"] = [re.sub("^AuthorshipAPI:.*", "AuthorshipAPI:*", name) for name in schemas]
    told["variantSets"] = list(prim.variantSetNameList.GetAppliedItems())
    for name, arcs in (("references", prim.referenceList), ("payloads", prim.payloadList)):
        told[name] = [
            [
                _asset(arc.assetPath),
                str(arc.primPath),
                arc.layerOffset.offset,
                arc.layerOffset.scale,
            ]
            for arc in arcs.GetAppliedItems()
        ]
    return {name: value for name, value in told.items() if value not in ([], None)}


def _property(item: Any) -> dict[str, Any]:
    if isinstance(item, Sdf.RelationshipSpec):
        targets = [str(path) for path in item.targetPathList.GetAppliedItems()]
        return {"custom": item.custom, "targets": targets}
    told = {
        "type": str(item.typeName),
        "custom": item.custom,
        "variability": str(item.variability),
        "connections": [str(path) for path in item.connectionPathList.GetAppliedItems()],
    }
    if item.HasDefaultValue():
        told["default"] = _value(item.default)
    samples = item.layer.ListTimeSamplesForPath(item.path)
    if samples:
        told["samples"] = {
            str(code): _value(item.layer.QueryTimeSample(item.path, code)) for code in samples
        }
    return told


def _asset(path: str) -> str:
    return _RUN_FOLDER.sub(r"\1*/", path)


def _value(value: Any) -> Any:
    """A value of USD as JSON; floats with six digits."""
    if isinstance(value, (bool, int, str)) or value is None:
        return value
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, Sdf.AssetPath):
        return {"asset": _asset(value.path)}
    if isinstance(value, (Sdf.ValueBlock, Sdf.Specifier)):
        return "blocked" if isinstance(value, Sdf.ValueBlock) else str(value)
    if isinstance(value, dict):
        return {str(key): _value(item) for key, item in sorted(value.items())}
    try:
        return [_value(item) for item in value]
    except TypeError:
        return str(value)
