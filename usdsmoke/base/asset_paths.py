"""Asset paths as they have to stand in a layer of another folder to mean the same file."""

import os
import re
from pathlib import Path

from pxr import Sdf, Usd

__all__ = ["anchored_asset", "asset_value", "relative_asset_path"]

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")  # two letters at least: C: is a drive


def relative_asset_path(file_path: str | Path, folder: Path) -> str:
    """``file_path`` as seen from ``folder``, with / and a leading dot; absolute across drives.

    The leading dot tells USD to look beside the layer and nowhere else. Where links lead to the
    file's folder, the shorter way counts, with the links as they are or followed: it stays right
    from wherever a tree that holds both is reached.

    >>> relative_asset_path("/shot/look/vdb/smoke.0001.vdb", Path("/shot/look"))
    './vdb/smoke.0001.vdb'
    """
    target, start = os.path.abspath(file_path), os.path.abspath(folder)
    followed = os.path.join(os.path.realpath(os.path.dirname(target)), os.path.basename(target))
    try:
        ways = [os.path.relpath(place, start).replace(os.sep, "/") for place in (target, followed)]
    except ValueError:  # there is no relative way from one Windows drive to another
        return target.replace(os.sep, "/")
    relative = min(ways, key=lambda way: way.count("/"))
    return relative if relative.startswith("../") else f"./{relative}"


def asset_value(
    attribute: Usd.Attribute, time_code: float | None, folder: Path
) -> Sdf.AssetPath | Sdf.ValueBlock:
    """A composed asset value, re-anchored to a layer in ``folder``; a block where there is none.

    Args:
        attribute: of type asset.
        time_code: None asks for the default.
        folder: of the layer that the value will stand in.
    """
    at = Usd.TimeCode.Default() if time_code is None else Usd.TimeCode(time_code)
    value = attribute.Get(at)
    if value is None:
        return Sdf.ValueBlock()
    return anchored_asset(value, _authoring_layer(attribute, at), folder)


def anchored_asset(value: Sdf.AssetPath, layer: Sdf.Layer | None, folder: Path) -> Sdf.AssetPath:
    """An asset path of ``layer`` as a layer in ``folder`` has to spell it.

    Addresses of a resolver's own (``asset:...``) stay as they are; a path that resolves to nothing
    keeps pointing to the place where its file should be. Expressions are replaced by their value.
    """
    authored = str(value.evaluatedPath or value.authoredPath)
    if not authored or _SCHEME.match(authored):
        return Sdf.AssetPath(authored)
    resolved = str(value.resolvedPath)
    if not resolved and layer is not None and not layer.anonymous:
        resolved = Sdf.ComputeAssetPathRelativeToLayer(layer, authored)
    if not os.path.isabs(resolved):
        return Sdf.AssetPath(authored)
    return Sdf.AssetPath(relative_asset_path(resolved, folder))


def _authoring_layer(attribute: Usd.Attribute, at: Usd.TimeCode) -> Sdf.Layer | None:
    for spec in attribute.GetPropertyStack(at):
        if spec.HasInfo("timeSamples") or spec.HasInfo("default"):
            return spec.layer
    return None
