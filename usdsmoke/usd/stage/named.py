"""A prim that somebody has named by its path."""

from pxr import Sdf, Usd

from usdsmoke.base.errors import UsdSmokeError

__all__ = ["named_prim"]


def named_prim(
    stage: Usd.Stage, path: str, wanted: str, advice: str, error: type[UsdSmokeError]
) -> Usd.Prim:
    """The active prim at a path, of whatever type.

    Args:
        stage: composed.
        path: as it was given.
        wanted: what it is to be the path of, with an example.
        advice: the end of every message: what there is to choose from.
        error: what to raise.

    Raises:
        UsdSmokeError: of the kind ``error``: no path of a prim, no such prim, or an inactive one.
    """
    if not (
        path.startswith("/") and Sdf.Path.IsValidPathString(path) and Sdf.Path(path).IsPrimPath()
    ):
        raise error(f"{path!r} is no path of {wanted}; {advice}")
    prim = stage.GetPrimAtPath(path)
    if not prim:
        raise error(f"no prim <{path}> on the stage; {advice}")
    if not prim.IsActive():
        raise error(f"the prim <{path}> is inactive; activate it, or {advice}")
    return prim
