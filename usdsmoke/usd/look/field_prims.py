"""Which prims carry the result's fields: the source's own where that is safe, else new ones."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain

from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import LayerError
from usdsmoke.base.naming import COLOUR_CHANNELS, COLOUR_VECTORS
from usdsmoke.usd.look.records import StylizedVolume
from usdsmoke.usd.relationships import FIELD_PREFIX, field_targets

_CLOSE = 1e-9  # of matrix elements: the same ops evaluated twice


@dataclass(frozen=True)
class FieldTarget:
    """The prim that a field of the result is authored on."""

    relationship: str  # without field:
    grid_name: str
    prim_path: Sdf.Path
    source: Usd.Prim | None  # shows the field where the result does not; None: nothing does
    is_new: bool  # defined by the look, and the relationship is pointed to it
    beside: Usd.Prim  # the density's field prim, whose xform a new prim shares


def count_field_uses(stage: Usd.Stage) -> dict[Sdf.Path, int]:
    """How many field relationships of all Volumes, instances included, lead to each prim."""
    uses: dict[Sdf.Path, int] = {}
    predicate = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
    for prim in Usd.PrimRange.Stage(stage, predicate):
        if not prim.IsA(UsdVol.Volume):
            continue
        for path in chain.from_iterable(field_targets(prim).values()):
            uses[path] = uses.get(path, 0) + 1
    return uses


def choose_field_prims(
    stage: Usd.Stage,
    volume: StylizedVolume,
    uses: Mapping[Sdf.Path, int],
    taken: set[Sdf.Path],
) -> list[FieldTarget]:
    """A prim for every field of a result, the density first.

    The source's field prim is overridden in place unless other Volumes show it too; they must keep
    what they have. A new prim is a sibling of the density's field prim and copies its xform ops, so
    that the two share their place in space at every moment. A colour field that the source has
    already is kept up only where it lies in that same place.

    Args:
        stage: the source.
        volume: its result.
        uses: from ``count_field_uses``.
        taken: paths of prims that the look defines already; new ones are added.

    Raises:
        LayerError: the stage is not the one that was read.
    """
    prim = stage.GetPrimAtPath(volume.source.prim_path)
    density = _field_prim(prim, volume.source.density)
    if density is None:
        raise LayerError(
            f"Volume <{volume.source.prim_path}> has lost its density field since it was read. "
            "Open the stage again."
        )
    names = sorted(volume.grids, key=lambda name: (name != volume.source.density, name))
    targets = []
    for name in names:
        source = _field_prim(prim, name)
        is_colour = name in (*COLOUR_VECTORS, *COLOUR_CHANNELS) and name != volume.source.density
        if is_colour and source is not None and not _same_place(source, density, volume):
            source = None
        is_new = source is None or uses.get(source.GetPath(), 0) > 1
        if source is None or is_new:
            path = _free_path(stage, density, name, prim, taken)
            taken.add(path)
        else:
            path = source.GetPath()
        targets.append(FieldTarget(name, volume.grids[name], path, source, is_new, density))
    return targets


def _field_prim(volume: Usd.Prim, name: str) -> Usd.Prim | None:
    relationship = volume.GetRelationship(FIELD_PREFIX + name)
    targets = relationship.GetForwardedTargets() if relationship else []
    if len(targets) != 1:
        return None
    prim = volume.GetStage().GetPrimAtPath(targets[0])
    usable = prim and prim.IsA(UsdVol.OpenVDBAsset) and not prim.IsInstanceProxy()
    return prim if usable else None


def _same_place(one: Usd.Prim, other: Usd.Prim, volume: StylizedVolume) -> bool:
    """Whether two field prims have equal local-to-world matrices at the Volume's timeCodes."""
    for time_code in volume.source.time_codes:
        xforms = UsdGeom.XformCache(time_code)
        matrices = [xforms.GetLocalToWorldTransform(prim) for prim in (one, other)]
        if not Gf.IsClose(matrices[0], matrices[1], _CLOSE):
            return False
    return True


def _free_path(
    stage: Usd.Stage, beside: Usd.Prim, name: str, volume: Usd.Prim, taken: set[Sdf.Path]
) -> Sdf.Path:
    """A path next to ``beside`` where the stage has no prim: name, name_volume, name_volume_2..."""
    parent = beside.GetPath().GetParentPath()
    base = name.replace(":", "_")
    longer = f"{base}_{volume.GetName()}"
    candidates = [base, longer] + [f"{longer}_{n}" for n in range(2, 1000)]
    for candidate in candidates:
        path = parent.AppendChild(candidate)
        if path not in taken and not stage.GetPrimAtPath(path):
            return path
    raise LayerError(
        f"no free name for the field {name} below <{parent}>: {longer} to {candidates[-1]} exist. "
        "Rename some of them."
    )
