"""From a Volume's relationships to the field prims of its density, its velocity and its mask."""

import os
from collections.abc import Sequence
from dataclasses import dataclass

from pxr import Sdf, Usd, UsdVol

from usdsmoke.base.errors import FieldNotFound, StageError
from usdsmoke.base.request_attributes import MASK
from usdsmoke.base.volume import VELOCITY_NAMES
from usdsmoke.usd.relationships import FIELD_PREFIX, field_prim, field_targets

__all__ = [
    "VolumeFields",
    "describe_instance",
    "find_fields",
    "velocity_relationships",
]

_AXES = "xyz"


@dataclass(frozen=True)
class VolumeFields:
    """A Volume's field prims by relationship name, as far as they will be used."""

    density: str  # relationship name
    velocity: tuple[str, ...]  # relationship names; none, one vector or x, y, z
    mask: str  # relationship name; "" when the Volume has none of that name
    prims: dict[str, Usd.Prim]
    others: tuple[str, ...]  # relationships that are left alone


def velocity_relationships(names: Sequence[str], wanted: str = "") -> tuple[str, ...]:
    """The relationships that hold the velocity: one vector, three scalars x, y, z, or none.

    Args:
        names: relationship names without ``field:``.
        wanted: the name from the settings; empty tries vel, v and velocity in this order. Scalars
            are called like the vector plus _x, :x or x.
    """
    for base in (wanted,) if wanted else VELOCITY_NAMES:
        if base in names:
            return (base,)
        for separator in ("_", ":", ""):
            components = tuple(f"{base}{separator}{axis}" for axis in _AXES)
            if all(name in names for name in components):
                return components
    return ()


def find_fields(volume: Usd.Prim, density: str, velocity: str, mask: str = "") -> VolumeFields:
    """The field prims of a Volume's density and, where there are such, velocity and mask.

    A velocity relationship that leads to no OpenVDBAsset is left with the others. The density has
    to be there; a mask without a relationship may still be a grid of the density's file.

    Args:
        volume: a composed Volume prim.
        density: relationship name of the density.
        velocity: relationship name of the velocity; empty means the usual names.
        mask: relationship name of the mask; empty means none. The request's own relationship,
            ``usdSmoke:request:mask``, may be named too.

    Raises:
        FieldNotFound: no relationship of the density's name, or the density's or the mask's leads
            to no OpenVDBAsset.
        StageError: the density's field prim is an instance proxy.
    """
    relationships = field_targets(volume)
    if mask == MASK:
        relationships[mask] = list(volume.GetRelationship(mask).GetForwardedTargets())
    if density not in relationships:
        raise FieldNotFound(
            f'Volume <{volume.GetPath()}> has no relationship "{FIELD_PREFIX}{density}"; '
            f"it has: {_listed(relationships)}; name the density's with stage.density"
        )
    prims = {density: _density_prim(volume, density, relationships[density])}
    mask = mask if mask in relationships else ""
    if mask:
        prims[mask] = _wanted_prim(volume, mask, relationships[mask])
    names = velocity_relationships(sorted(relationships), velocity)
    found = {name: _openvdb_prim(volume, relationships[name]) for name in names}
    if all(isinstance(prim, Usd.Prim) for prim in found.values()):
        prims.update({name: prim for name, prim in found.items() if isinstance(prim, Usd.Prim)})
    else:
        names = ()
    others = tuple(name for name in sorted(relationships) if name not in prims)
    return VolumeFields(density, names, mask, prims, others)


def describe_instance(prim: Usd.Prim) -> str:
    """The instance that an instance proxy belongs to, where its opinions stand, what to do.

    Layers are named relative to the stage's file.
    """
    instance = prim
    while instance and not instance.IsInstance():
        instance = instance.GetParent()
    source = prim.GetPrimStack()[0]
    return (
        f"it lies inside the instance <{instance.GetPath()}>, whose prims cannot be changed one by "
        f"one; stylize its source, <{source.path}> in {_beside_root(source.layer, prim)}, "
        f"or set instanceable = false on <{instance.GetPath()}>"
    )


def _beside_root(layer: Sdf.Layer, prim: Usd.Prim) -> str:
    """A layer's file as seen from the stage's: results repeat it, and name no other folders."""
    root = prim.GetStage().GetRootLayer()
    if not (layer.realPath and root.realPath):
        return str(layer.identifier)
    try:
        return os.path.relpath(layer.realPath, os.path.dirname(root.realPath))
    except ValueError:  # there is no relative way from one Windows drive to another
        return str(layer.GetDisplayName())


def _density_prim(volume: Usd.Prim, density: str, targets: list[Sdf.Path]) -> Usd.Prim:
    prim = _wanted_prim(volume, density, targets)
    if prim.IsInstanceProxy():
        raise StageError(
            f"cannot change the field <{prim.GetPath()}> of the {_where(volume, density)}: "
            f"{describe_instance(prim)}"
        )
    return prim


def _wanted_prim(volume: Usd.Prim, name: str, targets: list[Sdf.Path]) -> Usd.Prim:
    """The field prim of a relationship that has to lead to one."""
    prim = _openvdb_prim(volume, targets)
    if isinstance(prim, str):
        raise FieldNotFound(
            f"the {_where(volume, name)} {prim}; wanted one OpenVDBAsset prim: correct its target"
        )
    return prim


def _where(volume: Usd.Prim, name: str) -> str:
    prefix = "" if name == MASK else FIELD_PREFIX
    return f'relationship "{prefix}{name}" of Volume <{volume.GetPath()}>'


def _openvdb_prim(volume: Usd.Prim, targets: list[Sdf.Path]) -> Usd.Prim | str:
    return field_prim(volume.GetStage(), targets, UsdVol.OpenVDBAsset)


def _listed(names: dict[str, list[Sdf.Path]]) -> str:
    return ", ".join(f"{FIELD_PREFIX}{name}" for name in sorted(names)) or "none"
