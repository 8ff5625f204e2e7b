"""Records of runs, found from whatever somebody has at hand: a layer, a stage, a file, a folder."""

import json
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf, Vt

from usdsmoke.base.errors import FileUnreadable, LayerError, StageError
from usdsmoke.usd import captured_diagnostics, short_reason
from usdsmoke.usd.look import RECORD_KEY
from usdsmoke.vdb.content_hash import CONTENT_KEY
from usdsmoke.vdb.header import read_header

__all__ = ["LookRecord", "find_records", "split_pair"]

_LAYERS = (".usda", ".usdc", ".usd")
_OURS = "usdsmoke:"
_FRAME_KEYS = {"file", "prim", "timeCode", "sources"}


@dataclass(frozen=True)
class LookRecord:
    """The record of one look: see ``provenance.build_provenance`` for its keys."""

    file: Path  # that holds it: a look layer, or a frame's VDB file without one
    values: Mapping[str, Any]  # whole numbers, texts, lists of texts
    layer: Sdf.Layer | None  # None where a VDB file is all there is
    depth: int = 0  # composition arcs from the file that was asked for

    @property
    def folder(self) -> Path:
        """What paths in the record are relative to."""
        return self.file.parent

    def texts(self, key: str) -> list[str]:
        """A list of the record; empty where it has none."""
        found = self.values.get(key, [])
        return [str(item) for item in found] if isinstance(found, list) else []

    def pairs(self, key: str) -> dict[str, str]:
        """A list of texts ``name=value`` by name."""
        return dict(split_pair(text) for text in self.texts(key))

    def parsed(self, key: str) -> dict[str, Any]:
        """A JSON text of the record; empty where it has none, or none that can be read."""
        return _parsed(str(self.values.get(key, "")))

    def request(self) -> dict[str, Any]:
        """What it takes to run again; empty where stage or images are not named."""
        request = self.parsed("request")
        return request if {"stage", "styles"} <= request.keys() else {}

    def frames(self) -> list[dict[str, Any]]:
        """The frames of the result: ``file``, ``prim``, ``timeCode``, ``sources``."""
        found = [_parsed(text) for text in self.texts("frames")]
        return [frame for frame in found if _FRAME_KEYS <= frame.keys()]

    def to_dict(self) -> dict[str, Any]:
        """Plain values with the JSON texts read, for machines."""
        values: dict[str, Any] = {"file": str(self.file), **self.values}
        for key in ("config", "request", "inputState"):
            if key in values:
                values[key] = self.parsed(key)
        if "frames" in values:
            values["frames"] = self.frames()
        return values


def split_pair(text: str) -> tuple[str, str]:
    """Name and value of ``name=value``; names may hold more of these signs, hashes do not.

    >>> split_pair("a=b.vdb density=ff")
    ('a=b.vdb density', 'ff')
    """
    name, _, value = text.rpartition("=")
    return name, value


def find_records(file: str | PathLike[str]) -> list[LookRecord]:
    """The records of the looks that a file or folder belongs to, nearest first.

    Args:
        file: a look layer; a stage or asset that has looks in its layer stack, references or
            variants; a VDB file of a result; or an output folder.

    Raises:
        FileUnreadable: there is no such file or folder.
        StageError: USD cannot read it.
        GridError: a VDB file is damaged.
        LayerError: it has no record.
    """
    path = Path(file).absolute()
    if not path.exists():
        raise FileUnreadable(
            f"there is no {path}; give a look layer, a stage with a look, a VDB file of a result "
            "or an output folder"
        )
    if path.is_dir():
        found = _in_folder(path)
    elif path.suffix.lower() == ".vdb":
        found = _of_grids(path)
    else:
        found = list(_of_layers(path))
    if not found:
        raise LayerError(
            f"{path} has no record of usdsmoke; give a look layer, a stage with a look in it, a "
            "VDB file of a result or an output folder"
        )
    return found


def _in_folder(folder: Path) -> list[LookRecord]:
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _LAYERS)
    found = []
    for path in files:
        layer = _open(path)
        record = _record_of(layer) if layer is not None else {}
        if record:
            found.append(LookRecord(path, record, layer))
    return found


