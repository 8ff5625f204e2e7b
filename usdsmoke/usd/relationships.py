"""A Volume's field relationships, in one spelling for all who read or author them."""

from collections.abc import Sequence

from pxr import Sdf, Usd

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


def target_prim(stage: Usd.Stage, targets: Sequence[Sdf.Path]) -> Usd.Prim | None:
    """The prim at the one target of a relationship, of any type.

    Args:
        stage: where the targets lead to.
        targets: of ``field_targets``.

    Returns:
        None if there is no target or several, or if the target is no prim of the stage.
    """
    if len(targets) != 1 or not targets[0].IsPrimPath():
        return None
    return stage.GetPrimAtPath(targets[0]) or None
