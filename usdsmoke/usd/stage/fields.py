"""The field prims of a Volume's density, velocity and mask, and the files that they show."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import AssetNotResolved, FieldNotFound, StageError
from usdsmoke.base.naming import COLOUR_CHANNELS, COLOUR_VECTORS
from usdsmoke.base.time_codes import format_time_code, name_time_codes
from usdsmoke.base.volume import FIELD_SEPARATORS, VELOCITY_NAMES, FieldSource
from usdsmoke.config.run_sections import EVERYTHING
from usdsmoke.usd.field_samples import (
    FIELD_PREFIX,
    FieldSamples,
    field_targets,
    held_time_code,
    target_prim,
)
from usdsmoke.usd.request_values import MASK
from usdsmoke.usd.values import value_at, vdb_problem

_AXES = "xyz"


@dataclass(frozen=True)
class VolumeFields:
    """A Volume's field prims by relationship name, as far as they will be used."""

    density: str  # relationship name
    velocity: tuple[str, ...]  # relationship names; none, one vector or x, y, z
    mask: str  # relationship name; "" when the Volume has none of that name
    prims: dict[str, Usd.Prim]
    others: tuple[str, ...]  # relationships that are left alone
    copied: tuple[str, ...] = ()  # relationships whose grids go into the result's files


def velocity_relationships(names: Sequence[str], chosen: str = "") -> tuple[str, ...]:
    """The relationships that hold the velocity: one vector, three scalars x, y, z, or none.

    Args:
        names: relationship names without ``field:``.
        chosen: the name from the settings; empty tries vel, v and velocity in this order. Scalars
            are called like the vector plus _x, :x or x.
    """
    for base in (chosen,) if chosen else VELOCITY_NAMES:
        if base in names:
            return (base,)
        for separator in FIELD_SEPARATORS:
            components = tuple(f"{base}{separator}{axis}" for axis in _AXES)
            if all(name in names for name in components):
                return components
    return ()


def find_fields(
    volume: Usd.Prim, density: str, velocity: str, mask: str = "", copied: Sequence[str] = ()
) -> VolumeFields:
    """The field prims of a Volume's density and, where there are such, velocity and mask.

    A velocity relationship that leads to no OpenVDBAsset is left with the others. The density has
    to be there; a mask without a relationship may still be a grid of the density's file.

    Args:
        velocity: relationship name of the velocity; empty means the usual names.
        mask: relationship name of the mask; empty means none. The request's own relationship,
            ``usdSmoke:request:mask``, may be named too.
        copied: relationship names of others that are copied, or ``all``; those that lead to no
            OpenVDBAsset are left alone.

    Raises:
        FieldNotFound: no relationship of the density's name, or the density's or the mask's leads
            to no OpenVDBAsset.
        StageError: the density's field prim is an instance proxy, and the Volume is not.
    """
    relationships = field_targets(volume)
    if mask == MASK:
        relationships[mask] = list(volume.GetRelationship(mask).GetForwardedTargets())
    if density not in relationships:
        raise FieldNotFound(
            f'Volume <{volume.GetPath()}> has no relationship "{FIELD_PREFIX}{density}" '
            f"(found: {_listed(relationships)}). {_density_advice(volume, relationships)}"
        )
    prims = {density: _density_prim(volume, density, relationships[density])}
    mask = mask if mask in relationships else ""
    if mask:
        prims[mask] = _required_prim(volume, mask, relationships[mask])
    names = velocity_relationships(sorted(relationships), velocity)
    found = {name: _openvdb_prim(volume, relationships[name]) for name in names}
    if all(isinstance(prim, Usd.Prim) for prim in found.values()):
        prims.update({name: prim for name, prim in found.items() if isinstance(prim, Usd.Prim)})
    else:
        names = ()
    taken = set(prims)
    for name in sorted(relationships.keys() - taken):
        prim = _openvdb_prim(volume, relationships[name])
        if (EVERYTHING in copied or name in copied) and isinstance(prim, Usd.Prim):
            prims[name] = prim
    others = tuple(name for name in sorted(relationships) if name not in prims)
    return VolumeFields(density, names, mask, prims, others, tuple(sorted(prims.keys() - taken)))


def describe_instance(prim: Usd.Prim) -> str:
    """The instance that an instance proxy belongs to, the source of its opinions, and what to do.

    Layers are named relative to the stage's file.
    """
    instance = prim
    while instance and not instance.IsInstance():
        instance = instance.GetParent()
    source = prim.GetPrimStack()[0]
    return (
        f"it is inside the instance <{instance.GetPath()}>, whose prims cannot be changed one by "
        f"one. Stylize its source, <{source.path}> in {_beside_root(source.layer, prim)}, "
        f"or set instanceable = false on <{instance.GetPath()}>."
    )


