"""What the command line prints about records: how a result was made, and what has changed since."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from usdsmoke.base.settings import Config
from usdsmoke.ui.cli.text import columns

if TYPE_CHECKING:
    from usdsmoke.audit.records import LookRecord
    from usdsmoke.audit.rerun import Rerun
    from usdsmoke.audit.verify import Change

__all__ = ["provenance_text", "rerun_text", "verification_text"]

_SHOWN = 12  # digits of a hash that people compare
_MOST_LINES = 4  # of a long list of files


def provenance_text(record: "LookRecord") -> str:
    """A record as a table for people."""
    values = record.values
    request = record.request()
    packages = [f"{name} {version}" for name, version in record.pairs("packages").items()]
    timings = [f"{name} {seconds} s" for name, seconds in record.pairs("timings").items()]
    rows: list[tuple[str, str]] = [
        ("record", str(record.file)),
        ("made with", f"usdsmoke {values.get('version', '?')}"),
        ("upon", ", ".join(packages)),
        ("on", ", ".join([str(values.get("platform", "")), *record.texts("machine")])),
        ("begun", str(values.get("created", ""))),
        ("finished", str(values.get("finished", ""))),
        ("run", str(values.get("run", ""))),
        ("stage", str(request.get("stage", ""))),
        *_listed("style", record.texts("styleFiles") or record.texts("styles")),
        ("features", _with_hash(values.get("features"), values.get("featuresHash"))),
        ("seed", str(values.get("seed", ""))),
        *(("setting", text) for text in _other_settings(record.parsed("config"))),
        *_listed("input", record.texts("inputs")),
        *_listed("result", record.texts("results")),
        ("time", ", ".join(timings)),
        *(("figure", text.replace("=", ": ", 1)) for text in record.texts("figures")),
        *(("error", text.replace("=", ": ", 1)) for text in record.texts("errorBudget")),
        *(("extinction", text.replace("=", ": ", 1)) for text in record.texts("extinction")),
        *(("left out", text) for text in record.texts("omitted")),
    ]
    return "\n".join(columns(_once([(name, text) for name, text in rows if text])))


def verification_text(file: str, changes: Sequence["Change"]) -> str:
    """Changes, a line each, and what they come to."""
    rows = [(change.severity, change.kind, change.file) for change in changes]
    heads = columns(rows) if rows else []
    lines = [
        f"{head}: expected {change.expected}, found {change.found}"
        for head, change in zip(heads, changes, strict=True)
    ]
    n_changed = sum(change.severity != "note" for change in changes)
    n_notes = len(changes) - n_changed
    notes = f", {n_notes} note{'' if n_notes == 1 else 's'}" if n_notes else ""
    what = f"{n_changed} change{'' if n_changed == 1 else 's'}" if n_changed else "as recorded"
    return "\n".join([*lines, f"{file}: {what}{notes}"])


def rerun_text(again: "Rerun") -> str:
    """Whether a repetition is the same."""
    frames = f"{again.n_frames} frame{'' if again.n_frames == 1 else 's'}"
    if not again.differences:
        return f"the same content in {frames} as recorded in {again.record}"
    return "\n".join(
        [
            *again.differences,
            f"other content in {len(again.differences)} of {frames} than recorded in "
            f"{again.record}",
        ]
    )


def _listed(title: str, texts: Sequence[str]) -> list[tuple[str, str]]:
    """Files with their hashes, the first ones of a long list."""
    rows = []
    for text in texts[:_MOST_LINES]:
        name, _, digest = text.rpartition("=")
        rows.append((title, _with_hash(name, digest)))
    left = len(texts) - _MOST_LINES
    return [*rows, (title, f"and {left} more")] if left > 0 else rows


def _with_hash(name: Any, digest: Any) -> str:
    return f"{name or ''}  {str(digest or '')[:_SHOWN]}".strip()


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
