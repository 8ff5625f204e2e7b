"""Names of a result's files and grids: a stem per Volume, a number per timeCode; and its files."""

import math
import os
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from usdsmoke.base.errors import ConfigError, LayerError

# Relationship, field prim and grid of one field have the same name: renderers differ in which of
# them they look up.
EMISSION = "emission"  # Storm's own shader reads this name
SCATTERING = "scattering"  # in parts alone: sigma times the albedo, as the emission is sigma C
SCATTER_COLOURS = ("Cd", "color")  # Houdini's, and Arnold's by custom; Blender's and Cycles'
COLOUR_VECTORS = (EMISSION, *SCATTER_COLOURS)

DEFAULT_LOOK = "stylized"  # the look whose name is not part of its files' names
VARIANT_SET = "look"  # of an asset: ORIGINAL, and the names of its looks
RUN_RECORD = "run.json"  # in the folder of a run, OUT/vdb/KEY
ORIGINAL = "original"  # the variant without a look
RUNS_FOLDER = "vdb"  # of the output folder: holds a folder for each run
ASSET_SOURCE = "usdsmokeAssetSource"  # in an asset's customLayerData: its source, relative

_DECIMALS = 6  # most decimals of a fractional timeCode
_FIELD = re.compile(r"\{(\w*)(?::([^{}]*))?\}")  # of a template: name and format
_WIDTH = re.compile(r"0[1-9]d")


def channel_names(name: str) -> tuple[str, str, str]:
    """Names of the red, green and blue parts of a colour.

    Houdini's ``emission.x`` is not a valid name of a USD prim or property.

    >>> channel_names("emission")
    ('emission_r', 'emission_g', 'emission_b')
    """
    return f"{name}_r", f"{name}_g", f"{name}_b"


COLOUR_CHANNELS = tuple(part for name in COLOUR_VECTORS for part in channel_names(name))


def colour_names(
    scatter_colours: Collection[str] = (), split: bool = False, emits: bool = True
) -> tuple[str, ...]:
    """The colour grids of a result, in their order in its files.

    >>> colour_names(["Cd"])
    ('emission', 'Cd')
    >>> colour_names(split=True)
    ('emission', 'emission_r', 'emission_g', 'emission_b')

    Args:
        split: True if each colour has three grids of floats beside its grid of vectors.
        emits: False without an emission.
    """
    wanted = {EMISSION, *scatter_colours} if emits else set(scatter_colours)
    vectors = [name for name in COLOUR_VECTORS if name in wanted]
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
    return tuple(f"{stem}.{number}{suffix}" for number in _frame_numbers(stem, time_codes))


def _frame_numbers(stem: str, time_codes: Sequence[float], least: int = 4) -> list[str]:
    """A number for each timeCode, padded to one width of at least ``least`` whole digits."""
    decimals = 0
    while decimals < _DECIMALS and not _is_exact(time_codes, decimals):
        decimals += 1
    digits = max((len(str(abs(math.trunc(code)))) for code in time_codes), default=0)
    width = max(least, digits) + (decimals + 1 if decimals else 0)
    numbers = [f"{'-' if code < 0 else ''}{abs(code):0{width}.{decimals}f}" for code in time_codes]
    if len(set(numbers)) < len(numbers):
        raise LayerError(
            f"two timeCodes of {stem} differ by less than 1e-{_DECIMALS}, so their files would "
            "share a name. Select other frames."
        )
    return numbers


