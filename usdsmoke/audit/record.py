"""Records of runs, found from whatever is at hand: a layer, a stage, a file, a folder."""

import os
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf, Usd

from usdsmoke.base.errors import FileUnreadable, LayerError, StageError
from usdsmoke.base.naming import find_look_layers, find_run_files
from usdsmoke.base.record_format import (
    RECORD_FILE,
    RECORD_FORMAT,
    FrameRecord,
    RunRecord,
    SourceGrid,
    StyleRecord,
    short_run_id,
)
from usdsmoke.usd.diagnostics import captured_diagnostics, layer_problem, open_quietly
from usdsmoke.usd.field_samples import field_targets
from usdsmoke.usd.layer_record import read_record, record_values
from usdsmoke.usd.schema import RUN, SEED, STYLE
from usdsmoke.vdb.content_hash import CONTENT_KEY
from usdsmoke.vdb.header import read_header

_LAYERS = (".usda", ".usdc", ".usd")
_OURS = "usdsmoke:"


@dataclass(frozen=True)
class FoundRecord:
    """The record of one run, and where it was found."""

    file: Path  # a look layer; without one ``provenance.json``, or a frame's VDB file
    folder: Path  # that files in the record are relative to
    layer: Sdf.Layer | None = None  # None where there is no look layer
    depth: int = 0  # composition arcs from the file that was asked for
    known: RunRecord | None = None  # where there is no look layer
    lost_layer: Path | None = None  # the folder that should hold a look layer, and does not

    @cached_property
    def record(self) -> RunRecord:
        """What is recorded.

        Raises:
            LayerError: the record cannot be read, or has a format of another version.
        """
        if self.known is not None:
            return self.known
        assert self.layer is not None  # one of both is there
        try:
            return read_record(self.layer)
        except LayerError as error:  # the layer is read anonymously and has no name
            text = str(error).replace(self.layer.identifier, str(self.file))
            raise LayerError(text) from None

    def place(self, name: str) -> Path:
        """The file of a path in the record."""
        return Path(os.path.normpath(self.folder / name))

    def to_dict(self) -> dict[str, Any]:
        """As JSON values, with the file that holds the record."""
        return {"file": str(self.file), **self.record.to_json()}


def provenance(file: str | PathLike[str]) -> list[FoundRecord]:
    """How a result was made: the records of the looks that a file belongs to, nearest first.

    >>> provenance("look/look.usda")[0].record.settings["windows"]["size"]  # doctest: +SKIP
    8

    Args:
        file: as ``find_records`` takes it.

    Raises:
        UsdSmokeError: see ``find_records``; a record cannot be read.
    """
    found = find_records(file)
    for item in found:
        _ = item.record
    return found


def find_records(file: str | PathLike[str]) -> list[FoundRecord]:
    """The records of the looks that a file or folder belongs to, nearest first; not yet read.

    Args:
        file: a look layer; a stage or asset that has looks in its layer stack, references or
            variants; a flattened stage; a VDB file of a result; an output folder, whose runs'
            ``provenance.json`` tell where its look layers are lost; or one of these.

    Raises:
        FileUnreadable: there is no such file or folder.
        StageError: USD cannot read it.
        GridError: a VDB file is damaged.
        LayerError: it has no record.
    """
    path = Path(file).absolute()
    what = "Give a look layer, a stage with a look, a VDB file of a result or an output folder."
    if not path.exists():
        raise FileUnreadable(f"there is no file or folder {path}. {what}")
    if path.is_dir():
        found = _in_folder(path) or _in_runs(path)
    elif path.suffix.lower() == ".vdb":
        found = _of_grids(path)
    elif path.name == RECORD_FILE:
        found = [_of_run(path)]
    else:
        found = list(_of_layers(path)) or list(_of_authorship(path))
    if not found:
        raise LayerError(f"{path} has no usdsmoke record. {what}")
    return found


def _in_folder(folder: Path) -> list[FoundRecord]:
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _LAYERS)
    layers = [(path, _open(path)) for path in files]
    return [
        FoundRecord(path, folder, layer)
        for path, layer in layers
        if layer is not None and record_values(layer)
    ]


def _in_runs(folder: Path) -> list[FoundRecord]:
    """What the runs of an output folder recorded, or one run in its own folder."""
    own = folder / RECORD_FILE
    records = [own] if os.path.isfile(own) else find_run_files(folder, RECORD_FILE)
    return [replace(_of_run(record), lost_layer=folder) for record in records]


