"""The budget of a run, put together from the reports of its frames, and what storing loses."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from usdsmoke.base.frame_report import (
    Estimate,
    FrameErrors,
    FrameReport,
    OverlapReport,
    StepReport,
    TemporalErrors,
    TransportReport,
)
from usdsmoke.base.storage import storage_errors
from usdsmoke.base.volume import DenseField
from usdsmoke.runs.budget import ErrorBudget
from usdsmoke.runs.budget.error_budget import make_budget
from usdsmoke.runs.budget.rows import ROWS, ErrorRow
from usdsmoke.runs.budget.verdicts import FINE, judge_parts
from usdsmoke.ui.cli.budget_text import budget_text
from usdsmoke.vdb.boxes import prune_fields

FIRST = FrameReport(
    shape=StepReport(seconds=2.0, loss=(9.0, 4.0), fallen=3.0, remaining=1.0, view_spread=0.5),
    transport=TransportReport(
        error=Estimate(0.01, 0.25, 3.0), linear_difference=0.08, mass_error=-0.03
    ),
    colour=StepReport(seconds=4.0, loss=(20.0, 10.0), fallen=9.0, remaining=1.0, view_spread=0.02),
    errors=FrameErrors(quadrature=Estimate(0.002, 0.5, 2.0)),
    temporal=TemporalErrors(colour=0.1),
)
SECOND = replace(
    FIRST,
    transport=replace(FIRST.transport, mass_error=0.01, error=Estimate(0.03)),
    errors=FrameErrors(quadrature=Estimate(0.004, 0.25)),
    temporal=TemporalErrors(0.2, 0.3),
)
SHAPE_ALONE = FrameReport(shape=FIRST.shape, transport=FIRST.transport)
EMPTY = FrameReport(left_out="empty frame")


def test_every_error_is_mean_and_largest_of_the_frames_that_have_it() -> None:
    budget = make_budget([FIRST, EMPTY, SECOND])
    found = budget["quadrature"]
    assert (found.mean, found.largest) == pytest.approx((0.003, 0.004))
    assert (found.n_frames, found.seconds, found.relative_to) == (2, 0.75, "the picture")
    assert budget["transport"].largest == 0.03
    assert budget["temporal, displacement"].n_frames == 1


def test_losses_of_mass_do_not_make_up_for_gains() -> None:
    assert make_budget([FIRST, SECOND])["mass"].mean == pytest.approx(0.02)


def test_what_the_optimiser_leaves_is_a_share_of_the_final_loss() -> None:
    budget = make_budget([FIRST])
    assert budget["optimiser, shape"].mean == 0.25
    assert budget["optimiser, colour"].mean == 0.1
    assert budget["optimiser, colour"].relative_to == "its final loss"


def test_no_more_than_the_whole_loss_remains_and_of_none_nothing() -> None:
    for remaining, loss, wanted in ((9.0, 3.0, 1.0), (0.0, 0.0, 0.0), (1e-9, 0.0, 0.0)):
        report = FrameReport(colour=StepReport(remaining=remaining, loss=(loss,)))
        assert make_budget([report])["optimiser, colour"].mean == wanted


def test_views_are_those_of_the_last_step() -> None:
    assert make_budget([FIRST])["view sampling"].mean == 0.02
    assert make_budget([SHAPE_ALONE])["view sampling"].mean == 0.5


def test_what_has_no_figure_is_named_with_the_reason() -> None:
    budget = make_budget([SHAPE_ALONE])
    assert "opacity" in budget.left_out["quadrature"]
    assert "no chain of 2 frames" in budget.left_out["temporal, displacement"]
    names = {estimate.name for estimate in budget.estimates}
    assert names.isdisjoint(budget.left_out) and len(names | set(budget.left_out)) == len(ROWS)


def test_seconds_are_those_of_steps_and_estimates() -> None:
    assert make_budget([FIRST, SECOND]).seconds == {"shape": 4.0, "colour": 8.0, "estimates": 1.0}


def test_a_figure_that_is_not_finite_is_none() -> None:
    report = FrameReport(transport=TransportReport(mass_error=float("nan"), linear_difference=0.5))
    assert [item.name for item in make_budget([report]).estimates] == ["optimiser's transport"]


def test_a_report_comes_back_from_json() -> None:
    overlap = OverlapReport((0, 1), 0.5, 0.25)
    for report in (FIRST, SECOND, EMPTY, replace(FIRST, overlap=overlap, extinction=2.0)):
        assert FrameReport.from_json(json.loads(json.dumps(report.to_json()))) == report
    with pytest.raises(ValueError, match="loss"):
        FrameReport.from_json({"shape": {"loss": "high"}})


def test_a_budget_comes_back_from_json() -> None:
    budget = make_budget([FIRST, SECOND])
    assert ErrorBudget.from_json(json.loads(json.dumps(budget.to_json()))) == budget


def test_the_table_names_every_error() -> None:
    budget = make_budget([FIRST])
    text = budget_text(budget)
    lines = text.splitlines()
    # in a line of its own, or among those that are left out; "mass" is a part of other names
    named = {re.split(r"\s{2,}", line)[0] for line in lines}
    for line in lines:
        if line.startswith("without "):
            named.update(line.removeprefix("without ").partition(":")[0].split("; "))
    assert {row.name for row in ROWS} <= named
    assert "0.20%" in text and "time: shape 2.0 s, colour 4.0 s" in text


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_figure_of_every_error_is_told_in_words(row: ErrorRow) -> None:
    (told,) = judge_parts({row.name: 0.25}, lambda name: FINE, {})
    figure, _, meaning = told.why.partition(" ")
    assert figure == "25.00%" and meaning and told.error == row.name


def fields() -> list[DenseField]:
    generator = np.random.default_rng(0)
    density = generator.uniform(0, 1, (6, 5, 4)).astype(np.float32)
    light = density[..., None] * generator.uniform(0, 1, (6, 5, 4, 3)).astype(np.float32)
    place = ((0, 0, 0), np.eye(4))
    return [
        DenseField("density", density, *place),
        DenseField("emission", light, *place, (0.0, 0.0, 0.0)),
    ]


def test_nothing_is_lost_in_32_bit_floats() -> None:
    lost = storage_errors(fields(), fields(), False)
    assert (lost.storage_density.value, lost.storage_emission.value) == (0, 0)


def test_pruning_loses_the_share_of_the_thin_smoke() -> None:
    density, emission = fields()
    thin = density.values <= 0.25
    kept = prune_fields([density, emission], 0.25)
    lost = storage_errors([density, emission], kept, False)
    shares = [
        part.values[thin].sum(dtype=float) / part.values.sum(dtype=float)
        for part in (density, emission)
    ]
    found = [lost.storage_density.value, lost.storage_emission.value]
    assert found == pytest.approx(shares, rel=1e-6)
    assert (kept[1].values[thin] == 0).all()


def test_fields_are_pruned_by_the_smoke_at_their_own_voxels() -> None:
    """Fields that were read from a file have the boxes of their own active voxels."""
    density = np.array([0.01, 0.9, 0.01, 0.9], np.float32).reshape(4, 1, 1)
    ones = np.ones((4, 1, 1, 3), np.float32)
    fields = [
        DenseField("density", density, (0, 0, 0), np.eye(4)),
        DenseField("emission", ones, (1, 0, 0), np.eye(4), (0.0, 0.0, 0.0)),
        DenseField("scattering", ones[:2], (2, 0, 0), np.eye(4), (0.0, 0.0, 0.0)),
        DenseField("empty", ones[:0], (0, 0, 0), np.eye(4), (0.0, 0.0, 0.0)),
    ]
    kept = prune_fields(fields, 0.5)
    assert kept[1].values[:, 0, 0, 0].tolist() == [1, 0, 1, 0]  # voxels 1 to 4
    assert kept[2].values[:, 0, 0, 0].tolist() == [0, 1]  # voxels 2 and 3
    assert kept[3].is_empty


def test_half_floats_lose_a_quarter_of_their_unit_on_average() -> None:
    lost = storage_errors(fields()[:1], fields()[:1], True)
    # numbers are off by at most half of their last of 11 bits, evenly spread: 2^-13 to 2^-14
    assert 2**-14 < lost.storage_density.value * 1.5 < 2**-12


def test_what_half_floats_cannot_hold_is_lost_altogether() -> None:
    faint = DenseField("density", np.full((2, 2, 2), 1e-9, np.float32), (0, 0, 0), np.eye(4))
    assert storage_errors([faint], [faint], True).storage_density.value == 1.0


def test_an_empty_field_loses_nothing() -> None:
    empty = DenseField("density", np.zeros((0, 0, 0), np.float32), (0, 0, 0), np.eye(4))
    lost = storage_errors([empty], [empty], True)
    assert lost.storage_density.value == 0
