"""Which Volumes of a stage are taken: those that are named, or all that are shown."""

from collections.abc import Sequence

from pxr import Sdf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import StageError, VolumeNotFound
from usdsmoke.usd.stage.fields import describe_instance
from usdsmoke.usd.stage.opening import named_prim, type_words
from usdsmoke.usd.stage.originals import is_look_layer
from usdsmoke.usd.values import ancestors, value_at


def choose_volumes(
    stage: Usd.Stage, named: Sequence[str], with_instances: bool = False
) -> tuple[list[Usd.Prim], dict[str, str]]:
    """The Volumes to take, and why others are left out.

    Args:
        with_instances: whether those inside instances are taken: they can be drawn, not changed.
    """
    predicate = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
    there = [prim for prim in Usd.PrimRange.Stage(stage, predicate) if prim.IsA(UsdVol.Volume)]
    if named:
        return _named_volumes(stage, named, there, with_instances)
    reasons = {prim: _why_not_chosen(prim, with_instances) for prim in there}
    volumes = [prim for prim, reason in reasons.items() if not reason]
    omitted = {str(prim.GetPath()): reason for prim, reason in reasons.items() if reason}
    if volumes:
        return volumes, omitted
    if omitted:
        path, reason = next(iter(omitted.items()))
        raise StageError(f"cannot use Volume <{path}>: {reason}")
    if is_look_layer(stage.GetRootLayer()):
        raise VolumeNotFound(
            f"{stage.GetRootLayer().realPath} is a look layer by itself, without the smoke that it "
            "belongs to. Use the root layer that was written beside it, NAME_look.usda, or the "
            "asset, NAME_asset.usda."
        )
    raise VolumeNotFound(
        f"no Volume on the stage {stage.GetRootLayer().identifier}. Add a prim of type Volume "
        f"with a density field{_composition_hint(stage)}."
    )


def hidden_volumes(stage: Usd.Stage) -> dict[str, str]:
    """The Volumes that can be used only if they are named, and why; by path."""
    prims = [prim for prim in stage.Traverse() if prim.IsA(UsdVol.Volume)]
    return {str(prim.GetPath()): why for prim in prims if (why := _why_not_chosen(prim))}


def _why_not_chosen(prim: Usd.Prim, with_instances: bool = False) -> str:
    """Why a Volume is left out unless it is named; "" where it is not."""
    if prim.IsInstanceProxy() and not with_instances:
        return describe_instance(prim)
    shown = UsdGeom.Imageable(prim)
    purpose = shown.ComputePurpose()
    if purpose in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy):
        return f"its purpose is {purpose}, which is not rendered. Name it with --prim to use it."
    hidden = [part for part in ancestors(prim) if _is_hidden(UsdGeom.Imageable(part))]
    if hidden:
        which = "it" if hidden[0] == prim else f"<{hidden[0].GetPath()}>"
        return f"{which} is invisible. Name the Volume with --prim to use it."
    return ""


def _is_hidden(item: UsdGeom.Imageable) -> bool:
    """True if visibility is invisible at every time."""
    attribute = item.GetVisibilityAttr() if item else None
    if not attribute:
        return False
    times = attribute.GetTimeSamples() or [Usd.TimeCode.Default()]
    return all(value_at(attribute, time) == UsdGeom.Tokens.invisible for time in times)


def _composition_hint(stage: Usd.Stage) -> str:
    """What to look at when an arc is broken: the Volume may lie behind it."""
    # OpenUSD 24.05 lacks the function. It prints the errors when it opens the stage.
    errors = stage.GetCompositionErrors() if hasattr(stage, "GetCompositionErrors") else []
    if not errors:
        return _where_it_may_be(stage)
    first = " ".join(str(errors[0]).split()).rstrip(".")
    return f", or repair the stage, of which a part is missing: {first}"


def _where_it_may_be(stage: Usd.Stage) -> str:
    """What may hide a Volume: a prim that is not active, or another variant."""
    every = list(Usd.PrimRange.Stage(stage, Usd.PrimAllPrimsPredicate))
    groups = ("", "Xform", "Scope", "Volume")
    if inactive := [p for p in every if not p.IsActive() and p.GetTypeName() in groups]:
        return f", or activate <{inactive[0].GetPath()}>"
    for prim in every:
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            if len(sets.GetVariantSet(name).GetVariantNames()) < 2:
                continue
            here = f"<{prim.GetPath()}>{{{name}={sets.GetVariantSelection(name)}}}"
            return f", or select another variant than {here}"
    return "; usdsmoke does not turn meshes or particles into smoke"


def _named_volumes(
    stage: Usd.Stage, paths: Sequence[str], there: Sequence[Usd.Prim], with_instances: bool
) -> tuple[list[Usd.Prim], dict[str, str]]:
    """Named Volumes, and the shown ones below other prims that are named; why others are not."""
    found, omitted = dict[Sdf.Path, Usd.Prim](), dict[str, str]()
    for path in paths:
        listed = ", ".join(f"<{prim.GetPath()}>" for prim in there) or "none"
        advice = f"Use one of its Volumes: {listed}."
        prim = named_prim(stage, path, "/World/smoke", advice, VolumeNotFound)
        if prim.IsA(UsdVol.Volume):
            if prim.IsInstanceProxy() and not with_instances:
                raise StageError(f"cannot use Volume <{path}>: {describe_instance(prim)}")
            found[prim.GetPath()] = prim
            continue
        below = [item for item in there if item.GetPath().HasPrefix(prim.GetPath())]
        if not below:
            raise VolumeNotFound(
                f"<{path}> {type_words(prim)}, not a Volume, and has none below it. {advice}"
            )
        reasons = {item: _why_not_chosen(item, with_instances) for item in below}
        found |= {item.GetPath(): item for item, reason in reasons.items() if not reason}
        omitted |= {str(item.GetPath()): reason for item, reason in reasons.items() if reason}
    omitted = {path: reason for path, reason in omitted.items() if Sdf.Path(path) not in found}
    if not found:
        path, reason = next(iter(omitted.items()))
        raise StageError(f"cannot use Volume <{path}>: {reason}")
    return list(found.values()), omitted