def _of_run(path: Path) -> FoundRecord:
    """The record in the folder of a run, OUT/vdb/KEY/provenance.json."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileUnreadable(f"cannot read {path} ({error}). Check its permissions.") from None
    output = path.parents[2] if len(path.parents) > 2 else path.parent
    return FoundRecord(path, output, known=RunRecord.from_text(text, str(path)))


def _of_grids(path: Path) -> list[FoundRecord]:
    """The look that a frame belongs to, else its run's record, else what the file itself says."""
    metadata = read_header(path).metadata
    run = str(metadata.get(_OURS + "run", ""))
    if not run:
        return []
    for output in path.parents:  # OUT/vdb/KEY/NAME.vdb, or as layer.files puts it
        looks = _in_folder(output) if find_look_layers(output) else []
        records = map(_of_run, find_run_files(output, RECORD_FILE))
        for found in (looks, records):
            if ours := [r for r in found if run in (r.record.run, *r.record.grown_from)]:
                return ours
    return [FoundRecord(path, path.parent, known=_of_metadata(path, metadata))]


def _of_metadata(path: Path, metadata: Mapping[str, Any]) -> RunRecord:
    """What a frame's file knows without the record of its run."""
    ours = {k.removeprefix(_OURS): str(v) for k, v in metadata.items() if k.startswith(_OURS)}
    source = ours.get("source", "")
    grids = tuple(
        SourceGrid(field, source, field, ours[key])
        for field in ("density", "mask", "velocity")
        if (key := "source_sha256" if field == "density" else f"{field}_sha256") in ours
    )
    place = f"./{path.name}"
    return RunRecord(
        format=RECORD_FORMAT,
        run=ours["run"],
        version=ours.get("version", ""),
        frames=(FrameRecord(place, "", 0.0, grids),),
        results={place: str(metadata.get(CONTENT_KEY, ""))},
    )


def _of_layers(path: Path) -> Iterator[FoundRecord]:
    """The layer's own record; without one, those of what it is composed from, nearest first."""
    root = _open(path)
    if root is None:
        raise StageError(layer_problem(str(path)))
    waiting, seen = deque([(path, root, 0)]), {str(path)}
    while waiting:
        place, layer, depth = waiting.popleft()
        if record_values(layer):
            yield FoundRecord(place, place.parent, layer, depth)
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


def _of_authorship(path: Path) -> Iterator[FoundRecord]:
    """What a flattened stage keeps: the run on each Volume, and the files that it shows.

    The files lead to the run's record; where they are gone, the authorship is all that there is.
    """
    stage, seen = open_quietly(str(path)), set[str]()
    for prim in stage.Traverse():
        run = str(prim.GetAttribute(RUN).Get() or "") if prim.HasAttribute(RUN) else ""
        if not run or run in seen:
            continue
        seen.add(run)
        fields = [stage.GetPrimAtPath(p) for p in _field_paths(prim)]
        assets = [
            field.GetAttribute("filePath").Get(Usd.TimeCode.EarliestTime())
            for field in fields
            if field
        ]
        files = [
            Path(asset.resolvedPath)
            for asset in assets
            if asset and os.path.isfile(asset.resolvedPath)
        ]
        for file in files:
            found = [
                item
                for item in _of_grids(file)
                if run in (item.record.run, *item.record.grown_from)
            ]
            if found:
                yield from found
                break
        else:
            yield FoundRecord(path, path.parent, known=_authorship(prim, run))


def _field_paths(prim: Usd.Prim) -> list[Sdf.Path]:
    targets = (paths for name, paths in sorted(field_targets(prim).items()))
    return [path for paths in targets for path in paths if path.IsPrimPath()]


def _authorship(prim: Usd.Prim, run: str) -> RunRecord:
    """A record of what UsdMedia's authorship and the look's attributes say."""
    names = [
        n
        for n in prim.GetPropertyNames()
        if n.startswith(f"authorship:usdsmoke_{short_run_id(run)}")
    ]
    said = {name.rpartition(":")[2]: prim.GetAttribute(name).Get() for name in names}
    styles = [str(text).rpartition(" ") for text in prim.GetAttribute(STYLE).Get() or ()]
    return RunRecord(
        format=RECORD_FORMAT,
        run=run,
        version=str(said.get("softwareVersion") or ""),
        created=str(said.get("created") or ""),
        seed=int(prim.GetAttribute(SEED).Get() or 0),
        styles=tuple(StyleRecord(name, sha256) for name, _, sha256 in styles),
    )


def _resolve(name: str, beside: Path) -> Path | None:
    """The file that an asset path in a layer means; None when there is none."""
    resolver = Ar.GetResolver()
    identifier = resolver.CreateIdentifier(name, Ar.ResolvedPath(str(beside)))
    resolved = str(resolver.Resolve(identifier))
    return Path(resolved) if os.path.isfile(resolved) else None


def _open(path: Path) -> Sdf.Layer | None:
    """The layer as it is on the disk now, whatever this process has open; None for no layer."""
    with captured_diagnostics():
        try:
            return Sdf.Layer.OpenAsAnonymous(str(path))
        except Tf.ErrorException:
            return None
