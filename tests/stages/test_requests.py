"""Requests on the stage through a whole run: whose word counts, and every way to run agrees."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pxr import Sdf, Usd

from tests.fixtures.pipeline_fixtures import FakeCore, contents, make_style, values_of
from tests.fixtures.usd_fixtures import density_prim, sequence, world, write_sequence, write_text
from usdsmoke import pipeline
from usdsmoke.audit import provenance
from usdsmoke.base.errors import ConfigError, ImageError, OutputExists
from usdsmoke.base.volume import FrameControls
from usdsmoke.config.resolve import resolve_config
from usdsmoke.farm.openjd import submit
from usdsmoke.pipeline import Request, assemble, run_coarse, run_window, stylize
from usdsmoke.ui.cli.main import main

CODES = (1, 2, 3)
WORDS = ("default", "config", "prim", "explicit")  # from the weakest to the strongest


def write_stage(folder: Path, **requests: str) -> Path:
    """A stage with one animated Volume by name, each with its request."""
    write_sequence(folder, CODES)
    body = "".join(
        f"""
    def Volume "{name}" (prepend apiSchemas = ["UsdSmokeStyleAPI"])
    {{
        rel field:density = </World/{name}/density>
        {text.replace("@@", "usdSmoke:request:")}
        {density_prim(sequence(CODES))}
    }}