def _beside_root(layer: Sdf.Layer, prim: Usd.Prim) -> str:
    """A layer's file as seen from the stage's: results repeat it, and name no other folders."""
    root = prim.GetStage().GetRootLayer()
    if not (layer.realPath and root.realPath):
        return str(layer.identifier)
    return os.path.relpath(layer.realPath, os.path.dirname(root.realPath))


def _density_prim(volume: Usd.Prim, density: str, targets: list[Sdf.Path]) -> Usd.Prim:
    prim = _required_prim(volume, density, targets)
    if prim.IsInstanceProxy() and not volume.IsInstanceProxy():
        raise StageError(
            f"cannot change the field <{prim.GetPath()}> of the {_where(volume, density)}: "
            f"{describe_instance(prim)}"
        )
    return prim


def _required_prim(volume: Usd.Prim, name: str, targets: list[Sdf.Path]) -> Usd.Prim:
    """The field prim of a relationship that has to lead to one."""
    prim = _openvdb_prim(volume, targets)
    if isinstance(prim, str):
        advice = "Correct its target: one OpenVDBAsset prim."
        if prim.endswith("inactive"):
            advice = "Activate it."
        if prim.endswith("Asset"):  # another program's fields
            advice = (
                "usdsmoke reads only OpenVDB files: convert the volume to .vdb, and point an "
                "OpenVDBAsset at it."
            )
        raise FieldNotFound(f"the {_where(volume, name)} {prim}. {advice}")
    return prim


def _where(volume: Usd.Prim, name: str) -> str:
    prefix = "" if name == MASK else FIELD_PREFIX
    return f'relationship "{prefix}{name}" of Volume <{volume.GetPath()}>'


def _openvdb_prim(volume: Usd.Prim, targets: list[Sdf.Path]) -> Usd.Prim | str:
    """The OpenVDBAsset at the one target, or what is wrong with it, in words for an error."""
    prim = target_prim(volume.GetStage(), targets)
    if prim and not prim.IsActive():
        return f"leads to <{targets[0]}>, which is inactive"
    if prim and prim.IsA(UsdVol.OpenVDBAsset):
        return prim
    if not targets:
        return "has no target"
    if len(targets) > 1:
        return f"has {len(targets)} targets ({', '.join(f'<{path}>' for path in targets)})"
    if not prim:
        return f"leads to <{targets[0]}>, where there is no prim"
    return f"leads to <{targets[0]}>, which is of type {prim.GetTypeName() or 'none'}"


def _is_level_set(volume: Usd.Prim, targets: list[Sdf.Path]) -> bool:
    """Whether a relationship leads to a field that says that it is one."""
    prim = target_prim(volume.GetStage(), targets)
    return prim is not None and prim.GetAttribute("fieldClass").Get() == "levelSet"


def _density_advice(volume: Usd.Prim, names: dict[str, list[Sdf.Path]]) -> str:
    """What to do about a Volume without a field of the density's name."""
    if not names:
        return "Give it a field of density."
    others = [name for name in names if name not in (*COLOUR_VECTORS, *COLOUR_CHANNELS)]
    if others and all(_is_level_set(volume, names[name]) for name in others):
        return "It has surfaces alone (level sets): convert one to a fog volume."
    name = others[0] if len(others) == 1 else "NAME"
    others = [prim for prim in volume.GetStage().Traverse() if prim.IsA(UsdVol.Volume)]
    alone = f" --prim {volume.GetPath()}, as it holds for all Volumes" if len(others) > 1 else ""
    return f"Say which one is the density: --set stage.density={name}{alone}."


def _listed(names: dict[str, list[Sdf.Path]]) -> str:
    return ", ".join(f"{FIELD_PREFIX}{name}" for name in sorted(names)) or "none"


