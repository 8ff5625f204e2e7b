"""A Volume's field relationships, in one spelling for all who read or author them."""

from pxr import Sdf, Usd

__all__ = ["FIELD_PREFIX", "field_targets"]

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
