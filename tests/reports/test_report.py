"""Reports of tiny scenes: the page holds what was measured, and names what was not."""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.shape_cost import write_vgg19
from tests.fixtures.pipeline_fixtures import run_here
from tests.fixtures.report_fixtures import QUICK, case_of, colourful, make_scene
from usdsmoke.base.errors import LayerError, PlanError
from usdsmoke.base.volume import DenseField
from usdsmoke.ui.cli.main import main
from usdsmoke.vdb.write import write_frame
from usdsmoke.work_precision import SWEEPS, ReportResult, Sweep, make_report
from usdsmoke.work_precision.page import number
from usdsmoke.work_precision.trial import Setting, Trial, untiring

_VOID = {"meta", "img", "br"}


def shortened(sweep: Sweep) -> Sweep:
    """Two points of a sweep, once each; three of windows: the last are single frames."""
    n = 3 if sweep.name.startswith("windows") else 2

    def plan(case: object) -> object:
        whole = sweep.plan(case)  # type: ignore[arg-type]
        return replace(whole, tasks=whole.tasks[:n], n_runs=1, warm_up=False)

    return replace(sweep, plan=plan)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ReportResult]:
    """A report with two points of every sweep that a moving puff has a use for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("usdsmoke.vdb.child.run_child", run_here)
        scene = make_scene(tmp_path_factory.mktemp("report"))
        colourful(scene.style)
        sweeps = [shortened(sweep) for sweep in SWEEPS]
        yield make_report(
            scene.stage, scene.style, scene.output, settings=QUICK, sweeps=sweeps, seconds=1e6
        )


class Page(HTMLParser):
    """Tags that are closed in their order, links, pictures and the text."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.text = ""
        self.cells: list[list[str]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in ("script", "link", "iframe", "object")
        if tag not in _VOID:
            self.open.append(tag)
        if tag == "tr":
            self.cells.append([])
        for name, value in attrs:
            if name in ("src", "href", "srcset", "data", "action"):
                self.links.append(value or "")
            if name == "id":
                self.ids.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data
        if "td" in self.open:
            self.cells[-1].append(data)


def test_the_page_is_whole_and_needs_nothing_else(result: ReportResult) -> None:
    text = result.page.read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == [] and "http" not in text and "url(" not in text
    kinds = ("data:image/png;base64,", "data:image/webp;base64,")
    for link in page.links:
        assert link.startswith(kinds) or link[1:] in page.ids
    pictures, films = ([x for x in page.links if x.startswith(kind)] for kind in kinds)
    assert len(pictures) == len(result.report.sweeps) == 8
    assert len(films) == 1


def test_every_sweep_has_a_verdict_and_the_configured_point(result: ReportResult) -> None:
    text = Page(result.page.read_text(encoding="utf-8")).text
    for sweep in result.report.sweeps:
        assert sweep.verdict and sweep.verdict in text
        assert sweep.configured is not None, sweep.name


def test_json_holds_the_numbers_of_the_page(result: ReportResult) -> None:
    folder = result.page.parent
    held = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    points = [point for sweep in held["sweeps"] for point in sweep["points"]]
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    shown = {(row[0], row[1], row[2], row[5]) for row in page.cells if row}
    assert len(points) >= 12
    for point in points:
        numbers = [number(point[name]["median"]) for name in ("error", "cost")]
        assert (point["curve"], point["label"], *numbers) in shown


def test_diagrams_are_files_too_and_nothing_else_is_left(result: ReportResult) -> None:
    names = {file_path.name for file_path in result.page.parent.iterdir()}
    pictures = {f"{sweep.name}.png" for sweep in result.report.sweeps}
    assert names == pictures | {"windows.webp", "report.html", "report.json"}
    for name in pictures:
        with Image.open(result.page.parent / name) as picture:
            assert picture.width > 600


def test_frames_alone_in_windows_and_the_source_are_shown_beside_each_other(
    result: ReportResult,
) -> None:
    with Image.open(result.page.parent / "windows.webp") as film:
        assert film.n_frames == 3
        pictures = []
        for number in range(3):
            film.seek(number)
            pictures.append(np.asarray(film.convert("RGB"), float))
    for picture in pictures:
        below = picture[80:]  # the title and the labels
        thirds = np.array_split(below, 3, axis=1)
        assert all(third.std() > 5 for third in thirds)
        chromas = [np.ptp(third, axis=-1).max() for third in thirds]
        assert 3 * chromas[2] < min(chromas[:2])  # grey, but for what the film's coding adds
    assert np.abs(pictures[0][80:] - pictures[1][80:]).max() > 20


def test_machine_versions_and_omissions_are_told(result: ReportResult) -> None:
    page = Page(result.page.read_text(encoding="utf-8"))
    for word in ("processor", "cores", "torch", "usd-core", "matplotlib", "Omissions"):
        assert word in page.text
    whats = {item.what: item.reason for item in result.report.omissions}
    assert "no weights of VGG-19" in whats["Embedded features against VGG-19"]
    assert "Other frames" in whats


@pytest.mark.usefixtures("quick_grids")
@pytest.mark.parametrize(
    ("scene", "settings", "left_out"),
    [
        ({"n_frames": 1}, [], {"windows": "one frame"}),
        ({"moving": False}, [], {"windows": "no velocity"}),
        (
            {"n_frames": 1},
            ["optimize.steps=[colour]"],
            {"iterations_shape": "no shape"},
        ),
        (
            {"n_frames": 1},
            ["optimize.steps=[shape]"],
            {"iterations_colour": "no colour", "network": "no colour"},
        ),
        ({"n_frames": 1}, ["losses.style=0"], {"views": "style is 0", "octaves": "style is 0"}),
    ],
)
def test_sweeps_without_use_say_why(
    scene: dict[str, int], settings: list[str], left_out: dict[str, str], tmp_path: Path
) -> None:
    case = case_of(make_scene(tmp_path, **scene), *settings)
    reasons = {sweep.name: sweep.applies(case) for sweep in SWEEPS}
    for name, reason in left_out.items():
        assert reason in reasons[name]
    assert reasons["files"] == ""


@pytest.mark.usefixtures("quick_grids")
def test_estimated_motion_serves_as_a_velocity(tmp_path: Path) -> None:
    windows = next(sweep for sweep in SWEEPS if sweep.name == "windows")
    scene = make_scene(tmp_path, n_frames=2, moving=False)
    colourful(scene.style)
    # occlusion is steadier than the floor
    case = case_of(scene, "stage.motion=estimate", "colour.occlusion=0")
    assert windows.applies(case) == ""
    plan = windows.plan(case)
    task = next(task for task in plan.tasks if task.configured)
    assert 0 < task.error(task.work(0)) < 2


@pytest.mark.usefixtures("quick_grids")
def test_starts_from_noise_the_neighbour_and_a_network_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one_pass = next(sweep for sweep in SWEEPS if sweep.name == "one_pass")
    case = case_of(make_scene(tmp_path, n_frames=3), "optimize.start=network")
    assert one_pass.applies(case) == ""
    monkeypatch.setattr("usdsmoke.work_precision.one_pass.N_ITERATIONS", 20)
    errors = {
        task.label: task.error(task.work(0))
        for task in one_pass.plan(case).tasks
        if task.curve != "noise"
    }
    assert {"network", "network + 32"} < errors.keys()
    assert any(label.startswith("neighbour") for label in errors)
    assert 0 < errors["network + 32"] <= errors["network"] < 1


@pytest.mark.usefixtures("quick_grids")
def test_with_its_weights_vgg19_stands_beside_the_embedded_features(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_vgg19(tmp_path / "random.pth")
    monkeypatch.setenv("USDSMOKE_VGG19", str(tmp_path / "random.pth"))
    network = shortened(next(sweep for sweep in SWEEPS if sweep.name == "network"))
    scene = make_scene(tmp_path, n_frames=1)
    result = make_report(scene.stage, scene.style, scene.output, settings=QUICK, sweeps=[network])
    (found,) = result.report.sweeps
    assert set(found.curves) == {"embedded", "vgg19"}
    assert all(point.error.median > 0 for point in found.points)
    assert [point.configured for point in found.points] == [True, False]


@pytest.mark.usefixtures("quick_grids")
@pytest.mark.parametrize("step", ["shape", "colour"])
def test_unused_views_see_what_more_iterations_gain(step: str, tmp_path: Path) -> None:
    settings = ("losses.keep=0", "shape.learning_rate=0.1", "optics.thicken=1")
    case = case_of(make_scene(tmp_path, n_frames=1), *settings)
    trial, config = Trial(case, step, case.config), untiring(case.config)
    few, many = (trial.unseen.loss(trial.run(Setting((0, n), config), 0)) for n in (1, 40))
    assert many < 0.97 * few


@pytest.mark.usefixtures("quick_grids")
def test_the_small_copy_keeps_mass_and_place(tmp_path: Path) -> None:
    case = case_of(make_scene(tmp_path, n_frames=1, n=12))
    case.longest = 6
    assert case.halvings == 1 and case.small_smoke.voxel_size == pytest.approx(2.0)
    mass = [
        float(s.density.double().sum()) * s.voxel_volume for s in (case.smoke, case.small_smoke)
    ]
    assert mass[1] == pytest.approx(mass[0], rel=1e-6)


@pytest.mark.usefixtures("quick_grids")
def test_a_folder_that_is_a_file_and_a_scene_without_smoke_are_refused(tmp_path: Path) -> None:
    scene = make_scene(tmp_path, n_frames=1)
    taken = tmp_path / "taken"
    taken.write_text("mine")
    with pytest.raises(LayerError, match="taken"):
        make_report(scene.stage, scene.style, taken)
    assert taken.read_text() == "mine"
    write_frame(
        scene.stage.parent / "cache/smoke.0001.vdb",
        [DenseField("density", np.zeros((0, 0, 0), np.float32), (0, 0, 0), np.eye(4))],
        {},
        False,
    )
    with pytest.raises(PlanError, match="holds smoke"):
        make_report(scene.stage, scene.style, scene.output)
    assert not scene.output.exists()


@pytest.mark.usefixtures("quick_grids")
def test_the_command_prints_the_page_and_json_holds_everything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    files = next(sweep for sweep in SWEEPS if sweep.name == "files")
    monkeypatch.setattr(
        make_report, "__defaults__", (*make_report.__defaults__[:-1], (shortened(files),))
    )
    scene = make_scene(tmp_path, n_frames=1)
    words = [str(scene.stage), "--style", str(scene.style), "-o", str(scene.output)]
    words += ["--budget", "60s", *(part for text in QUICK for part in ("--set", text))]
    assert main(["report", *words]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0] == str(scene.output / "report.html")
    assert "  VDB files: precision and pruning: Configured: grids.prune" in out
    assert main(["report", *words, "--json"]) == 0
    held = json.loads(capsys.readouterr().out)
    assert held["page"] == str(scene.output / "report.html")
    assert held["sweeps"][0]["points"][0]["configured"]


def test_a_time_that_is_none_is_wrong_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["report", str(tmp_path / "none.usda"), "-o", str(tmp_path / "out"), "--budget", "soon"]
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 2
    assert "'soon'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_without_matplotlib_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["report", str(tmp_path / "none.usda"), "-o", str(tmp_path / "out")]) == 1
    assert "pip install matplotlib jinja2" in capsys.readouterr().err
