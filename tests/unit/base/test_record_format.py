"""The record of a run: complete, the same for the same facts, read back as it was written."""

import hashlib
import json
import re
import uuid
from dataclasses import replace

import pytest

from usdsmoke.base.errors import FileUnreadable, LayerError
from usdsmoke.base.json_records import read_json
from usdsmoke.base.record_format import (
    RECORD_FORMAT,
    Extinction,
    Figure,
    FrameRecord,
    MachineRecord,
    RunRecord,
    SourceGrid,
    StyleRecord,
    hash_file,
    new_run_id,
    short_run_id,
    utc_now,
)

GRID = SourceGrid("density", "../b.vdb", "d", "aa")
RECORD = RunRecord(
    format=RECORD_FORMAT,
    run="3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34",
    version="1.2.3",
    created="2026-01-31T12:00:00Z",
    finished="2026-01-31T12:30:00Z",
    look="fire",
    stage="../shot.usda",
    packages={"usd-core": "26.11", "numpy": "1.26"},
    machine=MachineRecord("Linux x86_64", "cpu", "x86_64 AVX2", {"window 3": "older"}),
    seed=2**40,
    settings={"views": {"count": 3}, "style": {"weights": [1.0, 3.0]}},
    explicit=("views.count",),
    style_request=("../petals=1.png",),
    styles=(StyleRecord("../petals=1.png", "cc"),),
    features="embedded",
    features_hash="dd",
    stage_values={"upAxis": "Z"},
    source_files={"b.vdb": "ff"},
    frames=(
        FrameRecord("./a.vdb", "/smoke", 1.5, (SourceGrid("density", "../b.vdb", "d", "aa"),)),
    ),
    results={"./a.vdb": "ee"},
    extinction={"/smoke": Extinction(1.5, 0.1 + 0.2)},
    omitted=("velocity: one frame",),
    seconds={"shape": 1.23456},
    figures={"shape loss": Figure(1 / 3, 1.0, 2)},
    error_budget={"estimates": [], "notes": {}},
)


def test_a_record_comes_back_from_its_text_with_every_bit():
    assert RunRecord.from_text(RECORD.to_text(), "here") == RECORD
    assert json.loads(RECORD.to_text()) == RECORD.to_json()


def test_equal_records_have_equal_texts_and_others_do_not():
    assert replace(RECORD).to_text() == RECORD.to_text()
    for change in ({"seed": 1}, {"results": {}}, {"explicit": ()}, {"look": "ice"}):
        assert replace(RECORD, **change).to_text() != RECORD.to_text()


def test_a_record_of_another_format_names_both_formats_and_the_version():
    text = json.dumps({**RECORD.to_json(), "format": 2})
    with pytest.raises(LayerError, match=r"look\.usda.* 2.* 1.*1\.2\.3"):
        RunRecord.from_text(text, "look.usda")


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"format": 1}', '{"format": 1, "run": []}'])
def test_a_damaged_record_names_its_file(text):
    with pytest.raises(LayerError, match=r"look\.usda"):
        RunRecord.from_text(text, "look.usda")


def test_fields_of_later_versions_of_the_format_are_ignored():
    text = json.dumps({**RECORD.to_json(), "weather": "fine"})
    assert RunRecord.from_text(text, "here") == RECORD


def test_a_run_id_is_a_random_uuid_and_fits_a_usd_name_when_it_is_short():
    assert new_run_id() != new_run_id() and uuid.UUID(new_run_id()).version == 4
    assert re.fullmatch(r"[0-9a-f]{8}", short_run_id(new_run_id()))


def test_time_is_utc_to_the_second():
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", utc_now())


def test_hash_file_is_sha256_of_the_bytes(tmp_path):
    (tmp_path / "style.png").write_bytes(b"abc" * 700_000)
    assert hash_file(tmp_path / "style.png") == hashlib.sha256(b"abc" * 700_000).hexdigest()


def test_a_file_that_cannot_be_hashed_is_named(tmp_path):
    with pytest.raises(FileUnreadable, match=r"none\.png.*No such file"):
        hash_file(tmp_path / "none.png")


@pytest.mark.parametrize("text", ["[" * 100_000, "[" * 2_000 + "]" * 2_000, '{"a":' * 5_000])
def test_json_that_is_nested_beyond_all_use_is_damaged(text: str) -> None:
    with pytest.raises(ValueError):
        read_json(text)
    with pytest.raises(LayerError, match="record"):
        RunRecord.from_text(text, "look.usda")
