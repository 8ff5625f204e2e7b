"""Damaged inputs: a few of each kind here, any number by ``python -m benchmarks.fuzz``."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fuzz import KINDS, Outcome, faults
from benchmarks.fuzz.mutate import damage_bytes, damage_json, damage_text

PROJECT = Path(__file__).resolve().parents[2]
SOUND = Outcome(("inspect", "in/shot.usda"), "in/shot.usda", 1, "StageError", "{}", 0.1, 90, (), ())


def test_a_few_damaged_inputs_of_each_kind_have_no_fault(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "benchmarks.fuzz", "--jobs", "1", "--seed", "5"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [*command, "--cases", str(len(KINDS)), "--runs", "0.2"],
        cwd=PROJECT, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{len(KINDS)} cases" in done.stdout


@pytest.mark.parametrize(
    ("outcome", "word"),
    [
        (replace(SOUND, exit_code=None), "no end"),
        (replace(SOUND, exit_code=-11), "exit code -11"),
        (replace(SOUND, output="usdsmoke: unexpected KeyError: 'a'. {}"), "unexpected"),
        (replace(SOUND, output="Traceback (most recent call last): {}"), "Traceback"),
        (replace(SOUND, output=""), "no JSON"),
        (replace(SOUND, memory_mib=9000.0), "memory"),
        (replace(SOUND, changed=("in/shot.usda",)), "inputs were changed"),
        (replace(SOUND, changed=("out/run.json",)), "files were changed"),
        (replace(SOUND, left=("usdsmoke-a",)), "left behind"),
    ],
)
def test_a_faulty_answer_is_called_so(outcome: Outcome, word: str) -> None:
    assert not faults(SOUND)
    assert word in " ".join(faults(outcome))


def test_a_parser_s_own_words_are_no_fault() -> None:
    said = "(line 14: found unexpected end of stream). {}"
    assert not faults(replace(SOUND, exit_code=1, output=said))


@pytest.mark.parametrize("damage", [damage_bytes, damage_text, damage_json])
def test_damage_is_real_and_repeatable(damage) -> None:
    data = b'{"name": [1, 2.5, "smoke"], "file": "./cache/smoke.0001.vdb"}'
    seen = {damage(data, np.random.default_rng([0, number])) for number in range(50)}
    again = {damage(data, np.random.default_rng([0, number])) for number in range(50)}
    assert seen == again
    assert len(seen - {data}) > 25
