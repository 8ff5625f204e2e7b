"""The record of a run: flat, complete, the same for the same facts, and free of places."""

import hashlib
import json
import re
import uuid

import pytest

from usdsmoke.base.errors import FileUnreadable
from usdsmoke.base.record_format import (
    SCHEMA_VERSION,
    RunFacts,
    authorship_inputs,
    build_provenance,
    hash_file,
    new_run_id,
    short_run_id,
    utc_now,
)
from usdsmoke.runs.budget.figures import Figure

FACTS = RunFacts(
    version="1.2.3",
    seed=2**40,
    config={"views": {"count": 3}, "style": {"size": 1.0}},
    inputs={"/home/someone/b.vdb": "bb", "/home/someone/a.vdb": "aa"},
    styles={"/home/someone/petals.png": "cc"},
    features="embedded",
    features_hash="dd",
    packages={"usd": "26.11", "numpy": "1.26"},
    timings={"shape": 1.23456, "colour": 2.0},
    extinction={"/shot/smoke": (1.5, 0.25)},
    temporal_error={"displacement": 0.25, "colour": 0.0625},
    overlap_difference={"density": 0.01234567},
    omissions=["velocity: one frame"],
    run_id="3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34",
    created="2026-01-31T12:00:00Z",
    finished="2026-01-31T12:30:00Z",
    platform="Linux x86_64",
    machine=["threads=2", "processor=x86_64 AVX2"],
    figures={"shape loss": Figure(0.5, 1.0, 2)},
    error_budget=["mass=mean 0.1, max 0.2"],
    stage_values={"upAxis": "Z", "</shot/smoke>": "ee"},
    request={"stage": "../shot.usda", "styles": ["../petals.png"]},
    input_state={"files": {"b.vdb": "ff"}},
    style_files={"../petals.png": "cc"},
    frames=[{"file": "./vdb/k/smoke.0001.vdb", "timeCode": 1.0}],
)


def test_the_record_holds_every_fact_as_numbers_texts_and_lists_of_texts():
    record = build_provenance(FACTS)
    assert record == {
        "schemaVersion": SCHEMA_VERSION,
        "tool": "usdsmoke",
        "version": "1.2.3",
        "run": FACTS.run_id,
        "created": FACTS.created,
        "seed": 2**40,
        "config": '{"style": {"size": 1.0}, "views": {"count": 3}}',
        "inputs": ["a.vdb=aa", "b.vdb=bb"],
        "styles": ["petals.png=cc"],
        "features": "embedded",
        "featuresHash": "dd",
        "packages": ["numpy=1.26", "usd=26.11"],
        "timings": ["shape=1.235", "colour=2.000"],
        "extinction": ["/shot/smoke=colour 1.5, shape 0.25"],
        "temporalError": ["displacement=0.25", "colour=0.0625"],
        "overlapDifference": ["density=0.0123457"],
        "omitted": ["velocity: one frame"],
        "finished": FACTS.finished,
        "platform": "Linux x86_64",
        "machine": ["threads=2", "processor=x86_64 AVX2"],
        "figures": ["shape loss=mean 0.5, max 1, frames 2"],
        "errorBudget": ["mass=mean 0.1, max 0.2"],
        "stageValues": ["upAxis=Z", "</shot/smoke>=ee"],
        "request": '{"stage": "../shot.usda", "styles": ["../petals.png"]}',
        "inputState": '{"files": {"b.vdb": "ff"}}',
        "styleFiles": ["../petals.png=cc"],
        "frames": ['{"file": "./vdb/k/smoke.0001.vdb", "timeCode": 1.0}'],
    }
    assert json.loads(record["config"]) == FACTS.config


def test_the_record_names_no_folder_but_those_that_are_relative_to_the_layer():
    assert "someone" not in json.dumps(build_provenance(FACTS))


def test_a_run_without_id_and_time_gets_new_ones():
    first, second = build_provenance(RunFacts("1", 0, {})), build_provenance(RunFacts("1", 0, {}))
    assert first["run"] != second["run"]
    assert uuid.UUID(first["run"]).version == 4
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", first["created"])
    assert len(first["created"]) == len(utc_now())


def test_authorship_inputs_are_pairs_and_long_lists_become_one_digest():
    inputs = authorship_inputs(build_provenance(FACTS))
    assert len(inputs) % 2 == 0
    pairs = dict(zip(inputs[::2], inputs[1::2], strict=True))
    digest = hashlib.sha256(b"a.vdb=aa\nb.vdb=bb").hexdigest()
    assert pairs["sources"] == f"2 files, sha256 of their list {digest}"
    assert pairs["style"] == "petals.png=cc"
    assert pairs["seed"] == str(2**40)
    assert pairs["features"] == "embedded dd"
    assert pairs["package"] == "usd=26.11"
    assert pairs["seconds"] == "colour=2.000"
    assert pairs["figure"] == "shape loss=mean 0.5, max 1, frames 2"
    assert json.loads(pairs["config"]) == FACTS.config


def test_a_short_run_id_fits_a_usd_name():
    assert re.fullmatch(r"[0-9a-f]{8}", short_run_id(new_run_id()))


def test_hash_file_is_sha256_of_the_bytes(tmp_path):
    (tmp_path / "style.png").write_bytes(b"abc" * 700_000)
    assert hash_file(tmp_path / "style.png") == hashlib.sha256(b"abc" * 700_000).hexdigest()


def test_a_file_that_cannot_be_hashed_is_named(tmp_path):
    with pytest.raises(FileUnreadable, match=r"read .*none\.png to take its hash: No such file"):
        hash_file(tmp_path / "none.png")