def field_source(
    relationship: str, prim: Usd.Prim, time_code: float, xforms: UsdGeom.XformCache
) -> FieldSource | None:
    """What a field prim shows at ``time_code``, files unchecked; None in a gap.

    Args:
        relationship: the Volume's name for the field, without ``field:``.
        time_code: any; time samples are held.
        xforms: a cache at ``time_code``.
    """
    samples = FieldSamples(prim)
    sample = samples.at(time_code)
    if not sample.has_path:
        return None
    code_stretch, time_stretch = samples.stretch(time_code)
    return FieldSource(
        relationship=relationship,
        prim_path=str(prim.GetPath()),
        time_code=time_code,
        file_path=sample.file_path,
        authored_path=sample.authored_path,
        grid_name=sample.grid_name,
        grid_index=sample.grid_index,
        field_to_stage=np.array(xforms.GetLocalToWorldTransform(prim), dtype=np.float64),
        data_type=value_at(prim.GetAttribute("fieldDataType"), time_code) or "",
        field_class=value_at(prim.GetAttribute("fieldClass"), time_code) or "",
        code_stretch=code_stretch,
        time_stretch=time_stretch,
    )


def late_velocity(fields: VolumeFields, selected: Sequence[float]) -> tuple[str, ...]:
    """A velocity without time samples where the density has some: USD holds another frame's grid.

    Args:
        selected: timeCodes of the density's samples.

    Returns:
        a sentence without a full stop, or nothing.
    """
    for name in fields.velocity:
        codes = FieldSamples(fields.prims[name]).changes()
        missing = sorted(set(selected).difference(codes))
        if len(codes) > 1 and missing:
            return (
                f"the velocity <{fields.prims[name].GetPath()}> has no time sample at "
                f"{name_time_codes(missing)}, where the density has one: at {missing[-1]:g} USD "
                f"shows its grid of timeCode {held_time_code(codes, missing[-1]):.10g}. Author "
                "both at the same timeCodes",
            )
    return ()


def check_assets(prim: Usd.Prim, sources: Sequence[FieldSource]) -> None:
    """Refuse a field whose files cannot be read from disk, naming every timeCode concerned.

    Raises:
        AssetNotResolved: a path is empty, Houdini's own, inside a package, a folder, or resolves to
            no file.
    """
    path = prim.GetAttribute("filePath")
    found = [
        (source, vdb_problem(source.authored_path, source.file_path, path)) for source in sources
    ]
    problems = [(source, problem) for source, problem in found if problem]
    if not problems:
        return
    source, problem = problems[0]
    asset = f"@{source.authored_path}@, authored in {_authoring_layer(prim, source.time_code)}"
    some_are_left = len(problems) < len(found)
    others = " --allow-missing skips these timeCodes." if some_are_left else ""
    raise AssetNotResolved(
        f"the filePath of <{source.prim_path}> at timeCode {format_time_code(source.time_code)} is "
        f"{asset}: {problem}{_also(source.time_code for source, _ in problems[1:])}{others}"
    )


def check_places(sources: Sequence[FieldSource]) -> None:
    """Refuse a field prim whose transform leaves no smoke to be seen, or shows it in perspective.

    Raises:
        StageError: it has a scale of 0, NaN or infinity, or is not affine; with every timeCode
            concerned.
    """
    for is_sound, problem in (
        (_has_size, "has a scale of 0, NaN or infinity"),
        (_is_affine, "is a perspective: its last column is not 0, 0, 0, 1"),
    ):
        lost = [source for source in sources if not is_sound(source.field_to_stage)]
        if lost:
            raise StageError(
                f"the transform of <{lost[0].prim_path}> at timeCode "
                f"{format_time_code(lost[0].time_code)} {problem}"
                f"{_also(source.time_code for source in lost[1:])}. Correct the xformOps of the "
                "prim or of those above it, or leave such timeCodes out with --frames."
            )


def _has_size(matrix: np.ndarray) -> bool:
    return bool(np.isfinite(matrix).all() and abs(np.linalg.det(matrix[:3, :3])) > 0)


def _is_affine(matrix: np.ndarray) -> bool:
    return bool(np.allclose(matrix[:, 3], (0.0, 0.0, 0.0, 1.0), rtol=0.0, atol=1e-9))


def _authoring_layer(prim: Usd.Prim, time_code: float) -> str:
    """File name of the layer that supplies ``filePath`` at ``time_code``."""
    for spec in prim.GetAttribute("filePath").GetPropertyStack(Usd.TimeCode(time_code)):
        if spec.HasInfo("timeSamples") or spec.HasInfo("default"):
            return _layer_name(spec.layer)
    return "no layer"


def _layer_name(layer: Sdf.Layer) -> str:
    return layer.identifier if layer.anonymous else str(PurePath(layer.realPath))


def _also(time_codes: Iterable[float]) -> str:
    codes = list(time_codes)
    return f" (the same at {name_time_codes(codes)})" if codes else ""
