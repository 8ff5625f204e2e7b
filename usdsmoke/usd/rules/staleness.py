"""Whether the source has moved on since a look was made from it, as sentences."""

import os
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime, timezone
from functools import lru_cache
from pathlib import Path

from pxr import Sdf

from usdsmoke.base.errors import FileUnreadable, GridError, StageError
from usdsmoke.base.record_format import RunRecord, SourceGrid, hash_file
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.base.volume import StageSource
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.content_hash import hash_fields
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.vdb.velocity import read_velocity, scale_field

_AT = "%Y-%m-%d %H:%M"


def switched_variants(record: RunRecord, selected: Mapping[str, str]) -> Iterator[str]:
    """Variants that are not those which the look was made from.

    Args:
        selected: by ``</prim>{set}``; sets that are not there are not compared.
    """
    for name, then in record.variants.items():
        if name in selected and selected[name] != then:
            yield f"the variant {name} was {then} when the look was made, and is {selected[name]}"


def rewritten_sources(
    record: RunRecord, folder: Path, prim_path: str = ""
) -> Iterator[tuple[bool, str]]:
    """Source files that were written after the look, with other bytes.

    Args:
        folder: of the look layer.
        prim_path: the Volume whose files are looked at, as recorded; "": all.

    Returns:
        Whether all grids are the same whose hashes are recorded, and a sentence.
    """
    finished = _seconds(record.finished)
    if not (record.stage and finished):
        return
    stage = os.path.normpath(folder / record.stage)
    stage_folder, rate = Path(stage).parent, _velocity_factor(record, stage)
    used: dict[str, set[SourceGrid]] = {}
    for frame in record.frames:
        if prim_path in ("", frame.prim):
            for source in frame.sources:
                used.setdefault(os.path.normpath(folder / source.file), set()).add(source)
    for name, digest in record.source_files.items():
        path = os.path.normpath(stage_folder / name)
        if path not in used or not os.path.isfile(path):
            continue
        status = os.stat(path)
        if status.st_mtime <= finished:
            continue
        try:
            if _hash_once(path, status.st_mtime_ns, status.st_size) == digest:
                continue
        except FileUnreadable:
            continue
        hashed = [source for source in used[path] if source.hash]
        is_same = bool(hashed) and all(
            item.hash in _grid_hashes(path, item, rate) for item in hashed
        )
        what = "was written again with the same grids," if is_same else "has other content, written"
        others = ", ".join(sorted({item.grid for item in used[path]} - {s.grid for s in hashed}))
        unknown = f"; no hash is recorded of {others}" if others and is_same else ""
        yield (
            is_same,
            f"{name} {what} {written_at(path)}, after the look "
            f"({datetime.fromtimestamp(finished).strftime(_AT)}){unknown}",
        )


def switched_files(
    record: RunRecord,
    folder: Path,
    source: StageSource,
    at: Callable[[str, float], float] = lambda path, code: code,
) -> Iterator[tuple[str, str]]:
    """Volumes whose density now comes from other files, and a sentence for each.

    Args:
        folder: of the look layer.
        source: the stage without the look.
        at: the timeCode on that stage of a recorded one of a Volume.
    """
    for volume in source.volumes:
        then = {
            _rounded(at(frame.prim, frame.time_code)): os.path.normpath(folder / grid.file)
            for frame in record.frames
            if frame.prim == volume.prim_path
            for grid in frame.sources
            if grid.field == "density"
        }
        now = {_rounded(f.time_code): f.fields[volume.density].file_path for f in volume.frames}
        others = [
            code
            for code in sorted(then.keys() & now.keys())
            if os.path.realpath(then[code]) != os.path.realpath(now[code])
        ]
        if others:
            first = others[0]
            yield (
                volume.prim_path,
                f"the source shows {_beside(now[first], folder)} at timeCode {first:g}, and the "
                f"look was made from {_beside(then[first], folder)} (so at timeCodes "
                f"{format_time_codes(others)})",
            )
        there = {_rounded(code) for code in volume.time_codes}
        if gone := sorted(then.keys() - there if volume.animated else ()):
            yield (
                volume.prim_path,
                f"the source no longer has the timeCodes {format_time_codes(gone)}",
            )


def _rounded(time_code: float) -> float:
    """Equal for timeCodes that layer offsets have brought to one place in different steps."""
    return round(time_code, 6)


def written_at(path: str | Path) -> str:
    """When a file was written, local time to the minute."""
    return datetime.fromtimestamp(os.stat(path).st_mtime).strftime(_AT)


def _beside(path: str, folder: Path) -> str:
    return os.path.relpath(path, folder).replace(os.sep, "/")


def _seconds(text: str) -> float:
    """Seconds since 1970 of a time in a record; 0 if there is none."""
    try:
        moment = datetime.strptime(text, "%Y-%m-%dT%H:%M:%SZ")
    except ValueError:
        return 0.0
    return moment.replace(tzinfo=timezone.utc).timestamp() + 1  # it has no fraction


def _velocity_factor(record: RunRecord, stage: str) -> float:
    """What a run has multiplied velocities by: one in timeCodes is brought to seconds."""
    if record.settings.get("stage", {}).get("velocity_unit") != "frame":
        return 1.0
    layer = Sdf.Layer.FindOrOpen(stage)
    return float(layer.timeCodesPerSecond) if layer else 1.0


def _grid_hashes(path: str, source: SourceGrid, factor: float) -> set[str]:
    """The content hashes that a recorded grid would have as the file holds it now.

    Of a velocity both as it is read and as it is copied. One that layer offsets slow down was
    hashed in other units and so counts as another one.

    Args:
        factor: of velocities that are read.
    """
    try:
        labels = source.grid.split(", ")
        by_label = {grid.label: grid for grid in read_header(path).grids}
        if not by_label.keys() >= set(labels):
            return set()
        grids = [by_label[label] for label in labels]
        requests = [GridRequest(grid.name, grid.index) for grid in grids]
        found = {hash_fields(read_grids(path, requests, GridsConfig()))}
        if source.field == "velocity":
            velocity = read_velocity(path, grids, GridsConfig())
            found.add(hash_fields([scale_field(velocity, factor)]))
        return found
    except (GridError, StageError, ArithmeticError):
        return set()


@lru_cache(maxsize=4096)
def _hash_once(path: str, _modified: int, _size: int) -> str:
    return hash_file(path)
