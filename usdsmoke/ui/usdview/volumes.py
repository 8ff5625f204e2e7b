"""Which Volumes a selection means."""

from collections.abc import Sequence
from itertools import chain

from pxr import Usd, UsdVol

from usdsmoke.base.errors import VolumeNotFound
from usdsmoke.usd.field_samples import field_targets


def selects_everything(selected: Sequence[Usd.Prim]) -> bool:
    """Whether nothing is selected, or the root of all, which usdview takes for nothing."""
    return all(prim.IsPseudoRoot() for prim in selected)


def selected_volumes(stage: Usd.Stage, selected: Sequence[Usd.Prim]) -> list[Usd.Prim]:
    """The Volumes that selected prims stand for, in the stage's order; all where none is selected.

    A field prim means the Volumes that show it. Another prim means itself and the Volumes below it,
    or else the one it is in. Volumes inside instances are taken only if there are no others.

    Args:
        stage: any; only what is loaded and active is seen.
        selected: prims of it, some may be gone.

    Raises:
        VolumeNotFound: there is no such Volume.
    """
    predicate = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
    there = [prim for prim in Usd.PrimRange.Stage(stage, predicate) if prim.IsA(UsdVol.Volume)]
    living = [prim for prim in selected if prim and not prim.IsPseudoRoot()]
    if selects_everything(selected):
        found = set(there)
    else:
        found = {volume for prim in living for volume in _meant(prim, there)}
    volumes = [volume for volume in there if volume in found]
    if not volumes:
        raise VolumeNotFound(_refusal(stage, living, there))
    return [volume for volume in volumes if not volume.IsInstanceProxy()] or volumes


def _meant(prim: Usd.Prim, volumes: Sequence[Usd.Prim]) -> list[Usd.Prim]:
    path = prim.GetPath()
    showing = [v for v in volumes if path in chain.from_iterable(field_targets(v).values())]
    below = [v for v in volumes if v.GetPath().HasPrefix(path)]
    around = [v for v in volumes if path.HasPrefix(v.GetPath())]
    return showing or below or around[-1:]


def _refusal(stage: Usd.Stage, selected: Sequence[Usd.Prim], volumes: Sequence[Usd.Prim]) -> str:
    unloaded = len(stage.FindLoadable()) - len(stage.GetLoadSet())
    hint = f" ({unloaded} payloads are not loaded and may hold some)" if unloaded > 0 else ""
    if not volumes:
        return f"there is no Volume on this stage{hint}"
    names = ", ".join(f"<{prim.GetPath()}>" for prim in selected) or "what is selected"
    there = ", ".join(f"<{prim.GetPath()}>" for prim in volumes)
    return f"there is no Volume at {names}{hint}. Select one of {there}, or nothing."
