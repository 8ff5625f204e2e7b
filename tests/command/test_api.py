"""The Python API: what a user imports is there, is a function, and takes what the manual says."""

import importlib
import pkgutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import usdsmoke
from tests.fixtures.pipeline_fixtures import FakeCore, Shot

FUNCTIONS = (
    "inspect", "plan", "stylize", "preview", "validate", "provenance", "verify", "rerun", "report",
    "settings",
)  # fmt: skip


def test_every_public_name_is_there_and_no_module_hides_one() -> None:
    assert set(FUNCTIONS) < set(usdsmoke.__all__)
    assert all(getattr(usdsmoke, name) is not None for name in usdsmoke.__all__)
    for module in pkgutil.iter_modules(usdsmoke.__path__, "usdsmoke."):
        if module.name != "usdsmoke.__main__":
            importlib.import_module(module.name)  # which sets it as an attribute of the package
    for name in FUNCTIONS:
        assert callable(getattr(usdsmoke, name)), name


@pytest.mark.parametrize(
    "settings",
    [
        {"windows.size": 2},
        {"windows": {"size": 2}},
        "windows.size=2",
        ["windows.size=3", {"windows.size": 2}],
    ],
    ids=["dotted", "nested", "text", "list"],
)
def test_settings_are_taken_in_every_form(shot: Shot, settings: object) -> None:
    plan = usdsmoke.plan(shot.stage, shot.style, shot.output, settings)  # type: ignore[arg-type]
    assert plan.volumes[0].config.windows.size == 2
    assert plan.n_frames == 3 and not shot.output.exists()


def test_an_open_stage_is_taken_like_its_path(shot: Shot) -> None:
    from pxr import Usd

    stage = Usd.Stage.Open(str(shot.stage))
    assert usdsmoke.plan(stage, shot.style).n_frames == 3
    assert usdsmoke.inspect(stage)["volumes"] == usdsmoke.inspect(shot.stage)["volumes"]
    stage.DefinePrim("/Unsaved")
    with pytest.raises(usdsmoke.UsdSmokeError, match="unsaved"):
        usdsmoke.plan(stage, shot.style)


def test_previews_networks_and_reports_print_in_a_few_lines() -> None:
    from usdsmoke.pictures.preview import PreviewResult
    from usdsmoke.runs.train import TrainResult
    from usdsmoke.work_precision import Report, ReportResult

    files = (Path("a.exr"), Path("b.exr"))
    drawn = PreviewResult(files, (1.0, 2.0), 64, 32, "", (0.0, 0.0), {"/smoke": 1.0}, ("dim",))
    assert str(drawn).splitlines() == ["a.exr and 1 more: 64 x 32 pixels", "dim"]
    network = TrainResult(Path("net.safetensors"), "/smoke", (1.0,), 2.0, 0.25, 0.5, 8, 99, 1.0)
    assert "net.safetensors" in str(network) and "1 frame," in str(network)
    assert "0.25" in str(network) and "0.5" in str(network) and "\n" not in str(network)
    page = ReportResult(Path("page.html"), (Path("page.html"),), Report("title", {}, (), (), ()))
    assert str(page) == "page.html"


def test_what_is_no_stage_or_no_settings_is_refused_by_name(shot: Shot) -> None:
    calls: list[Callable[[Any], object]] = [
        usdsmoke.inspect,
        usdsmoke.validate,
        lambda stage: usdsmoke.preview(stage, shot.folder / "look.png"),
        lambda stage: usdsmoke.plan(stage, shot.style),
    ]
    for call in calls:
        with pytest.raises(usdsmoke.UsdSmokeError, match=r"^None .*layer\.mode=layer"):
            call(None)
    for settings in (7, [7], [None, 7]):
        with pytest.raises(usdsmoke.UsdSmokeError, match=r"^7 .*YAML"):
            usdsmoke.plan(shot.stage, shot.style, settings=settings)


@pytest.mark.parametrize("name", ["net.pt", "net", "net.safetensors.bak"])
def test_a_network_under_another_suffix_is_refused_before_it_is_trained(name: str) -> None:
    with pytest.raises(usdsmoke.UsdSmokeError, match=rf"\.safetensors .*{name}"):
        usdsmoke.train("no_stage.usda", "no_image.png", name)


def test_every_setting_is_explained() -> None:
    settings = usdsmoke.settings()
    assert len(settings) > 60
    assert all(entry["description"] for entry in settings.values())


def test_a_plan_and_a_result_print_in_a_few_lines(shot: Shot, core: FakeCore) -> None:
    planned = usdsmoke.plan(shot.stage, shot.style, shot.output)
    assert str(planned).startswith("</World/smoke>: 3 frames in 1 window,")
    result = usdsmoke.stylize(shot.stage, shot.style, shot.output)
    assert str(result).startswith(f"{result.root_stage}: {len(result.frames)} VDB files")
    assert max(len(str(planned)), len(str(result))) < 1500
    again = str(usdsmoke.rerun(result.look_layer, shot.folder / "again"))
    assert "3 frames, as recorded" in again and len(again) < 1500
