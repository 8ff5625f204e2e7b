"""Rules on a Volume: its bounds, its fields together, and what it requests."""

from collections.abc import Iterator, Sequence

import numpy as np
from pxr import Gf, Usd, UsdVol

from usdsmoke.base.naming import COLOUR_CHANNELS, COLOUR_VECTORS
from usdsmoke.usd.field_samples import FieldSample, field_targets
from usdsmoke.usd.materials import (
    ALL_RENDERERS,
    brightness_words,
    find_materials,
    hiding_advice,
    hiding_material,
    hiding_words,
    opacity_words,
)
from usdsmoke.usd.rules.facts import (
    FieldFacts,
    Problem,
    Severity,
    collect_fields,
    field_to_stage,
    grouped,
    is_velocity,
    sample_grid,
)
from usdsmoke.usd.schema import EMISSION_MODE, EXTINCTION_PER_DENSITY, LOOK_API, STYLE_API
from usdsmoke.usd.units import is_stretched, units_since
from usdsmoke.usd.values import file_name
from usdsmoke.usd.volume_requests import has_request, ignored_attributes, request_problems

_COLOURS = (*COLOUR_VECTORS, *COLOUR_CHANNELS)
_SAME_UNITS = 1e-4  # of a factor on extinction and emission
_CLOSE = 1e-6  # of a matrix, relative to its largest element: what single precision can hold


