"""The record of golden results: reading, writing, and comparing with what a run gives now.

A record has ``results``, what every run gave with the hashes taken out, and ``hashes``, a list with
the circumstances and the hashes by run and place.
"""

import hashlib
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.baselines.measure import circumstances

__all__ = ["GOLDEN", "differences", "read_record", "same_circumstances", "write_record"]

GOLDEN = Path(__file__).with_name("golden.json")
TOLERANCE = 1e-3  # relative, of results under other circumstances
# of what an optimisation leads to: processors round otherwise, and that grows from step to step.
# Up to twice what AMD and Intel processors differ by, a tenth of what another seed does to colours.
# Velocity is copied; where it is estimated, colours differ more (0.033).
GROWN = (
    ("/figures/", 0.12), ("/vel/statistics", TOLERANCE), ("/density/statistics", 0.012),
    ("still_look.usda/files/smoke.0001.vdb/grids/emission/statistics", 0.05),
    ("still_look.usda/files/smoke.0002.vdb/grids/emission/statistics", 0.05),
    ("/statistics", 0.03),
)  # fmt: skip
VALUES = "values"  # the place of the hash of all that is not voxels or pixels
SHOWN = 12  # differences that are told of one run

Record = dict[str, Any]


def read_record(file_path: Path = GOLDEN) -> Record:
    """The record in a file."""
    record: Record = json.loads(file_path.read_text(encoding="utf-8"))
    return record


def same_circumstances(record: Record) -> bool:
    """Whether the record has hashes for this processor and these packages."""
    return _hashes_here(record) is not None


def differences(record: Record, name: str, found: Any, exact: bool | None = None) -> list[str]:
    """What differs between a run and the record, one text each; none if all is as recorded.

    Args:
        record: see ``read_record``.
        name: the run.
        found: what the run gave, hashes included.
        exact: compare hashes too; None: under the same circumstances.
    """
    if name not in record["results"]:
        return ["the record does not have this run"]
    here = _hashes_here(record)
    if exact is None:
        exact = here is not None
    hashes, values = _split(found)
    recorded = record["results"][name]
    told = list(_compare("", recorded, values, TOLERANCE))
    if exact:
        wanted = (here or record["hashes"][0]["runs"])[name]
        places = [p for p in sorted({*wanted, *hashes}) if wanted.get(p) != hashes.get(p)]
        told += [f"{place}: the bits differ" for place in places if place != VALUES]
        if not told and places:
            told = list(_compare("", recorded, values, 0.0)) or ["the order of values differs"]
    more = [f"and {len(told) - SHOWN} more differences"] if len(told) > SHOWN else []
    return told[:SHOWN] + more


def write_record(file_path: Path, results: dict[str, Any]) -> str:
    """Record results; returns a sentence on what became of the hashes that were there."""
    old = read_record(file_path) if file_path.is_file() else {"results": {}, "hashes": []}
    split = {name: _split(found) for name, found in results.items()}
    values = {name: found for name, (_, found) in split.items()}
    here = circumstances()
    agree = old["results"].keys() == values.keys() and not any(
        list(_compare("", old["results"][name], values[name], TOLERANCE)) for name in values
    )
    own = {"circumstances": here, "runs": {name: hashes for name, (hashes, _) in split.items()}}
    unchanged = all(e == own for e in old["hashes"] if e["circumstances"] == here)
    others = [e for e in old["hashes"] if e["circumstances"] != here]
    kept = others if agree and unchanged else []
    # With others' hashes their values stay: the new ones differ in their last digits alone.
    record = {"results": old["results"] if kept else values, "hashes": [*kept, own]}
    file_path.write_text(_text(record), encoding="utf-8")
    return f"{file_path}: {len(values)} runs; kept the hashes of {len(kept)} other circumstances"


def _text(record: Record) -> str:
    """JSON with a line for each run, so that a difference of versions can be read."""
    lines = ['{"results": {']
    lines += [f"{json.dumps(name)}: {_dense(found)}," for name, found in record["results"].items()]
    lines[-1] = lines[-1].removesuffix(",") + '}, "hashes": ['
    for entry in record["hashes"]:
        lines += [f'{{"circumstances": {json.dumps(entry["circumstances"])}, "runs": {{']
        lines += [f"{json.dumps(name)}: {_dense(found)}," for name, found in entry["runs"].items()]
        lines[-1] = lines[-1].removesuffix(",") + "}},"
    lines[-1] = lines[-1].removesuffix(",") + "]}"
    return "\n".join(lines) + "\n"


def _dense(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"))


def _hashes_here(record: Record) -> dict[str, Any] | None:
    here = circumstances()
    return next((e["runs"] for e in record["hashes"] if e["circumstances"] == here), None)


def _split(found: Any) -> tuple[dict[str, str], Any]:
    """Hashes by place, one of all other values among them, and those values."""
    hashes: dict[str, str] = {}
    values = _without_hashes("", found, hashes)
    text = json.dumps(values, sort_keys=True)
    return {**hashes, VALUES: hashlib.sha256(text.encode()).hexdigest()}, values


def _without_hashes(place: str, found: Any, hashes: dict[str, str]) -> Any:
    if not isinstance(found, dict):
        return found
    hashes |= {f"{place}/{key}": value for key, value in found.items() if _is_hash(value)}
    return {
        key: _without_hashes(f"{place}/{key}", value, hashes)
        for key, value in found.items()
        if not _is_hash(value)
    }


def _is_hash(value: Any) -> bool:
    return isinstance(value, str) and len(value) == 64 and not set(value) - set("0123456789abcdef")


def _compare(place: str, wanted: Any, found: Any, tolerance: float) -> Iterator[str]:
    """Texts on what differs; numbers of a list are compared with the largest of them."""
    if isinstance(wanted, dict) and isinstance(found, dict):
        for key in sorted({*wanted, *found}):
            if key not in wanted or key not in found:
                yield f"{place}/{key}: {'missing' if key in wanted else 'not in the record'}"
            else:
                yield from _compare(f"{place}/{key}", wanted[key], found[key], tolerance)
    elif isinstance(wanted, list) and isinstance(found, list) and len(wanted) == len(found):
        if wanted and all(_is_number(item) for item in [*wanted, *found]):
            largest = max(abs(item) for item in wanted)
            most = _tolerance_at(place, tolerance) * largest
            if any(abs(a - b) > most for a, b in zip(wanted, found, strict=True)):
                yield f"{place}: {_short(wanted)} recorded, now {_short(found)}"
            return
        for number, (one, other) in enumerate(zip(wanted, found, strict=True)):
            yield from _compare(f"{place}/{number}", one, other, tolerance)
    elif _is_number(wanted) and _is_number(found):
        most = _tolerance_at(place, tolerance)
        if not math.isclose(wanted, found, rel_tol=most, abs_tol=most * 1e-3):
            yield f"{place}: {wanted} recorded, now {found}"
    elif wanted != found:
        yield f"{place}: {_short(wanted)} recorded, now {_short(found)}"


def _tolerance_at(place: str, tolerance: float) -> float:
    """Of values at a place: more where round-off has grown, but 0 stays 0."""
    grown = GROWN if tolerance else ()
    return next((more for part, more in grown if part in place), tolerance)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 90 else f"{text[:87]}..."
