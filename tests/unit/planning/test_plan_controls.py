"""Controls of single frames in plans, and on their way from the stage to the look."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest
from pxr import Sdf

from tests.fixtures.mask_fixtures import make_stage, write_mask
from tests.fixtures.pipeline_fixtures import Shot, run, values_of
from usdsmoke.base.errors import ConfigError
from usdsmoke.base.volume import FrameControls
from usdsmoke.config.resolve import resolve_config
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.make_plan import make_plan
from usdsmoke.planning.plan import Plan
from usdsmoke.usd.schema import STYLE_API
from usdsmoke.usd.stage import find_volumes, open_stage
from usdsmoke.usd.volume_settings import VolumeSettings


def plan_of(stage: Path, *assignments: str, n_styles: int = 1, **values: list[Any]) -> Plan:
    """The plan of the stage's Volume, with one value of each control per frame."""
    config = resolve_config(assignments)
    source = find_volumes(open_stage(stage), config.stage)
    (volume,) = source.volumes
    frames = tuple(
        dataclasses.replace(f, controls=FrameControls(**{k: v[n] for k, v in values.items()}))
        for n, f in enumerate(volume.frames)
    )
    volumes = (dataclasses.replace(volume, frames=frames),)
    settings = [VolumeSettings(config, tuple(range(n_styles)))]
    return make_plan(dataclasses.replace(source, volumes=volumes), config, settings)


def reason_for(plan: Plan, what: str) -> str:
    return next((item.reason for item in plan.omitted if item.what.startswith(what)), "")


def test_a_fade_is_optimised_though_the_runs_strength_is_0(shot: Shot) -> None:
    none = plan_of(shot.stage, "optimize.strength=0", "windows.size=2")
    fade = plan_of(shot.stage, "optimize.strength=0", "windows.size=2", strength=[0.0, 0.0, 1.0])
    whole = plan_of(shot.stage, "windows.size=2")
    assert "optimize.strength is 0" in reason_for(none, "the optimisation")
    assert none.volumes[0].coarse_runs == ()
    assert fade.volumes[0].windows == whole.volumes[0].windows != none.volumes[0].windows
    assert fade.volumes[0].coarse_runs == whole.volumes[0].coarse_runs != ()
    assert none.estimate.seconds < fade.estimate.seconds < whole.estimate.seconds
    what = "the optimisation at timeCode 1 of </World/smoke>"
    assert [item.what for item in fade.omitted if item.what.startswith("the opt")] == [what]
    assert "optimize.strength is 0 there" in reason_for(fade, what)


def test_frames_that_all_have_strength_0_are_as_good_as_a_run_of_strength_0(shot: Shot) -> None:
    never = plan_of(shot.stage, strength=[0.0, 0.0, 0.0])
    none = plan_of(shot.stage, "optimize.strength=0")
    assert never.omitted == none.omitted and never.volumes[0].windows == none.volumes[0].windows
    assert never.estimate.seconds == none.estimate.seconds


def sentences_on(plan: Plan, beginning: str) -> list[str]:
    """What the plan needs, of sentences that begin so."""
    return [sentence for sentence in plan.needed if sentence.startswith(beginning)]


def test_the_plan_tells_of_the_settings_that_frames_have_of_their_own(shot: Shot) -> None:
    plan = plan_of(
        shot.stage,
        n_styles=2,
        strength=[0.0, 0.5, 1.0],
        gamma=[None, 0.25, None],
        style_weights=[(1.0, 0.0), (0.5, 0.5), (0.0, 1.0)],
    )
    for setting, facts in (
        ("optimize.strength", ("3 frames", "0 to 1")),
        ("optics.gamma", ("1 frame", "0.25 to 0.25")),
        ("style.weights", ("3 frames",)),
    ):
        (sentence,) = sentences_on(plan, setting)
        assert all(fact in sentence for fact in facts)
        assert not sentences_on(plan_of(shot.stage), setting)
    measured = "extinction of the colour step"
    assert sentences_on(plan, measured)
    assert not sentences_on(plan_of(shot.stage, gamma=[0.1, 0.25, 0.5]), measured)


def test_weights_that_do_not_fit_the_images_end_the_plan(shot: Shot) -> None:
    with pytest.raises(ConfigError, match=r"/World/smoke>: at timeCode 2: style.weights has 1"):
        plan_of(shot.stage, n_styles=2, style_weights=[None, (1.0,), None])


@pytest.mark.usefixtures("quick_grids")
def test_a_mask_is_read_where_a_frame_is_computed_and_controls_come_along(tmp_path: Path) -> None:
    write_mask(tmp_path / "in/fade.vdb")
    stage = make_stage(tmp_path / "in")
    plan = plan_of(stage, "stage.mask=fade", strength=[0.0, 0.0, 1.0])
    reader, (volume,) = FrameReader(plan), plan.volumes
    frames = [reader.read(volume, frame) for frame in volume.frames]
    assert [frame.mask is None for frame in frames] == [True, False, False]
    assert [frame.controls.strength for frame in frames] == [0.0, 0.0, 1.0]


def test_time_samples_on_the_stage_reach_the_files_and_the_look(
    shot: Shot, quick_grids: None
) -> None:
    """The whole way, with the core itself on two dozen voxels."""
    layer = Sdf.Layer.FindOrOpen(str(shot.stage))
    spec = layer.GetPrimAtPath("/World/smoke")
    spec.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=[STYLE_API]))
    for name, values in {"strength": (0.0, 0.5, 1.0), "gamma": (0.25, 0.5, 1.0)}.items():
        asked = Sdf.AttributeSpec(spec, f"usdSmoke:request:{name}", Sdf.ValueTypeNames.Double)
        for code, value in enumerate(values, start=1):
            layer.SetTimeSample(asked.path, code, value)
    layer.Save()
    few = ["shape.iterations=[1]", "colour.iterations=[1]", "views.pool=1", "views.image_size=16"]
    result = run(shot, *few, "optimize.threads=1", "optimize.device=cpu")
    source = values_of(shot.stage.parent / "cache/smoke.0001.vdb")
    assert (values_of(result.frames[0]) == source).all()
    assert not values_of(result.frames[0], "emission").any()
    assert values_of(result.frames[2], "emission").any()
    look = open_stage(result.root_stage)
    volume = look.GetPrimAtPath("/World/smoke")
    extinction = volume.GetAttribute("usdSmoke:extinctionPerDensity")
    found = [extinction.Get(code) for code in (1.0, 2.0, 3.0)]
    assert extinction.GetTimeSamples() == [1.0, 2.0, 3.0]
    assert found[1] == pytest.approx(2 * found[0]) and found[2] == pytest.approx(4 * found[0])
