"""What the command line prints about records: how a result was made, and what has changed since."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from usdsmoke.base.errors import count_text
from usdsmoke.base.record_format import SHOWN_DIGITS, MachineRecord
from usdsmoke.config.settings import Config
from usdsmoke.ui.cli.text import columns

if TYPE_CHECKING:
    from usdsmoke.audit import Change, FoundRecord, Rerun

_HASH = re.compile(rf"(sha256 )?(?<![/\w])[0-9a-f]{{{SHOWN_DIGITS}}}(?![/\w])")
_MOST_LINES = 4  # of a long list of files


def provenance_text(item: "FoundRecord") -> str:
    """A record as a table for people.

    Raises:
        LayerError: the record cannot be read.
    """
    record = item.record
    grids = {(g.file, g.grid): g.hash for frame in record.frames for g in frame.sources}
    inputs = {f"{file} {grid}": digest for (file, grid), digest in grids.items()}
    rows: list[tuple[str, str]] = [
        ("record", str(item.file)),
        ("made with", f"usdsmoke {record.version or '?'}"),
        ("with", ", ".join(f"{name} {text}" for name, text in record.packages.items())),
        ("platform", _machine_text(record.machine)),
        ("started", record.created),
        ("finished", record.finished),
        ("run", record.run),
        ("stage", record.stage),
        *_listed("style", {style.file: style.sha256 for style in record.styles}),
        ("features", _with_hash(record.features, record.features_hash)),
        ("network", _with_hash(record.start_file, record.start_hash)),
        *_listed("trained", {network.file: network.sha256 for network in record.networks}),
        ("seed", str(record.seed) if record.settings else ""),
        *(("setting", text) for text in _other_settings(record.settings)),
        *_listed("input", inputs),
        *_listed("result", record.results),
        ("time", ", ".join(f"{name} {value:.3f} s" for name, value in record.seconds.items())),
        *(
            (
                "figure",
                f"{name}: {_mean_and_largest(found.mean, found.largest)}, frames {found.n_frames}",
            )
            for name, found in record.figures.items()
        ),
        *(("error", text) for text in _error_texts(record.error_budget)),
        *(
            ("extinction", f"{path}: colour {found.colour:.9g}, shape {found.shape:.9g}")
            for path, found in record.extinction.items()
        ),
        *(("style size", f"{path}: {size:.9g}") for path, size in record.style_sizes.items()),
        *(("parts of voxels", f"{path}: {n}") for path, n in record.refinements.items() if n > 1),
        *(("left out", text) for text in record.omitted),
    ]
    return "\n".join(columns(_once([(name, text) for name, text in rows if text])))


def verification_text(file: str, changes: Sequence["Change"], everything: bool = True) -> str:
    """Changes, a line each, and what they come to.

    Args:
        everything: with hashes.
    """
    rows = [(change.severity, change.kind, change.file) for change in changes]
    heads = columns(rows) if rows else []
    lines = [
        f"{head}: {_difference(change, everything)}"
        for head, change in zip(heads, changes, strict=True)
    ]
    n_changed = sum(change.severity != "note" for change in changes)
    n_notes = len(changes) - n_changed
    notes = f", {count_text(n_notes, 'note')}" if n_notes else ""
    what = count_text(n_changed, "change") if n_changed else "as recorded"
    return "\n".join([*lines, f"{file}: {what}{notes}"])


def _difference(change: "Change", everything: bool) -> str:
    """What was expected and found; without hashes what has changed, in words."""
    expected, found = (_HASH.sub("", text).strip() for text in (change.expected, change.found))
    if everything or (expected, found) == (change.expected, change.found):
        return f"expected {change.expected}, found {change.found}"
    if expected == change.expected or found == change.found:  # no file, or one that is not ours
        return f"expected {expected or 'the file as it was'}, found {found}"
    later = found.removeprefix(expected).strip(" ,")
    return f"{expected or 'the file'} changed" + (f", {later}" if later else "")


def rerun_text(again: "Rerun") -> str:
    """Whether a repetition is the same."""
    frames = count_text(again.n_frames, "frame")
    if not again.differences:
        return f"the same content in {frames} as recorded in {again.record}"
    return "\n".join(
        [
            *again.differences,
            f"other content in {len(again.differences)} of {frames} than recorded in "
            f"{again.record}",
        ]
    )


def _machine_text(machine: MachineRecord) -> str:
    device = f"device={machine.device}" if machine.device else ""
    processor = f"processor={machine.processor}" if machine.processor else ""
    others = [f"{name}={kind}" for name, kind in machine.others.items()]
    return ", ".join(filter(None, [machine.platform, device, processor, *others]))


def _error_texts(budget: Mapping[str, Any]) -> Iterable[str]:
    """The error budget, a line for each error; see ``runs.budget``."""
    for item in budget.get("estimates", ()):
        note = budget["notes"].get(item["name"], "")
        yield (
            f"{item['name']}: {_mean_and_largest(item['mean'], item['largest'])}, of "
            f"{item['relative_to']}, frames {item['n_frames']}, seconds {item['seconds']:.3f}, "
            f"{item['how']}{f' ({note})' if note else ''}"
        )
    for name, why in budget.get("left_out", {}).items():
        yield f"{name}: left out: {why}"
    for item in budget.get("findings", ()):
        yield f"finding: {item['place']}: {item['cause']}. {item['remedy']}."


def _mean_and_largest(mean: float, largest: float) -> str:
    return f"mean {mean:.6g}, max {largest:.6g}"


def _listed(title: str, digests: Mapping[str, str]) -> list[tuple[str, str]]:
    """Files with their hashes, the first ones of a long list."""
    rows = [(title, _with_hash(name, digest)) for name, digest in digests.items()]
    n_more = len(rows) - _MOST_LINES
    return [*rows[:_MOST_LINES], (title, f"and {n_more} more")] if n_more > 0 else rows


def _with_hash(name: str, digest: str) -> str:
    return f"{name}  {digest[:SHOWN_DIGITS]}".strip()


def _other_settings(config: Mapping[str, Any]) -> Iterable[str]:
    """Settings that are not the defaults of this version."""
    defaults = Config().model_dump()
    for section, settings in config.items():
        for key, value in settings.items():
            if value != defaults.get(section, {}).get(key, value):
                yield f"{section}.{key}={value}"


def _once(rows: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Rows that name what they are about only where that changes."""
    return [
        ("" if number and rows[number - 1][0] == name else name, text)
        for number, (name, text) in enumerate(rows)
    ]
