"""A Volume's field relationships, in one spelling for all who read or author them."""

from collections.abc import Sequence

from pxr import Sdf, Usd

__all__ = ["FIELD_PREFIX", "field_prim", "field_targets"]

FIELD_PREFIX = "field:"


def field_targets(volume: Usd.Prim) -> dict[str, list[Sdf.Path]]:
    """Forwarded targets of every field relationship by its name without the prefix.

    Differs from ``UsdVol.Volume.GetFieldPaths``: names with further colons stay whole, and
    relationships without or with several targets are kept, so that they can be reported.
    """
    return {
        relationship.GetName().removeprefix(FIELD_PREFIX): list(relationship.GetForwardedTargets())
        for relationship in volume.GetRelationships()
        if relationship.GetName().startswith(FIELD_PREFIX)
    }


def field_prim(stage: Usd.Stage, targets: Sequence[Sdf.Path], kind: type) -> Usd.Prim | str:
    """The field prim at the one target of a relationship, or what is wrong with it.

    Args:
        stage: where the targets lead to.
        targets: of ``field_targets``.
        kind: the schema class that the prim must be of.

    Returns:
        The prim, or words that follow "the relationship".
    """
    if not targets:
        return "has no target"
    if len(targets) > 1:
        return f"has {len(targets)} targets ({', '.join(f'<{path}>' for path in targets)})"
    prim = stage.GetPrimAtPath(targets[0].GetPrimPath())
    if not prim or not targets[0].IsPrimPath():
        return f"leads to <{targets[0]}>, where there is no prim"
    if not prim.IsA(kind):
        return f"leads to <{targets[0]}>, which is of type {prim.GetTypeName() or 'none'}"
    return prim
