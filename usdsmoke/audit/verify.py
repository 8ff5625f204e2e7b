"""What has changed since a result was made: inputs, stage, images, features, results, the layer.

Everything is compared with the record in the look layer; nothing is written. The digests tell of
accidents and of edits that were forgotten. They are no signature: whoever wants to deceive can
write a record anew.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from usdsmoke import __version__
from usdsmoke.audit.inputs import Change, check_inputs, recorded_config, shown
from usdsmoke.audit.records import LookRecord, find_records
from usdsmoke.base.errors import BindingMissing, ConfigError, UsdSmokeError
from usdsmoke.base.machine import package_versions, platform_name
from usdsmoke.base.sections import GridsConfig
from usdsmoke.usd.look import LAYER_HASH, RECORD_HASH, layer_digest, record_digest
from usdsmoke.vdb.content_hash import CONTENT_KEY, hash_vdb_file
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import read_binding_version

__all__ = ["Change", "verify", "verify_inputs"]

_AT_ONCE = max(1, min(4, os.cpu_count() or 1))  # files are read by processes of their own


@dataclass(frozen=True)
class _Result:
    """A file of the result and the hash of its content."""

    file: Path
    digest: str


def verify(file: str | PathLike[str]) -> list[Change]:
    """What differs from the records that a file leads to; empty when all is as recorded.

    Changes of the severity ``note`` do not make the result another one: other versions of
    programs, a file that was written anew with the same grids, what could not be compared.

    Args:
        file: as ``find_records`` takes it.

    Raises:
        UsdSmokeError: see ``find_records``.
    """
    changes = []
    for record in find_records(file):
        changes += [
            *_check_layer(record),
            *_check_results(record),
            *check_inputs(record),
            *_check_versions(record),
        ]
    return list(dict.fromkeys(changes))


def verify_inputs(record: LookRecord) -> list[Change]:
    """Those changes of what a result was made from that make another result of it."""
    return [change for change in check_inputs(record) if change.severity != "note"]


def _check_layer(record: LookRecord) -> Iterator[Change]:
    if record.layer is None:
        return
    file, values = str(record.file), record.values
    if LAYER_HASH not in values:
        yield Change.note("unchecked", file, "a digest of the layer", "a record without one")
        return
    found = layer_digest(record.layer)
    if found != values[LAYER_HASH]:
        yield Change("layer-edited", file, f"layer {shown(values[LAYER_HASH])}", shown(found))
    found = record_digest(record.layer)
    if found != values.get(RECORD_HASH):
        recorded = shown(str(values.get(RECORD_HASH, "")))
        yield Change("record-edited", file, f"record {recorded}", shown(found))


def _check_results(record: LookRecord) -> list[Change]:
    results = [
        _Result(Path(os.path.normpath(record.folder / name)), digest)
        for name, digest in record.pairs("results").items()
    ]
    with ThreadPoolExecutor(max_workers=_AT_ONCE) as pool:
        found = pool.map(_check_result, results)
    return [change for change in found if change is not None]


def _check_result(result: _Result) -> Change | None:
    file, wanted = str(result.file), f"grids {shown(result.digest)}"
    if not result.file.is_file():
        return Change("result-missing", file, wanted, "no file")
    try:
        promised = str(read_header(result.file).metadata.get(CONTENT_KEY, ""))
        if promised != result.digest:
            what = f"a file of grids {shown(promised)}" if promised else "a file of another program"
            return Change("result-replaced", file, wanted, what)
        digest = hash_vdb_file(result.file, GridsConfig())
    except BindingMissing as error:
        return Change.note("unchecked", file, wanted, str(error))
    except UsdSmokeError as error:
        return Change("result-edited", file, wanted, f"a file that cannot be read: {error}")
    if digest != result.digest:
        return Change("result-edited", file, wanted, f"grids {shown(digest)}")
    return None


def _check_versions(record: LookRecord) -> Iterator[Change]:
    recorded = {"usdsmoke": str(record.values.get("version", "")), **record.pairs("packages")}
    here = {"usdsmoke": __version__, **package_versions()}
    try:
        here["openvdb"] = read_binding_version(_grids_config(record))
    except BindingMissing:
        here["openvdb"] = "none"
    recorded["platform"] = str(record.values.get("platform", ""))
    here["platform"] = platform_name()
    for name, version in recorded.items():
        if version and version != here.get(name, version):
            yield Change.note(
                "version", str(record.file), f"{name} {version}", f"{name} {here[name]}"
            )


def _grids_config(record: LookRecord) -> GridsConfig:
    """Limits of reading as at the time, or the defaults where this version knows other settings."""
    try:
        return recorded_config(record).grids
    except ConfigError:
        return GridsConfig()
