"""What a report cannot do is refused before the first measurement; old reports go as a whole."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.fixtures.report_fixtures import QUICK, TinyScene, make_scene
from usdsmoke.base.errors import (
    ConfigError,
    FeatureError,
    ImageError,
    Interrupted,
    LayerError,
    OutputExists,
    WriteFailed,
)
from usdsmoke.work_precision import Plan, ReportResult, Sweep, Task, make_report

pytestmark = pytest.mark.usefixtures("quick_grids")


def sweep_of(name: str, tell: list[str]) -> Sweep:
    """One point, and a note that it was measured."""

    def work(run: int) -> float:
        tell.append(name)
        return 0.5

    plan = Plan([Task("curve", "point", work, lambda found: found, configured=True)], *"xyz")
    return Sweep(name, f"Sweep {name}", lambda case: "", lambda case: plan)


def report(
    scene: TinyScene, *settings: str, names: str = "a", told: list[str] | None = None
) -> ReportResult:
    sweeps = [sweep_of(name, [] if told is None else told) for name in names]
    return make_report(
        scene.stage, scene.style, scene.output, settings=[*QUICK, *settings], sweeps=sweeps
    )


@pytest.fixture
def scene(tmp_path: Path) -> TinyScene:
    return make_scene(tmp_path, n_frames=1)


def test_a_time_in_which_nothing_can_be_measured_is_refused(scene: TinyScene) -> None:
    slow = replace(sweep_of("a", []).plan(None), rate=3600.0)  # type: ignore[arg-type]
    sweeps = [Sweep("a", "Sweep a", lambda case: "", lambda case: slow)]
    with pytest.raises(ConfigError, match=r"^600 s .*--budget"):
        make_report(
            scene.stage, scene.style, scene.output, settings=QUICK, seconds=600, sweeps=sweeps
        )
    assert not scene.output.exists()


@pytest.mark.parametrize("name", ["bad.pth", "gone.pth"])
@pytest.mark.parametrize("network", ["embedded", "vgg19"])
def test_a_network_that_is_named_and_cannot_be_read_is_refused_first(
    name: str, network: str, scene: TinyScene
) -> None:
    file_path = scene.stage.parent / name
    if name == "bad.pth":
        file_path.write_bytes(b"no weights")
    told: list[str] = []
    settings = [f"features.vgg19_file={file_path}", f"features.network={network}"]
    settings += ["features.layers=[]"] if network == "vgg19" else []
    with pytest.raises(FeatureError, match=name) as caught:
        report(scene, *settings, told=told)
    assert "weights_only" not in str(caught.value) and "torch.load" not in str(caught.value)
    assert not told and not scene.output.exists()


def test_a_network_that_nothing_is_compared_with_is_not_looked_for(scene: TinyScene) -> None:
    assert report(scene, "features.vgg19_file=/nope.pth", "optimize.steps=[shape]").page.is_file()


@pytest.mark.parametrize("target", ["taken", "taken/q", "taken/q/r"])
def test_a_folder_that_cannot_be_made_is_refused_first(target: str, scene: TinyScene) -> None:
    taken = scene.stage.parent / "taken"
    taken.write_text("mine")
    told: list[str] = []
    elsewhere = TinyScene(scene.stage, scene.style, scene.stage.parent / target)
    with pytest.raises(LayerError, match="file"):
        report(elsewhere, told=told)
    assert not told and taken.read_text() == "mine"


def test_a_folder_that_cannot_be_written_to_is_refused_and_none_is_left(
    scene: TinyScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: object, **more: object) -> None:
        raise PermissionError(13, "Permission denied")

    told: list[str] = []
    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    with pytest.raises(WriteFailed, match="Permission denied"):
        report(scene, told=told)
    assert not told and not scene.output.exists()


def test_a_style_that_is_none_is_refused_first(scene: TinyScene) -> None:
    scene.style.write_bytes(b"no picture")
    told: list[str] = []
    with pytest.raises(ImageError):
        report(scene, told=told)
    assert not told and not scene.output.exists()


def test_an_old_report_goes_as_a_whole_and_other_files_stay(scene: TinyScene) -> None:
    first = report(scene, names="ab")
    assert (scene.output / "b.png").is_file()
    (scene.output / "notes.txt").write_text("mine")
    (scene.output / "other.png").write_text("mine")
    second = report(scene, names="a")
    kept = {file_path.name for file_path in scene.output.iterdir()}
    assert kept == {"a.png", "report.html", "report.json", "notes.txt", "other.png"}
    assert set(first.files) - set(second.files) == {scene.output / "b.png"}
    held = json.loads((scene.output / "report.json").read_text(encoding="utf-8"))["files"]
    assert {scene.output / name for name in held} == set(second.files)


@pytest.mark.parametrize("name", ["a.png", "report.html", "report.json"])
def test_a_file_of_somebody_else_is_not_overwritten(name: str, scene: TinyScene) -> None:
    scene.output.mkdir()
    (scene.output / name).write_text("mine")
    told: list[str] = []
    with pytest.raises(OutputExists, match=name):
        report(scene, told=told)
    assert not told and (scene.output / name).read_text() == "mine"


def test_a_file_beside_an_old_report_that_it_does_not_own_is_not_overwritten(
    scene: TinyScene,
) -> None:
    report(scene, names="a")
    (scene.output / "b.png").write_text("mine")
    with pytest.raises(OutputExists, match=r"b\.png"):
        report(scene, names="ab")
    assert (scene.output / "b.png").read_text() == "mine"


def test_a_report_that_is_stopped_keeps_nothing_and_says_so(
    scene: TinyScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = report(scene)
    before = old.page.read_bytes()

    def stop(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("usdsmoke.work_precision.report.run_sweeps", stop)
    with pytest.raises(Interrupted, match="measurement"):
        report(scene)
    assert old.page.read_bytes() == before
    new = TinyScene(scene.stage, scene.style, scene.stage.parent / "new")
    with pytest.raises(Interrupted):
        report(new)
    assert not new.output.exists()
