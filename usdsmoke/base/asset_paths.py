"""Asset paths as they have to stand in a layer of another folder to mean the same file."""

import os
from pathlib import Path

__all__ = ["relative_asset_path"]


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