def frame_places(
    template: str, names: Mapping[str, str], time_codes: Sequence[float]
) -> dict[float, str]:
    """The path that ``layer.files`` gives each frame's file in the output folder, by timeCode.

    >>> frame_places("{look}/{name}.{frame:03d}.vdb", {"look": "ember", "name": "fog"}, [7])
    {7: 'ember/fog.007.vdb'}

    Args:
        template: relative, with ``/`` between folders; its fields are ``{frame}``, with a width
            such as ``{frame:04d}``, and those of ``names``. "" gives no paths.
        names: text by field; letters, digits, ``_``, ``-`` and ``.`` only.

    Raises:
        ConfigError: a field is unknown, there is no ``{frame}``, or the path does not name a
            VDB file inside the output folder.
        LayerError: two timeCodes are too close for names of their own.
    """
    if not template:
        return {}
    parts = _FIELD.split(template)
    literal, fields, formats = "".join(parts[::3]), parts[1::3], parts[2::3]
    known = [f"{{{name}}}" for name in (*names, "frame")]
    for field, form in zip(fields, formats, strict=True):
        if f"{{{field}}}" not in known:
            raise _wrong_template(template, f"the field {{{field}}}", f"Use {', '.join(known)}")
        if form and (field != "frame" or not _WIDTH.fullmatch(form)):
            what = f"the format {form!r} of {{{field}}}"
            raise _wrong_template(template, what, "Only {frame} has one, such as {frame:04d}")
    if template.startswith("/"):
        raise _wrong_template(template, "an absolute path", "Give a path inside the output folder")
    if strange := re.sub(r"[\w./-]", "", literal):
        raise _wrong_template(template, repr(strange), "Use letters, digits, _ - . and / alone")
    if "frame" not in fields:
        raise _wrong_template(template, "no {frame}", "Each frame needs a file of its own")
    if not template.endswith(".vdb"):
        raise _wrong_template(template, "no suffix .vdb", "Add it")
    width = max((int(form[:-1]) for form in formats if form), default=1)
    places = {}
    for code, number in zip(time_codes, _frame_numbers(template, time_codes, width), strict=True):
        values = {**names, "frame": number}
        places[code] = "".join(
            values[part] if place % 3 == 1 else part
            for place, part in enumerate(parts)
            if place % 3 < 2
        )
    folders = next(iter(places.values()), "").split("/")
    for folder in folders:
        if not folder or folder.startswith("."):
            raise _wrong_template(template, f"the part {folder!r}", "Give a path inside the output")
    if folders[0].casefold() == RUNS_FOLDER:
        raise _wrong_template(template, f"the folder {RUNS_FOLDER}", "That one holds the runs")
    return places


def _wrong_template(template: str, found: str, advice: str) -> ConfigError:
    return ConfigError(f"layer.files is {template!r}, with {found}. {advice}.")


def _clean(text: str) -> str:
    return re.sub(r"[^\w-]", "_", text) or "volume"


def _is_exact(time_codes: Sequence[float], decimals: int) -> bool:
    return all(abs(code - round(code, decimals)) < 0.5 * 10**-_DECIMALS for code in time_codes)


def find_run_files(output: Path, name: str = RUN_RECORD) -> list[Path]:
    """The files of one name in the folders of an output folder's runs, finished or not, sorted."""
    return sorted(output.glob(f"{RUNS_FOLDER}/*/{name}"))


def find_look_layers(output: Path) -> list[Path]:
    """The layers of the looks in an output folder, by their names alone, sorted."""
    return sorted([*output.glob("look.usd[ac]"), *output.glob("look_*.usd[ac]")])


def relative_asset_path(file_path: str | Path, folder: Path) -> str:
    """``file_path`` relative to ``folder``, with a leading dot.

    The leading dot makes USD look beside the layer only. If symbolic links lead to the file's
    folder, the shorter of the paths with and without resolved links is used: it stays valid however
    a tree that contains both is reached.

    >>> relative_asset_path("/shot/look/vdb/smoke.0001.vdb", Path("/shot/look"))
    './vdb/smoke.0001.vdb'
    """
    target, start = os.path.abspath(file_path), os.path.abspath(folder)
    followed = os.path.join(os.path.realpath(os.path.dirname(target)), os.path.basename(target))
    ways = [os.path.relpath(place, start) for place in (target, followed)]
    relative = min(ways, key=lambda way: way.count("/"))
    return relative if relative.startswith("../") else f"./{relative}"
