"""Verdicts on frames that the core has stylized: none as a rule, each where it should be.

``tests/unit/runs/test_findings.py`` holds the rules, with reports that are made for them.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tests.fixtures.smoke_fixtures import frame_of, puff
from tests.fixtures.stylize_fixtures import quick_config, run_core
from usdsmoke.config.settings import Config
from usdsmoke.runs.budget.finding import Finding
from usdsmoke.runs.budget.findings import find_written


def findings_of(config: Config) -> list[Finding]:
    patches = np.random.default_rng(0).uniform(0.1, 0.5, (8, 8, 3)).astype(np.float32)
    style = np.kron(patches, np.ones((4, 4, 1), np.float32))
    (frame,) = run_core([frame_of(puff(14))], config, styles=[style])
    written = int((frame.density.values > config.grids.prune).sum())
    report = replace(frame.report, voxels_written=written)
    return list(find_written("a.vdb", {"a.vdb": report}, None, config))


def settings(**sections: Mapping[str, Any]) -> Config:
    """The defaults, but for fewer iterations and smaller pictures."""
    steps = {name: {"iterations": [32], **sections.pop(name, {})} for name in ("shape", "colour")}
    small = {"features": {"layers": ["oriented2", "learned0", "learned1"]}, "views": {"pool": 8}}
    return quick_config(**{**small, **steps, "optimize": {"error_budget": True}, **sections})


def test_a_frame_at_the_default_rates_has_no_finding() -> None:
    assert findings_of(settings()) == []


def test_extreme_settings_have_their_verdicts() -> None:
    low = {"learning_rate": 1e-3}
    extreme = settings(colour=low, shape={"reach": 1e-5, **low}, grids={"prune": 0.5})
    assert {(finding.row, finding.setting) for finding in findings_of(extreme)} >= {
        ("optimiser, colour", "colour.learning_rate"),
        ("optimiser, shape", "shape.learning_rate"),
        ("optimiser, shape", "shape.reach"),
        ("mass", "grids.prune"),
    }
