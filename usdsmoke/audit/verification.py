"""What has changed since a result was made: inputs, stage, images, features, results, the layer.

Everything is compared with the record; nothing is written. The digests detect accidents and
forgotten edits. They are not signatures, and do not detect fraud.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from os import PathLike
from pathlib import Path

from usdsmoke import __version__
from usdsmoke.audit.inputs import Change, check_inputs, recorded_config, shown
from usdsmoke.audit.record import FoundRecord, find_records
from usdsmoke.base.errors import (
    BindingMissing,
    ConfigError,
    LayerError,
    StageError,
)
from usdsmoke.base.machine import package_versions, platform_name
from usdsmoke.base.naming import RUNS_FOLDER, find_look_layers
from usdsmoke.base.record_format import hash_file
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.runs.run import Run, damaged_records, find_runs
from usdsmoke.usd.diagnostics import open_quietly
from usdsmoke.usd.layer_record import (
    LAYER_HASH,
    RECORD_HASH,
    layer_digest,
    record_digest,
    record_values,
)
from usdsmoke.usd.look import look_files, shader_files
from usdsmoke.vdb.read import read_binding_version
from usdsmoke.vdb.written import FILES_AT_ONCE, State, compare_written


def verify(file: str | PathLike[str]) -> list[Change]:
    """What differs from the records that a file leads to; empty when all is as recorded.

    Changes of the severity ``note`` do not make the result another one: other versions of
    programs, a file that was written anew with the same grids, what could not be compared.

    Args:
        file: as ``find_records`` takes it.

    Raises:
        LayerError: it is a package, whose files are not compared.
        UsdSmokeError: see ``find_records``.
    """
    changes: list[Change] = []
    _check_is_unpacked(Path(file))
    for item in find_records(file):
        edited = list(_check_layer(item))
        changes += edited
        try:
            _ = item.record
        except LayerError:
            if any(change.kind == "record-edited" for change in edited):
                continue  # there is nothing left to compare with
            raise
        changes += [*_check_shaders(item), *_check_results(item), *_check_rest(item)]
        changes += [*check_inputs(item), *_check_versions(item)]
    return list(dict.fromkeys(changes))


def verify_inputs(item: FoundRecord) -> list[Change]:
    """Those changes of what a result was made from that make another result of it."""
    return [change for change in check_inputs(item) if change.severity != "note"]


def _check_is_unpacked(file: Path) -> None:
    if file.suffix.lower() == ".usdz":
        raise LayerError(
            f"{file} is a package, and the frames inside cannot be compared with the record. "
            "Unpack it (a .usdz is a zip), and verify the stage inside."
        )


def _check_layer(item: FoundRecord) -> Iterator[Change]:
    if item.lost_layer is not None:
        yield Change(
            "result-missing", str(item.lost_layer), "a look layer", _why_lost(item.lost_layer)
        )
    if item.layer is None:
        return
    file, values = str(item.file), record_values(item.layer)
    if LAYER_HASH not in values:
        yield Change.note("unchecked", file, "a digest of the layer", "a record without one")
        return
    found = layer_digest(item.layer)
    if found != values[LAYER_HASH]:
        yield Change("layer-edited", file, f"layer {shown(values[LAYER_HASH])}", shown(found))
    found = record_digest(item.layer)
    if found != values.get(RECORD_HASH):
        recorded = shown(values.get(RECORD_HASH, ""))
        yield Change("record-edited", file, f"record {recorded}", shown(found))


def _why_lost(folder: Path) -> str:
    """Why no look layer of a folder tells its record."""
    for layer_path in find_look_layers(folder):
        try:
            open_quietly(str(layer_path))
        except StageError as error:
            return f"none that can be read: {error}"
    return "none with a record"


def _check_shaders(item: FoundRecord) -> Iterator[Change]:
    """Files of shaders that the look's material names."""
    for name in shader_files(item.layer) if item.layer is not None else ():
        file, recorded = item.place(name), item.record.shaders.get(os.path.normpath(name), "")
        if not os.path.isfile(file):
            expected = "a shader of the look's material"
            yield Change("result-missing", str(file), expected, "no file")
        elif recorded and (found := hash_file(file)) != recorded:
            yield Change("result-edited", str(file), f"shader {shown(recorded)}", shown(found))


