"""The record of golden results keeps hashes of several circumstances, and tells what differs."""

from pathlib import Path
from typing import Any

import pytest

from tests.baselines import record
from tests.baselines.record import differences, read_record, same_circumstances, write_record


def results(number: float, digit: str) -> dict[str, Any]:
    """One run with a statistic and a hash."""
    return {"run": {"file": {"hash": digit * 64, "sum": [number, 2.0]}, "name": "x"}}


@pytest.fixture
def file_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A record of the results (1, "a") on the processor a and of (1.0001, "b") on b."""
    file_path = tmp_path / "record.json"
    for processor, number in (("a", 1.0), ("b", 1.0001)):
        monkeypatch.setattr(record, "circumstances", lambda name=processor: {"processor": name})
        write_record(file_path, results(number, processor))
    return file_path


@pytest.mark.parametrize(
    ("processor", "number", "digit", "finds"),
    [
        ("a", 1.0, "a", None),
        ("a", 1.0, "b", "/file/hash"),
        ("a", 1.0001, "a", "/file/sum"),
        ("b", 1.0001, "b", None),
        ("b", 1.0001, "a", "/file/hash"),
        ("c", 1.0001, "c", None),
        ("c", 1.01, "c", "/file/sum"),
    ],
)
def test_bits_are_compared_where_they_are_on_record_and_statistics_elsewhere(
    file_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    processor: str,
    number: float,
    digit: str,
    finds: str | None,
) -> None:
    monkeypatch.setattr(record, "circumstances", lambda: {"processor": processor})
    kept = read_record(file_path)
    assert same_circumstances(kept) == (processor != "c")
    told = differences(kept, "run", results(number, digit)["run"])
    assert [text.split(":")[0] for text in told] == ([finds] if finds else [])


def test_names_and_missing_parts_are_compared_everywhere(file_path: Path) -> None:
    found = results(1.0001, "b")["run"]
    kept = read_record(file_path)
    assert differences(kept, "run", {**found, "name": "y"}, exact=False)
    assert differences(kept, "run", {"file": found["file"]}, exact=False)
    assert differences(kept, "run", {**found, "more": 1}, exact=False)
    assert differences(kept, "other", found)


@pytest.mark.parametrize("number", [1.5, 1.0002])
def test_new_results_drop_the_hashes_of_other_circumstances(file_path: Path, number: float) -> None:
    """Where this processor's own hashes change, those of others are out of date too."""
    write_record(file_path, results(number, "c"))
    kept = read_record(file_path)
    assert [entry["circumstances"] for entry in kept["hashes"]] == [{"processor": "b"}]
    assert differences(kept, "run", results(number, "c")["run"]) == []


def test_the_same_results_once_more_change_nothing(file_path: Path) -> None:
    before = read_record(file_path)
    write_record(file_path, results(1.0001, "b"))
    assert read_record(file_path) == before
