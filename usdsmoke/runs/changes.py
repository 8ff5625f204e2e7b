"""What differs between a run and a call, in words that name what people change."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

_MOST_CHANGES = 6  # that a message names
_LONGEST = 60  # letters of a value
_DIGEST = re.compile(r"\b([0-9a-f]{12})[0-9a-f]{52}\b")
_VOLUME = re.compile(r"stage\.(<[^>]*>)\.(\w+)")
_REQUEST = re.compile(r"requests\.(/[^.]*)\.(?:settings\.)?(.*)")

# What a digest of a Volume's values stands for; see ``planning.stage_values.stage_pieces``.
_PIECES = {
    "timeCodes": "the timeCodes of {} differ",
    "fields": "the fields of {} differ (field prims, grids or types)",
    "places": "the place of {} differs (a transform)",
    "lights": "the light on {} differs",
    "cameras": "the camera through which {} is seen differs",
    "controls": "animated settings of {} differ",
    "otherFields": "other fields of {} differ",
}
_FRAMES = "settings.stage.frames"
FOLLOW_FRAMES = tuple(_PIECES)[:6]  # digests over the selected frames


@dataclass(frozen=True)
class Changes:
    """Differences; false where there are none."""

    words: tuple[str, ...] = ()  # the most telling first
    details: str = ""  # all of them, with the beginnings of hashes
    frames: bool = False  # whether the selected frames differ
    files: frozenset[str] = frozenset()  # VDB files with other content, by their recorded names
    only_files: bool = False  # nothing else differs

    def __bool__(self) -> bool:
        return bool(self.details)

    def __str__(self) -> str:
        more = len(self.words) - _MOST_CHANGES
        text = "; ".join(self.words[:_MOST_CHANGES])
        return text + (f" and {more} more" if more > 0 else "")


def find_changes(
    earlier: Mapping[str, Any],
    later: Mapping[str, Any],
    folder: Path | None = None,
    variants: tuple[Mapping[str, str], Mapping[str, str]] = ({}, {}),
    stages: tuple[str, str] = ("", ""),
) -> Changes:
    """What differs between two descriptions of runs.

    >>> str(find_changes({"settings": {"optimize": {"seed": 0}}}, {"settings": {"optimize": {}}}))
    'the setting optimize.seed was 0, now absent'
    >>> str(find_changes({"styles": ["a.png 0f"]}, {"styles": ["b.png 1e"]}))
    'the style was a.png, now b.png'

    Args:
        earlier, later: see ``identity.describe_run``.
        folder: of the stage, to tell when a file was written.
        variants: selected then and now, by variant set.
        stages: the files then and now; another one is no difference by itself.
    """
    before, after = dict(_flatten(earlier)), dict(_flatten(later))
    names = [name for name in sorted({*before, *after}) if before.get(name) != after.get(name)]
    if not names:
        return Changes()
    words = [f"the stage was {stages[0]}, now {stages[1]}"] if stages[0] != stages[1] else []
    words += [*_frames(before, after), *_variants(*variants), *_styles(earlier, later)]
    range_differs = _FRAMES in names
    for name in names:
        absent = name not in before or name not in after
        piece = _VOLUME.fullmatch(name)
        follows = piece is not None and piece[2] in FOLLOW_FRAMES
        if range_differs and (follows or (absent and name.startswith("files."))):
            continue  # a consequence
        if follows and piece is not None and _has_other_codes(piece, names):
            continue  # of other frames; the same frames may be as they were
        if name == _FRAMES or name.startswith("styles["):
            continue  # said already
        if ".styles[" in name and earlier.get("styles") != later.get("styles"):
            continue  # the run's images are those of all requests too
        words.append(_in_words(name, before, after, folder))
    details = "\n".join(
        f"{name}: was {_shown(before, name)}, now {_shown(after, name)}" for name in names
    )
    files = frozenset(
        name.removeprefix("files.")
        for name in names
        if name.startswith("files.") and name in before and name in after
    )
    return Changes(tuple(words), details, range_differs, files, len(files) == len(names))


def _has_other_codes(piece: re.Match[str], names: Sequence[str]) -> bool:
    """Whether a digest is of frames whose timeCodes are among the differences; not that of these
    itself."""
    return piece[2] != "timeCodes" and f"stage.{piece[1]}.timeCodes" in names


def _frames(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[str]:
    then, now = (values.get(_FRAMES) or "all" for values in (before, after))
    if then != now:
        yield f"the frames were {then}, now {now}"


def _variants(before: Mapping[str, str], after: Mapping[str, str]) -> Iterator[str]:
    for name in sorted({*before, *after}) if before else ():
        then, now = before.get(name), after.get(name)
        if then != now:
            yield f"the variant {name} was {then or 'absent'}, now {now or 'absent'}"


def _styles(earlier: Mapping[str, Any], later: Mapping[str, Any]) -> Iterator[str]:
    then, now = (list(values.get("styles", ())) for values in (earlier, later))
    if then == now:
        return
    names = [[item.rpartition(" ")[0] for item in items] for items in (then, now)]
    if names[0] != names[1]:
        was, is_now = (", ".join(items) or "absent" for items in names)
        yield f"the style was {was}, now {is_now}"
    else:
        others = [name for name, one, two in zip(names[0], then, now, strict=True) if one != two]
        yield f"the style image {', '.join(others)} has other content"


def _in_words(
    name: str, before: Mapping[str, Any], after: Mapping[str, Any], folder: Path | None
) -> str:
    """One difference."""
    kind, _, rest = name.partition(".")
    if kind == "files":
        return _file(rest, name in before, name in after, folder)
    if (piece := _VOLUME.fullmatch(name)) and piece[2] in _PIECES:
        return _PIECES[piece[2]].format(piece[1])
    if name == "features_hash":
        return "the feature network's parameters differ"
    if name == "start_hash":
        return "the network that frames start from (optimize.start) differs"
    text = f"was {_shown(before, name)}, now {_shown(after, name)}"
    if request := _REQUEST.fullmatch(name):
        return f"the request of <{request[1]}> for {request[2]} {text}"
    names = {"settings": "the setting", "stage": "the stage's", "version": "usdsmoke's version"}
    return f"{names.get(kind, kind)} {rest} {text}" if rest else f"{names.get(kind, kind)} {text}"


def _file(name: str, was: bool, is_now: bool, folder: Path | None) -> str:
    if not (was and is_now):
        return f"the file {name} is {'no longer ' if was else 'now '}read"
    file_path = None if folder is None else folder / name
    if file_path is None or not file_path.is_file():
        return f"the file {name} has other content"
    written = datetime.fromtimestamp(file_path.stat().st_mtime)
    return f"the file {name} has other content, written {written:%Y-%m-%d %H:%M}"


def _flatten(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _flatten(value, f"{prefix}{name}.")
        elif name == "styles" and isinstance(value, Sequence):  # images: each for itself
            yield from ((f"{prefix}{name}[{n}]", item) for n, item in enumerate(value))
        else:
            yield f"{prefix}{name}", value


def _shown(values: Mapping[str, Any], name: str) -> str:
    """A value as people read it: of digests the first digits, of long texts the beginning."""
    if name not in values:
        return "absent"
    if values[name] is None:
        return "unset"
    text = _DIGEST.sub(r"\1...", json.dumps(values[name], ensure_ascii=False))
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
