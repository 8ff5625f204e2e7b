"""The Volume's extent over time: without one nothing frames or culls the smoke rightly."""

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.base.volume import WrittenFrame
from usdsmoke.usd.field_samples import FieldSamples
from usdsmoke.usd.look.records import StylizedVolume
from usdsmoke.usd.values import Box, ancestors, extent_value, held_extents, union_of, value_at
from usdsmoke.vdb.boxes import corners_extent
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import GridRequest, find_grid


def author_extent(
    volume_spec: Sdf.PrimSpec,
    volume_prim: Usd.Prim,
    density: Usd.Prim,
    volume: StylizedVolume,
) -> None:
    """Author ``extent`` on the Volume: one default where it never changes, else time samples too.

    See ``held_extents``. A Volume that is empty at every timeCode gets no extent.
    """
    boxes = volume_boxes(volume_prim, density, volume)
    all_boxes = union_of(list(boxes.values()))
    if all_boxes is None:
        return
    attribute = Sdf.AttributeSpec(volume_spec, "extent", Sdf.ValueTypeNames.Float3Array)
    attribute.default = extent_value(*all_boxes)
    extents = held_extents(boxes)
    if all(value == attribute.default for value in extents.values()):
        return
    for code, value in extents.items():
        volume_spec.layer.SetTimeSample(attribute.path, code, value)


def volume_boxes(
    volume_prim: Usd.Prim, density: Usd.Prim, volume: StylizedVolume
) -> dict[float, Box | None]:
    """What the Volume shows at each timeCode, as boxes in its local space; None where it is empty.

    A stylized timeCode has its file's box, joined with the source's extent when the Volume has
    other fields. Another timeCode has the source's extent, or, where it has none, the box that the
    header of its file names; where that is missing too, the union of all stylized boxes.
    """
    extent = volume_prim.GetAttribute("extent")
    codes = {
        *volume.source.time_codes,
        *_relative_codes(density, volume_prim),
        *extent.GetTimeSamples(),
    }
    boxes: dict[float, Box | None] = {}
    unknown = []
    for code in sorted(codes):
        theirs = _source_box(extent, code)
        frame = volume.frame_at(code)
        if frame is not None:
            ours = _frame_box(frame, _density_to_volume(density, volume_prim, code))
            others = volume.source.other_fields or volume.source.copied
            boxes[code] = union_of([ours, theirs if others else None])
        elif theirs is not None:
            boxes[code] = theirs
        elif (source := _header_box(density, volume_prim, code)) is not None:
            boxes[code] = source
        else:
            unknown.append(code)
    stylized = union_of(list(boxes.values()))
    boxes.update(dict.fromkeys(unknown, stylized))
    return boxes


def _header_box(density: Usd.Prim, volume_prim: Usd.Prim, code: float) -> Box | None:
    """The box of the source's grid as its file's header names it; None where it does not."""
    sample, matrix = FieldSamples(density).at(code), _density_to_volume(density, volume_prim, code)
    try:
        grid = find_grid(
            read_header(sample.file_path), GridRequest(sample.grid_name, sample.grid_index)
        )
    except UsdSmokeError:
        return None
    if grid.extent is None or matrix is None:
        return None
    return corners_extent(*grid.extent, matrix)


def _frame_box(frame: WrittenFrame, density_to_volume: np.ndarray | None) -> Box | None:
    """The box around a frame's eight transformed corners."""
    if frame.extent_min is None or frame.extent_max is None or density_to_volume is None:
        return None
    return corners_extent(frame.extent_min, frame.extent_max, density_to_volume)


def _density_to_volume(density: Usd.Prim, volume: Usd.Prim, time_code: float) -> np.ndarray | None:
    """Row-vector matrix from the field prim's local space to the Volume's; None if it has none."""
    xforms = UsdGeom.XformCache(time_code)
    if density.GetPath().HasPrefix(volume.GetPath()):
        matrix, resets = xforms.ComputeRelativeTransform(density, volume)
        if not resets:
            return np.array(matrix)
    volume_to_stage = xforms.GetLocalToWorldTransform(volume)
    if abs(volume_to_stage.GetDeterminant()) < np.finfo(np.float64).tiny:
        return None  # scaled to nothing at this moment, as things are that grow from a point
    return np.array(xforms.GetLocalToWorldTransform(density) * volume_to_stage.GetInverse())


def _relative_codes(density: Usd.Prim, volume: Usd.Prim) -> set[float]:
    """Time samples of the xforms that move the field prim against the Volume."""
    chain = ancestors(density)
    if volume in chain:
        chain = chain[: chain.index(volume)]
    else:
        chain += ancestors(volume)
    return {
        code
        for prim in chain
        if prim.IsA(UsdGeom.Xformable)
        for code in UsdGeom.Xformable(prim).GetTimeSamples()
    }


def _source_box(extent: Usd.Attribute, time_code: float) -> Box | None:
    value = value_at(extent, time_code)
    if value is None or len(value) != 2:
        return None
    corners = np.array(value, dtype=np.float64)
    usable = np.isfinite(corners).all() and (corners[0] <= corners[1]).all()
    return (corners[0], corners[1]) if usable else None