def _of_grids(path: Path) -> list[LookRecord]:
    """The look that a frame belongs to, or what the file itself says where there is none."""
    metadata = read_header(path).metadata
    run = str(metadata.get(_OURS + "run", ""))
    if not run:
        return []
    output = path.parents[2] if len(path.parents) > 2 else path.parent  # OUT/vdb/KEY/NAME.vdb
    looks = [look for look in _in_folder(output) if look.values.get("run") == run]
    return looks or [LookRecord(path, _as_record(path, metadata), None)]


def _as_record(path: Path, metadata: Mapping[str, Any]) -> dict[str, Any]:
    """The metadata of a frame's file under the keys of a layer's record."""
    ours = {
        key.removeprefix(_OURS): value for key, value in metadata.items() if key.startswith(_OURS)
    }
    same = ("version", "run", "created", "platform", "seed", "config", "features", "featuresHash")
    styles = [str(text).rpartition(" ") for text in _listed(str(ours.get("styles", "")))]
    return {
        "tool": "usdsmoke",
        **{key: ours[key] for key in same if key in ours},
        "packages": [text for text in str(ours.get("packages", "")).split(", ") if text],
        "styles": [f"{name}={digest}" for name, _, digest in styles],
        "inputs": [f"{ours.get('source', '')} density={ours.get('source_sha256', '')}"],
        "results": [f"./{path.name}={metadata.get(CONTENT_KEY, '')}"],
    }


def _of_layers(path: Path) -> Iterator[LookRecord]:
    """The layer's own record; without one, those of what it is composed from, nearest first."""
    root = _open(path)
    if root is None:
        raise StageError(_refusal(path))
    waiting, seen = deque([(path, root, 0)]), {str(path)}
    while waiting:
        place, layer, depth = waiting.popleft()
        record = _record_of(layer)
        if record:
            yield LookRecord(place, record, layer, depth)
            if depth == 0:
                return
        for name in layer.GetCompositionAssetDependencies():
            found = _resolve(name, place)
            if found is None or str(found) in seen:
                continue
            seen.add(str(found))
            opened = _open(found)
            if opened is not None:
                waiting.append((found, opened, depth + 1))


def _resolve(name: str, beside: Path) -> Path | None:
    """The file that an asset path in a layer means; None when there is none."""
    resolver = Ar.GetResolver()
    identifier = resolver.CreateIdentifier(name, Ar.ResolvedPath(str(beside)))
    resolved = str(resolver.Resolve(identifier))
    return Path(resolved) if resolved and Path(resolved).is_file() else None


def _open(path: Path) -> Sdf.Layer | None:
    """The layer as it is on the disk now, whatever this process has open; None for no layer."""
    with captured_diagnostics():
        try:
            return Sdf.Layer.OpenAsAnonymous(str(path))
        except Tf.ErrorException:
            return None


def _record_of(layer: Sdf.Layer) -> dict[str, Any]:
    record = layer.customLayerData.get(RECORD_KEY, {})
    if not isinstance(record, dict) or "run" not in record:
        return {}
    return {key: _plain(value) for key, value in record.items()}


def _plain(value: Any) -> int | str | list[str]:
    """As it was written; whatever an editing hand has put in its place as text."""
    if isinstance(value, (str, int)):
        return value
    return [str(item) for item in value] if isinstance(value, Vt.StringArray) else str(value)


def _parsed(text: str) -> dict[str, Any]:
    """A JSON mapping; empty where it cannot be read."""
    try:
        value = json.loads(text or "{}")
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}


def _listed(text: str) -> list[Any]:
    """A JSON list; empty where it cannot be read."""
    try:
        value = json.loads(text or "[]")
    except ValueError:
        return []
    return value if isinstance(value, list) else []


def _refusal(path: Path) -> str:
    try:
        with captured_diagnostics():
            Sdf.Layer.OpenAsAnonymous(str(path))
    except Tf.ErrorException as error:
        return f"cannot read {path}: {short_reason(error)}; wanted a layer, a stage or a VDB file"
    return f"cannot read {path}; wanted a layer, a stage or a VDB file"