def check_extent(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """The Volume has an extent; USD cannot work one out, and without it nothing frames it.

    Fields that are known to be empty at every moment need none.
    """
    if volume.GetAttribute("extent").HasAuthoredValue():
        return []
    shown = [sample for field in collect_fields(volume, interval) for sample in field.samples]
    grids = map(sample_grid, shown)  # their headers are read up to the first that is not empty
    if shown and all(grid is not None and grid.active_voxels == 0 for grid in grids):
        return []
    message = "no extent is authored, so the Volume has empty bounds. Author the box of its fields."
    return [Problem(Severity.WARN, str(volume.GetPath()), message)]


def check_one_file(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """At every moment all fields show one file; RenderMan, Arnold and Blender read only one."""
    troubles = {}
    for code, fields in _moments(collect_fields(volume, interval)):
        files: dict[str, str] = {}
        for field, sample in fields:
            if sample.file_path and not _is_empty(sample):
                files.setdefault(sample.file_path, field.relationship)
        if len(files) > 1:
            folders = len({file_name(path) for path in files}) < len(files)
            shown = {path: path if folders else file_name(path) for path in files}
            listed = ", ".join(f"{name} in {shown[path]}" for path, name in files.items())
            troubles[code] = (
                f"the fields come from {len(files)} files ({listed}), of which several programs "
                "read only one. Keep a frame's grids in one file; stylize does so with "
                "layer.copy_fields=[all]."
            )
    first = dict(list(troubles.items())[:1])  # the file names differ at every timeCode
    problems = grouped(Severity.WARN, str(volume.GetPath()), first)
    if len(troubles) > 1:
        problems = [
            Problem(
                item.severity,
                item.prim_path,
                f"{item.message} (and so at {len(troubles) - 1} more timeCodes)",
                item.time_code,
            )
            for item in problems
        ]
    return problems


def check_one_name(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """Relationship and grid carry one name; renderers look for the one or the other.

    A second relationship to the same field prim, of the grid's name, serves them all.
    """
    problems, fields = [], collect_fields(volume, interval)
    names = {(field.prim_path, _plain(field.relationship)) for field in fields}
    for field in fields:
        troubles = {}
        for sample in field.samples:
            grid = sample_grid(sample)
            name = sample.grid_name or (grid.name if grid else "")
            is_named = (field.prim_path, _plain(name)) in names
            if name and not sample.blocked and not is_named:
                troubles[sample.time_code] = (
                    f'the relationship field:{field.relationship} shows the grid "{name}". Give '
                    "both the same name: several programs expect it"
                )
        problems += grouped(Severity.WARN, field.prim_path, troubles)
    return problems


def check_one_place(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """All fields but the velocity have equal voxels: grid and field xform taken together."""
    troubles = {}
    for code, fields in _moments(collect_fields(volume, interval)):
        first: tuple[str, np.ndarray] | None = None
        for field, sample in fields:
            grid = sample_grid(sample)
            if grid is None or grid.index_to_world is None or _is_empty(sample):
                continue
            if is_velocity(field.relationship):
                continue  # often coarser than what it moves, and read on its own
            place = grid.index_to_world @ field_to_stage(field.prim, code)
            if first is None:
                first = (field.relationship, place)
            elif np.abs(place - first[1]).max() > _CLOSE * np.abs(first[1]).max():
                troubles[code] = (
                    f"the voxels of {field.relationship} and of {first[0]} are in different "
                    "places. Several programs use one transform for all grids of a Volume."
                )
    return grouped(Severity.WARN, str(volume.GetPath()), troubles)


def check_field_place(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """Field prims stand where their Volume stands; programs place grids by the one or the other."""
    problems, elsewhere = [], dict[float | None, list[str]]()
    for field in collect_fields(volume, interval):
        nowhere = {}
        for sample in field.samples:
            theirs, ours = (field_to_stage(p, sample.time_code) for p in (field.prim, volume))
            if not np.isfinite(theirs).all():
                nowhere[sample.time_code] = (
                    "the transform holds NaN or infinity. Correct the xformOps of the prim or of "
                    "those above it"
                )
            elif np.abs(theirs - ours).max() > _CLOSE * np.abs(ours).max():
                elsewhere.setdefault(sample.time_code, []).append(f"<{field.prim_path}>")
        problems += grouped(Severity.ERROR, field.prim_path, nowhere)
    troubles = {
        code: f"{', '.join(paths)} {'stands' if len(paths) == 1 else 'stand'} elsewhere than the "
        "Volume. Storm and Blender place grids by the Volume, USD by the field prim. Give both one "
        "transform."
        for code, paths in elsewhere.items()
    }
    return [*problems, *grouped(Severity.WARN, str(volume.GetPath()), troubles)]


def check_look_seen(volume: Usd.Prim, _interval: Gf.Interval) -> list[Problem]:
    """The material of a Volume with a look reads a colour of the look."""
    colours = [name for name in field_targets(volume) if name in _COLOURS]
    if not colours or LOOK_API not in volume.GetPrimTypeInfo().GetAppliedAPISchemas():
        return []
    material = hiding_material(volume, colours)
    if material is None:
        mode = str(volume.GetAttribute(EMISSION_MODE).Get())
        bound = find_materials(volume)
        found = [brightness_words(material, mode) for material in bound]
        found += [opacity_words(material, _made_for(volume)) for material in bound]
        path = str(volume.GetPath())
        return [Problem(Severity.WARN, path, f"{text}.") for text in found if text]
    what, renderers = hiding_words(material, colours)
    is_everywhere = renderers == ALL_RENDERERS
    where = "" if is_everywhere else f" in {renderers}"
    message = (
        f"the material <{material.prim_path}> {what}, so the look is not seen{where}. "
        f"{hiding_advice(material.can_replace)}."
    )
    severity = Severity.ERROR if is_everywhere else Severity.WARN
    return [Problem(severity, str(volume.GetPath()), message)]


def _made_for(volume: Usd.Prim) -> float:
    """The extinction per density of a look at its first timeCode, in the Volume's own unit."""
    extinction = volume.GetAttribute(EXTINCTION_PER_DENSITY)
    scale, _ = units_since(volume)
    return float(extinction.Get(Usd.TimeCode.EarliestTime()) or 0.0) / scale


def check_look_units(volume: Usd.Prim, _interval: Gf.Interval) -> list[Problem]:
    """A look is seen in the units that it was made for; else by which factors renderers differ."""
    if LOOK_API not in volume.GetPrimTypeInfo().GetAppliedAPISchemas():
        return []
    scale, metres = units_since(volume)
    changes = [
        text
        for text, factor in (
            (f"the Volume is {scale:.6g} times as large as on the stage of its look", scale),
            (f"metersPerUnit is {metres:.6g} times what it was there", metres),
        )
        if abs(factor - 1) > _SAME_UNITS
    ]
    factors = [
        f"{names} by {factor:.6g}"
        for names, factor in (
            ("Arnold and RenderMan", 1 / scale),
            ("MaterialX and Karma", 1 / (scale * metres)),
        )
        if abs(factor - 1) > _SAME_UNITS
    ]
    if not (changes and factors):
        return []
    same = "usdsmoke's preview, Storm and Cycles show the same picture"
    if is_stretched(volume):
        same = "The scale differs along the axes: usdsmoke's preview and Storm take its mean"
    message = (
        f"{' and '.join(changes)}. {same}. For "
        "others, multiply the extinction and the strength of the emission in the look's material: "
        f"for {', and for '.join(factors)}"
    )
    return [Problem(Severity.WARN, str(volume.GetPath()), message + ".")]


def check_request(volume: Usd.Prim, _interval: Gf.Interval) -> list[Problem]:
    """Requests are known to the schema, of the right type, in range, and lead somewhere."""
    problems = request_problems(volume)
    return [Problem(Severity.ERROR, path, message) for path, message in problems.items()]


def check_request_applied(volume: Usd.Prim, _interval: Gf.Interval) -> list[Problem]:
    """Style attributes are ignored unless the API is applied to the prim."""
    ignored = ignored_attributes(volume)
    if not ignored:
        return []
    message = f"{', '.join(ignored)}: ignored, as {STYLE_API} is not applied. Apply it."
    return [Problem(Severity.WARN, str(volume.GetPath()), message)]


def check_request_placed(prim: Usd.Prim, _interval: Gf.Interval) -> list[Problem]:
    """The API is applied to Volumes; on other prims it is ignored."""
    if not has_request(prim) or prim.IsA(UsdVol.Volume):
        return []
    kind = prim.GetTypeName() or "none"
    message = (
        f"{STYLE_API} is applied to a prim of type {kind}, where it is ignored. Apply it "
        "to a Volume."
    )
    return [Problem(Severity.WARN, str(prim.GetPath()), message)]


def _moments(
    fields: Sequence[FieldFacts],
) -> Iterator[tuple[float | None, list[tuple[FieldFacts, FieldSample]]]]:
    """Every timeCode at which any field changes, with what each of them shows then."""
    codes = {sample.time_code for field in fields for sample in field.samples}
    sampled: list[float | None] = [*sorted(code for code in codes if code is not None)]
    for code in sampled or [None]:
        yield code, [(field, field.at(code)) for field in fields]


def _is_empty(sample: FieldSample) -> bool:
    """A grid without voxels shows nothing, wherever it is."""
    grid = sample_grid(sample)
    return grid is not None and grid.active_voxels == 0


def _plain(name: str) -> str:
    """USD names have no dots: field:vel_x may well show vel.x."""
    return name.replace(".", "_").replace(":", "_")
