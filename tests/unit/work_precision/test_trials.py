"""Sweeps that stylize do so as configured, and are measured against runs that do far more."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.fixtures.report_fixtures import case_of, make_scene
from tests.fixtures.smoke_fixtures import random_style
from usdsmoke.work_precision import SWEEPS, Plan, Sweep
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.records import LeftOut
from usdsmoke.work_precision.trial import Setting, base_iterations, reference_of, scaled

pytestmark = pytest.mark.usefixtures("quick_grids")

_TRIALS = ("iterations_colour", "iterations_shape", "views", "octaves", "views_count")
_BY_NAME: dict[str, Sweep] = {sweep.name: sweep for sweep in SWEEPS}
_TIMES = {"shape": 1.0, "colour": 1.0}  # seconds that a trial is taken to last


def timeless(case: Case) -> Case:
    """A case whose trials are not tried first: what they do must not depend on the clock."""
    case.cache["trial seconds"] = dict(_TIMES)
    return case


def ring(plan: Plan) -> str:
    (task,) = [task for task in plan.tasks if task.configured]
    return task.label


@pytest.mark.parametrize("name", _TRIALS)
def test_the_configured_point_runs_the_configured_settings(name: str, tmp_path: Path) -> None:
    case = timeless(case_of(make_scene(tmp_path, n_frames=1), "colour.iterations=[3, 5]"))
    plan = _BY_NAME[name].plan(case)
    (task,) = [task for task in plan.tasks if task.configured]
    found = task.work(0)
    step = "shape" if name.endswith("shape") else "colour"
    assert found.config == case.config
    assert [len(end.losses) for end in found.ends] == list(getattr(case.config, step).iterations)
    assert len(plan.tasks) >= 3 and plan.n_runs >= 2


@pytest.mark.parametrize("name", ["views", "octaves", "views_count"])
def test_with_the_shape_step_alone_its_results_are_judged(name: str, tmp_path: Path) -> None:
    scene = make_scene(tmp_path, n_frames=1)
    case = timeless(case_of(scene, "optimize.steps=[shape]", "shape.iterations=[4, 4]"))
    plan = _BY_NAME[name].plan(case)
    assert plan.about.startswith("The shape step")
    for task in plan.tasks[:2]:
        task.prepare()
        assert 0 < task.error(task.work(0)) < 2


def test_references_do_more_than_every_point_and_have_seeds_of_their_own(tmp_path: Path) -> None:
    case = timeless(case_of(make_scene(tmp_path, n_frames=1), "colour.iterations=[8, 8]"))
    reference = reference_of(case, "colour")
    assert reference.n_iterations == 4 * 16 and reference.losses[0] != reference.losses[1]
    assert reference.of_loss(reference.start) == pytest.approx(1.0)
    assert reference.of_loss(max(reference.losses)) == pytest.approx(reference.apart)
    assert reference_of(case, "colour") is reference  # made once
    for name in ("iterations_colour", "octaves", "views_count"):
        plan = _BY_NAME[name].plan(case)
        assert plan.uncertain == reference.apart
        for text in (f"{reference.losses[0]:.4g}", f"{reference.losses[1]:.4g}"):
            assert text in plan.reference


def test_errors_fall_with_the_iterations(tmp_path: Path) -> None:
    settings = ("colour.iterations=[0, 24]", "views.azimuth=12", "views.elevation=6")
    scene = make_scene(tmp_path, n_frames=1)
    Image.fromarray((random_style() * 255).astype(np.uint8)).save(scene.style)
    case = timeless(case_of(scene, *settings))
    reference = reference_of(case, "colour")
    trial, base = reference.trial, base_iterations(case, "colour")
    errors = [
        reference.error(trial.run(Setting(scaled(base, share), case.config), 0))
        for share in (0.1, 0.5, 1.0)
    ]
    assert errors[0] > 1.5 * errors[1] > 1.5 * errors[2] > 0


def test_a_single_view_is_told_to_fit_no_other(tmp_path: Path) -> None:
    case = timeless(case_of(make_scene(tmp_path, n_frames=1), "colour.iterations=[0, 60]"))
    plan = _BY_NAME["views"].plan(case)
    tasks = {task.label: task for task in plan.tasks}
    one, many = (tasks[f"views.pool={n}"] for n in (1, 64))
    alone = one.error(one.work(0))
    assert alone > 3 * many.error(many.work(0))
    assert plan.chance is not None and 0 < plan.chance() < alone / 3


def test_a_rule_that_stops_early_is_told_with_what_was_done(tmp_path: Path) -> None:
    slow = ("colour.learning_rate=1e-5", "optimize.tolerance=0.9", "colour.iterations=[0, 40]")
    case = timeless(case_of(make_scene(tmp_path, n_frames=1), *slow))
    tasks = _BY_NAME["iterations_colour"].plan(case).tasks
    notes = {task.label: task.note(task.work(0)) for task in tasks if task.note is not None}
    assert notes["40 iterations (1x)"] == "26 of 40 done"
    assert notes["no rule (optimize.tolerance=0)"] == ""


@pytest.mark.parametrize("name", [*_TRIALS, "windows", "windows_style"])
def test_what_does_not_fit_is_left_out_and_says_what_it_would_take(
    name: str, tmp_path: Path
) -> None:
    case = timeless(case_of(make_scene(tmp_path)))
    case.allowed = 5.0
    with pytest.raises(LeftOut, match=r"about \d+ s.*5 s were"):
        _BY_NAME[name].plan(case)


def test_windows_are_measured_though_single_frames_are_configured(tmp_path: Path) -> None:
    scene = make_scene(tmp_path, n_frames=3)
    case = timeless(case_of(scene, "windows.size=1", "optimize.steps=[shape]"))
    assert case.frame.velocity is None  # a run does not read it
    windows, style = _BY_NAME["windows"], _BY_NAME["windows_style"]
    assert windows.applies(case) == ""
    temporal, styles = windows.plan(case), style.plan(case)
    assert ring(temporal) == "single frames" and len(temporal.tasks) == 3
    assert [task.key for task in temporal.tasks] == [task.key for task in styles.tasks]
    found = temporal.tasks[0].work(0)
    assert len(found) == 3 and temporal.tasks[0].error(found) > 0
    assert 0 < styles.tasks[0].error(found) < 2


def test_a_window_longer_than_the_frames_is_told_to_be_cut(tmp_path: Path) -> None:
    case = timeless(case_of(make_scene(tmp_path, n_frames=3), "windows.size=12"))
    plan = _BY_NAME["windows"].plan(case)
    assert ring(plan) == "windows of 12, cut to 3 frames"
    assert "12" in plan.about and "3 frames" in plan.about


def test_the_small_copy_gets_smaller_where_trials_take_too_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from usdsmoke.work_precision import trial

    case = case_of(make_scene(tmp_path, n_frames=1, n=12))
    monkeypatch.setattr("usdsmoke.work_precision.case._SHORTEST", 3)
    monkeypatch.setattr(trial, "_pilot", lambda case, step: (case.longest, case.longest))
    case.longest, case.seconds = 12, 200.0  # 20 trials of 12 s are more than half of it
    assert trial.trial_seconds(case, "colour") == 3.0 and case.longest == 3
    assert case.halvings == 2


def test_a_smaller_copy_that_takes_nearly_as_long_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from usdsmoke.work_precision import trial

    case = case_of(make_scene(tmp_path, n_frames=1, n=12))
    monkeypatch.setattr("usdsmoke.work_precision.case._SHORTEST", 3)
    monkeypatch.setattr(trial, "_pilot", lambda case, step: (10 + case.longest / 100,) * 2)
    case.longest = 12
    assert trial.trial_seconds(case, "colour") == pytest.approx(10.12)
    assert case.longest == 12 and case.halvings == 0