"""
        for name, text in requests.items()
    )
    return write_text(folder / "shot.usda", world(body))


def flat_style(file_path: Path, colour: tuple[int, int, int]) -> Path:
    """A picture of one colour."""
    file_path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (8, 8), colour).save(file_path)
    return file_path


@pytest.mark.parametrize("strongest", range(len(WORDS)))
@pytest.mark.parametrize("way", ["python", "command", "submitted"])
def test_a_setting_is_the_strongest_of_default_config_prim_and_explicit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], way: str, strongest: int
) -> None:
    """Each word says its own seed; those that are stronger than ``strongest`` are silent."""
    stage = write_stage(tmp_path, smoke="int64 @@seed = 2" if strongest >= 2 else "")
    style = make_style(tmp_path / "style.png")
    config = write_text(tmp_path / "c.yaml", "optimize: {seed: 1}\n" if strongest >= 1 else "")
    explicit = ["optimize.seed=3"] if strongest >= 3 else []
    if way == "python":
        plan = pipeline.plan_request(Request(stage, style, tmp_path / "out", [config, explicit]))
        found = plan.volumes[0].config.optimize.seed
    else:
        given = ["--config", str(config), *(part for text in explicit for part in ("--set", text))]
        if way == "submitted":
            bundle = submit(Request(stage, style, tmp_path / "out", [config, explicit]))
            values = bundle.parameters
            given = ["--config", values["Settings"], "--overrides", values["Overrides"]]
        files = [str(stage), "--style", str(style), "-o", str(tmp_path / "out")]
        assert main(["stylize", *files, *given, "--dry-run", "--json"]) == 0
        described = json.loads(capsys.readouterr().out)
        request = described["volumes"][0]["request"]["settings"]
        found = {**described["config"]["optimize"], **request.get("optimize", {})}["seed"]
    assert found == strongest


@pytest.mark.parametrize("option", ["--seed=3", "--set=optimize.seed=3"])
def test_options_are_stronger_than_a_request_and_the_plan_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    stage = write_stage(tmp_path, smoke="int64 @@seed = 2\nint @@iterations = 4")
    style = make_style(tmp_path / "style.png")
    files = [str(stage), "--style", str(style), "-o", str(tmp_path / "out")]
    assert main(["stylize", *files, option, "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "</World/smoke>: optimize.iterations\n" in out


@pytest.fixture
def two(tmp_path: Path) -> Path:
    """Two Volumes with an image and a seed of their own."""
    flat_style(tmp_path / "red.png", (255, 0, 0))
    flat_style(tmp_path / "sub/blue.png", (0, 0, 255))
    return write_stage(
        tmp_path,
        calm="asset[] @@styleImages = [@./red.png@]\nint64 @@seed = 1\nint @@windowSize = 2",
        wild="asset[] @@styleImages = [@./sub/blue.png@]\nint64 @@seed = 4\n"
        'token[] @@steps = ["colour"]',
    )


@pytest.fixture
def seen(core: FakeCore, monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, int]]:
    """The mean blue of the styles and the seed of every window that the core is given."""
    given: list[tuple[float, int]] = []
    whole = core.stylize_window

    def stylize_window(frames: Any, styles: Any, scene: Any, config: Any, *more: Any) -> Any:
        given.append((float(np.mean([pixels[..., 2] for pixels in styles])), config.optimize.seed))
        return whole(frames, styles, scene, config, *more)

    monkeypatch.setattr(
        sys.modules["usdsmoke.core.sequence.stylize"], "stylize_window", stylize_window
    )
    return given


def test_two_volumes_are_stylized_by_two_styles_in_one_run(
    two: Path, tmp_path: Path, seen: list[tuple[float, int]]
) -> None:
    result = stylize(two, None, tmp_path / "out")
    assert seen == [(0.0, 1), (0.0, 1), (1.0, 4)]  # windows of two frames; all three in one
    by_volume = {
        name: [f for f in result.frames if f.name.startswith(name)] for name in ("calm", "wild")
    }
    # The stand-in halves densities in the shape step, and multiplies colours by 1 + seed.
    assert values_of(by_volume["wild"][0]).max() == 1.0
    assert values_of(by_volume["calm"][0]).max() == pytest.approx(0.5, rel=0.02)
    assert values_of(by_volume["wild"][0], "emission").max() == pytest.approx(5.0)
    stage = Usd.Stage.Open(str(result.root_stage))
    for name, image, seed in (("calm", "red.png", 1), ("wild", "blue.png", 4)):
        prim = stage.GetPrimAtPath(f"/World/{name}")
        assert prim.GetAttribute("usdSmoke:seed").Get() == seed
        (style,) = prim.GetAttribute("usdSmoke:style").Get()
        assert style.startswith(f"{image} ")
    assert len(result.contact_sheets) == 2


@pytest.mark.usefixtures("core")
def test_windows_one_by_one_give_what_one_call_gives(two: Path, tmp_path: Path) -> None:
    settings = ["colour.smoothing=0.1"]
    whole = stylize(two, None, tmp_path / "whole", settings=settings)
    part = tmp_path / "part"
    run_coarse(Request(two, None, part, settings))
    for window in range(3):
        run_window(Request(two, None, part, settings), window)
    pieced = assemble(part)
    assert [values_of(f, "emission").tobytes() for f in pieced.frames] == [
        values_of(f, "emission").tobytes() for f in whole.frames
    ]


@pytest.mark.usefixtures("core")
def test_an_explicit_setting_stays_explicit_when_the_run_is_assembled(
    two: Path, tmp_path: Path
) -> None:
    run_coarse(Request(two, None, tmp_path / "out", ["optimize.seed=9"]))
    for window in range(3):
        run_window(Request(two, None, tmp_path / "out", {"optimize": {"seed": 9}}), window)
    result = assemble(tmp_path / "out")
    assert {volume.config.optimize.seed for volume in result.plan.volumes} == {9}
    values = [values_of(frame, "emission").max() for frame in result.frames]
    assert min(values) > 4  # 1 + seed is 10, times half the density at least


@pytest.mark.usefixtures("core")
def test_a_changed_request_is_another_run_and_a_moved_shot_is_not(
    two: Path, tmp_path: Path
) -> None:
    run_window(Request(two, None, tmp_path / "out"), 0)
    record = next((tmp_path / "out").glob("vdb/*/run.json")).read_text(encoding="utf-8")
    assert str(tmp_path) not in record
    moved = tmp_path / "moved"
    for name in ("shot.usda", "red.png", "sub", "cache", "out"):
        copy = shutil.copytree if (tmp_path / name).is_dir() else shutil.copy
        moved.mkdir(exist_ok=True)
        copy(tmp_path / name, moved / name)
    assert run_window(Request(moved / "shot.usda", None, moved / "out"), 0).was_done
    two.write_text(two.read_text().replace("request:seed = 4", "request:seed = 5"))
    with pytest.raises(
        OutputExists, match=r"request of </World/wild> for optimize\.seed was 4, now 5"
    ):
        run_window(Request(two, None, tmp_path / "out"), 1)


@pytest.mark.usefixtures("core")
def test_another_image_under_the_same_name_is_another_run(two: Path, tmp_path: Path) -> None:
    run_window(Request(two, None, tmp_path / "out"), 0)
    flat_style(tmp_path / "sub/blue.png", (0, 255, 0))
    with pytest.raises(OutputExists, match=r"style image blue\.png"):
        run_window(Request(two, None, tmp_path / "out"), 1)


@pytest.mark.usefixtures("core")
def test_the_record_of_the_layer_and_of_the_files_hold_the_request(
    two: Path, tmp_path: Path
) -> None:
    result = stylize(two, None, tmp_path / "out")
    text = Sdf.Layer.FindOrOpen(str(result.look_layer)).ExportToString().replace("\\", "")
    assert '"settings": {"optimize": {"seed": 4' in text
    (found,) = provenance(result.look_layer)
    asked = [request for request in found.record.requests.values() if request["settings"]]
    assert any(request["settings"].get("optimize", {}).get("seed") == 4 for request in asked)
    assert any("blue.png" in style for request in asked for style in request["styles"])


def test_style_images_of_the_command_stand_in_for_all_and_for_their_weights(
    two: Path, tmp_path: Path, seen: list[tuple[float, int]]
) -> None:
    two.write_text(
        two.read_text().replace(
            "int64 usd", "double[] usdSmoke:request:styleWeights = [1]\nint64 usd"
        )
    )
    green = flat_style(tmp_path / "green.png", (0, 255, 0))
    blue = tmp_path / "sub/blue.png"
    stylize(two, [green, blue], tmp_path / "out", {"style": {"weights": [1, 3]}})
    assert seen == [(0.5, 1), (0.5, 1), (0.5, 4)]


def test_images_without_the_api_are_named_with_the_remedy(tmp_path: Path) -> None:
    make_style(tmp_path / "style.png")
    stage = write_stage(tmp_path, own="asset[] @@styleImages = [@./style.png@]")
    text = stage.read_text()
    assert "UsdSmokeStyleAPI" in text
    stage.write_text(text.replace("UsdSmokeStyleAPI", "UsdSmokeOtherAPI"))
    with pytest.raises(ImageError, match=r"</World/own> has .*styleImages.*UsdSmokeStyleAPI"):
        pipeline.plan_request(Request(stage, None, tmp_path / "out"))


def test_volumes_without_images_are_named(tmp_path: Path) -> None:
    make_style(tmp_path / "style.png")
    stage = write_stage(tmp_path, bare="", own="asset[] @@styleImages = [@./style.png@]", naked="")
    with pytest.raises(
        ImageError, match=r"</World/bare>, </World/naked>.*--style.*request:styleImages"
    ):
        pipeline.plan_request(Request(stage, None, tmp_path / "out"))
    own = pipeline.plan_request(
        Request(stage, None, tmp_path / "out", resolve_config({"stage": {"prims": ["/World/own"]}}))
    )
    assert own.volumes[0].styles == (0,)


def test_settings_that_contradict_each_other_name_the_volume(tmp_path: Path) -> None:
    make_style(tmp_path / "style.png")
    images = "asset[] @@styleImages = [@./style.png@]"
    stage = write_stage(tmp_path, smoke=f"{images}\ndouble[] @@styleWeights = [1, 2]", other=images)
    with pytest.raises(ConfigError, match=r"^Volume </World/smoke>: style\.weights has 2 numbers"):
        pipeline.plan_request(
            Request(
                stage, None, tmp_path / "out", resolve_config({"style": {"weights": [1, 2, 3]}})
            )
        )


def test_samples_reach_the_core_frame_by_frame_unless_something_stronger_is_said(
    tmp_path: Path,
) -> None:
    stage = write_stage(tmp_path, smoke="double @@strength.timeSamples = { 1: 0, 3: 1 }")
    style = make_style(tmp_path / "style.png")
    plans = [
        pipeline.plan_request(
            Request(
                stage,
                style,
                tmp_path / "out",
                [resolve_config({"optimize": {"strength": 0}}), explicit],
            )
        )
        for explicit in ([], ["optimize.strength=0.5"])
    ]
    controls = [[frame.source.controls for frame in plan.volumes[0].frames] for plan in plans]
    assert controls[0] == [FrameControls(0.0), FrameControls(0.5), FrameControls(1.0)]
    assert controls[1] == [FrameControls()] * 3
    assert [plan.volumes[0].config.optimize.strength for plan in plans] == [1.0, 0.5]


def test_controls_come_with_the_frames_that_the_core_reads(tmp_path: Path, core: FakeCore) -> None:
    stage = write_stage(tmp_path, smoke="double @@patternSpeed.timeSamples = { 1: 1, 3: 3 }")
    given = []
    whole = core._stylize

    def keep(frame: Any, *more: Any) -> Any:
        given.append(frame.controls.pattern_speed)
        return whole(frame, *more)

    core._stylize = keep  # type: ignore[method-assign]
    stylize(stage, make_style(tmp_path / "style.png"), tmp_path / "out")
    assert given == [1.0, 2.0, 3.0]


@pytest.mark.usefixtures("core")
def test_the_mask_of_a_request_is_read_from_its_own_field_prim(tmp_path: Path) -> None:
    field = density_prim("asset filePath = @./cache/smoke.0001.vdb@", name="fade")
    stage = write_stage(tmp_path, smoke=f"rel @@mask = </World/smoke/fade>\n{field}", bare="")
    style = make_style(tmp_path / "style.png")
    plan = pipeline.plan_request(Request(stage, style, tmp_path / "out"))
    masks = {
        volume.source.prim_path: [frame.mask is not None for frame in volume.frames]
        for volume in plan.volumes
    }
    assert masks == {"/World/smoke": [True] * 3, "/World/bare": [False] * 3}
    assert contents(stylize(stage, style, tmp_path / "out").root_stage)


def test_requests_that_do_not_count_are_left_out_with_the_reason(tmp_path: Path) -> None:
    stage = write_stage(tmp_path, smoke="int64 @@seed = 4")
    stage.write_text(stage.read_text().replace('(prepend apiSchemas = ["UsdSmokeStyleAPI"])', ""))
    plan = pipeline.plan_request(
        Request(stage, make_style(tmp_path / "style.png"), tmp_path / "out")
    )
    (reason,) = (item.reason for item in plan.omitted if "request:seed" in item.what)
    assert "UsdSmokeStyleAPI is not applied" in reason
    assert plan.volumes[0].config.optimize.seed == 0


def test_sentences_tell_for_which_volumes_where_settings_differ(two: Path, tmp_path: Path) -> None:
    plan = pipeline.plan_request(Request(two, None, tmp_path / "out"))
    assert any(text.startswith("shape step") and "</World/calm>" in text for text in plan.needed)
    assert not any(text.startswith("shape step") and "/wild" in text for text in plan.needed)
    what = [omission.what for omission in plan.omitted]
    assert "displacement of the density of </World/wild>" in what