def _check_rest(item: FoundRecord) -> Iterator[Change]:
    """What shows the look, and what the run goes on from; both may be left behind on purpose."""
    if item.layer is None:
        return
    with suppress(ConfigError):
        root = look_files(item.record.stage, item.folder, recorded_config(item).layer).root_stage
        if root is not None and item.record.stage and not os.path.isfile(root):
            yield Change.note("root-missing", str(root), "the stage to open", "no file")
    if _run_of(item) is not None:
        return
    expected = "the record of the run, which assembles and repeats it"
    folders = {item.place(name).parent for name in item.record.results}
    damaged = [file for file in damaged_records(item.folder) if file.parent in folders]
    for file in damaged:
        yield Change.note("run-damaged", str(file), expected, "a file that cannot be read")
    if not damaged:
        yield Change.note("run-missing", str(item.folder / RUNS_FOLDER), expected, "no such record")


def _check_results(item: FoundRecord) -> list[Change]:
    if not item.record.results:  # only authorship is left, of frames in a package or nowhere
        expected = "frames of the result"
        return [Change("result-missing", str(item.file), expected, "none that can be read")]
    files = [item.place(name) for name in item.record.results]
    check = partial(_check_result, _run_of(item))
    with ThreadPoolExecutor(max_workers=FILES_AT_ONCE) as pool:
        found = pool.map(check, files, item.record.results.values())
    return [change for change in found if change is not None]


def _check_result(run: Run | None, path: Path, recorded: str) -> Change | None:
    """Compare the grids of a file, and its bytes if the record of their run is left.

    OpenVDB reads some damaged files without an error.
    """
    written = compare_written(path, recorded)
    file, expected, detail = str(path), f"grids {shown(recorded)}", written.found
    if written.state == State.UNCHECKED:
        if _has_other_bytes(run, path):
            return Change("result-edited", file, expected, f"other bytes, and {detail}")
        return Change.note("unchecked", file, expected, detail)
    if written.state == State.INTACT:
        if _has_other_bytes(run, path):
            return Change.note("result-rewritten", file, expected, "the same grids in other bytes")
        return None
    kind, found = {
        State.MISSING: ("result-missing", "no file"),
        State.FOREIGN: ("result-replaced", "a file written by another program"),
        State.OTHER: ("result-replaced", f"a file of grids {shown(detail)}"),
        State.UNREADABLE: ("result-edited", f"a file that cannot be read: {detail}"),
        State.CHANGED: ("result-edited", f"grids {shown(detail)}"),
    }[written.state]
    return Change(kind, file, expected, found)


def _has_other_bytes(run: Run | None, path: Path) -> bool:
    """Whether a file of the run is not the one that it recorded."""
    if run is None or path.parent.absolute() != run.folder.absolute():
        return False
    digest = run.frames.get(path.name, {}).get("sha256", "")
    return bool(digest) and not run.is_unchanged(path.name, digest)


def _run_of(item: FoundRecord) -> Run | None:
    """The run that a record tells of, if its own record is left."""
    runs = (run for run in find_runs(item.folder) if run.run_id == item.record.run)
    return next(runs, None)


def _check_versions(item: FoundRecord) -> Iterator[Change]:
    record = item.record
    recorded = {"usdsmoke": record.version, **record.packages}
    here = {"usdsmoke": __version__, **package_versions()}
    try:
        here["openvdb"] = read_binding_version(_grids_config(item))
    except BindingMissing:
        here["openvdb"] = "none"
    recorded["platform"] = record.machine.platform
    here["platform"] = platform_name()
    for name, version in recorded.items():
        if version and version != here.get(name, version):
            yield Change.note(
                "version", str(item.file), f"{name} {version}", f"{name} {here[name]}"
            )


def _grids_config(item: FoundRecord) -> GridsConfig:
    """Limits of reading as at the time, or the defaults where this version knows other settings."""
    try:
        return recorded_config(item).grids
    except ConfigError:
        return GridsConfig()
