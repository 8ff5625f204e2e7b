"""Names of a result's files and grids: a stem per Volume, a number per timeCode."""

import math
import os
import re
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from usdsmoke.base.errors import LayerError

# Relationship, field prim and grid of one field have the same name: renderers differ in which of
# them they look up.
EMISSION = "emission"  # Storm's own shader reads this name
SCATTER_COLOURS = ("Cd", "color")  # Houdini's, and Arnold's by custom; Blender's and Cycles'
COLOUR_VECTORS = (EMISSION, *SCATTER_COLOURS)

DEFAULT_LOOK = "stylized"  # the look whose name is not part of its files' names
VARIANT_SET = "look"  # of an asset: ORIGINAL, and the names of its looks
RUN_RECORD = "run.json"  # in the folder of a run, OUT/vdb/KEY
ORIGINAL = "original"  # the variant without a look
ASSET_SOURCE = "usdsmokeAssetSource"  # in an asset's customLayerData: its source, relative

_DECIMALS = 6  # most decimals of a fractional timeCode


def channel_names(name: str) -> tuple[str, str, str]:
    """Names of the red, green and blue parts of a colour.

    Houdini's ``emission.x`` is not a valid name of a USD prim or property.

    >>> channel_names("emission")
    ('emission_r', 'emission_g', 'emission_b')
    """
    return f"{name}_r", f"{name}_g", f"{name}_b"


COLOUR_CHANNELS = tuple(part for name in COLOUR_VECTORS for part in channel_names(name))


def colour_names(scatter_colours: Collection[str] = (), split: bool = False) -> tuple[str, ...]:
    """The colour grids of a result, in their order in its files.

    >>> colour_names(["Cd"])
    ('emission', 'Cd')
    >>> colour_names(split=True)
    ('emission', 'emission_r', 'emission_g', 'emission_b')

    Args:
        split: True if each colour has three grids of floats beside its grid of vectors.
    """
    vectors = [name for name in COLOUR_VECTORS if name == EMISSION or name in scatter_colours]
    if not split:
        return tuple(vectors)
    return tuple(name for vector in vectors for name in (vector, *channel_names(vector)))


def volume_stems(prim_paths: Sequence[str], name: str = "") -> tuple[str, ...]:
    """A file stem for each Volume; all differ even if case is ignored.

    >>> volume_stems(["/shot/plume", "/a/fog", "/b/fog"])
    ('plume', 'a_fog', 'b_fog')

    Args:
        name: replaces the prim's name; with several Volumes it is put before it.
    """
    if name and len(prim_paths) == 1:
        return (name,)
    last = [_clean(path.rsplit("/", 1)[-1]) for path in prim_paths]
    whole = [_clean(path.strip("/").replace("/", "_")) for path in prim_paths]
    folded = [stem.casefold() for stem in last]
    stems: list[str] = []
    for short, long in zip(last, whole, strict=True):
        stem = short if folded.count(short.casefold()) == 1 else long
        stem = f"{name}_{stem}" if name else stem
        taken = {other.casefold() for other in stems}
        number, unique = 2, stem
        while unique.casefold() in taken:
            unique, number = f"{stem}_{number}", number + 1
        stems.append(unique)
    return tuple(stems)


def look_suffix(look: str) -> str:
    """The suffix that a look adds to the stems of its files; empty for the default look.

    >>> look_suffix("stylized"), look_suffix("ember")
    ('', '_ember')
    """
    return "" if look == DEFAULT_LOOK else f"_{look}"


def frame_file_names(
    stem: str, time_codes: Sequence[float], suffix: str = ".vdb"
) -> tuple[str, ...]:
    """``STEM.####.vdb`` for each timeCode; the numbers are the timeCodes, padded to one width.

    If any timeCode is fractional, all have the same number of decimals.

    >>> frame_file_names("plume", [1, 2])
    ('plume.0001.vdb', 'plume.0002.vdb')
    >>> frame_file_names("plume", [1, 1.5])
    ('plume.0001.0.vdb', 'plume.0001.5.vdb')

    Raises:
        LayerError: two timeCodes are so close that their names would be the same.
    """
    decimals = 0
    while decimals < _DECIMALS and not _is_exact(time_codes, decimals):
        decimals += 1
    digits = max((len(str(abs(math.trunc(code)))) for code in time_codes), default=0)
    width = max(4, digits) + (decimals + 1 if decimals else 0)
    names = []
    for code in time_codes:
        sign = "-" if code < 0 else ""
        names.append(f"{stem}.{sign}{abs(code):0{width}.{decimals}f}{suffix}")
    if len(set(names)) < len(names):
        raise LayerError(
            f"two timeCodes of {stem} differ by less than 1e-{_DECIMALS}, so their files would "
            "share a name. Select other frames."
        )
    return tuple(names)


def _clean(text: str) -> str:
    return re.sub(r"[^\w-]", "_", text) or "volume"


def _is_exact(time_codes: Sequence[float], decimals: int) -> bool:
    return all(abs(code - round(code, decimals)) < 0.5 * 10**-_DECIMALS for code in time_codes)


def run_record_files(output: Path) -> Iterator[Path]:
    """The records of the runs in an output folder, finished or not, sorted by name."""
    yield from sorted(output.glob(f"vdb/*/{RUN_RECORD}"))


def relative_asset_path(file_path: str | Path, folder: Path) -> str:
    """``file_path`` relative to ``folder``, with / and a leading dot; absolute across drives.

    The leading dot makes USD look beside the layer only. If symbolic links lead to the file's
    folder, the shorter of the paths with and without resolved links is used: it stays valid however
    a tree that contains both is reached.

    >>> relative_asset_path("/shot/look/vdb/smoke.0001.vdb", Path("/shot/look"))
    './vdb/smoke.0001.vdb'
    """
    target, start = os.path.abspath(file_path), os.path.abspath(folder)
    followed = os.path.join(os.path.realpath(os.path.dirname(target)), os.path.basename(target))
    try:
        ways = [os.path.relpath(place, start).replace(os.sep, "/") for place in (target, followed)]
    except ValueError:  # no relative path leads from one Windows drive to another
        return target.replace(os.sep, "/")
    relative = min(ways, key=lambda way: way.count("/"))
    return relative if relative.startswith("../") else f"./{relative}"
