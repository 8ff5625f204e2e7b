"""The contact sheets of a run: which pictures, of what size, drawn from what, and when none."""

import sys
import weakref
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot, run
from usdsmoke.base.errors import ImageError
from usdsmoke.core.views import lighting
from usdsmoke.pictures import compose_sheet
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.vdb.read import read_grids


class Drawn:
    """Every view that is drawn, with the smoke in it, and which fields are held meanwhile."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.views: list[Any] = []
        self.opacity: list[float] = []
        self.light: list[float] = []
        self.held: list[tuple[str, ...]] = []
        self.sizes: set[tuple[int, ...]] = set()  # of the pictures on the sheet
        self._given: list[tuple[str, weakref.ref[Any]]] = []
        monkeypatch.setattr(sys.modules["usdsmoke.core.rays.march"], "march", self._march)
        read = FrameReader.read

        def read_source(reader: FrameReader, *arguments: Any) -> Any:
            found = read(reader, *arguments)
            self._given.append(("source", weakref.ref(found.density)))
            return found

        def read_result(*arguments: Any) -> Any:
            found = read_grids(*arguments)
            self._given += [("result", weakref.ref(field)) for field in found]
            return found

        def compose(title: str, rows: Any, styles: Any) -> Any:
            self.sizes |= {picture.shape[:2] for row in rows for _, picture in row}
            return compose_sheet(title, rows, styles)

        monkeypatch.setattr("usdsmoke.runs.sheet.compose_sheet", compose)
        monkeypatch.setattr(FrameReader, "read", read_source)
        monkeypatch.setattr("usdsmoke.runs.sheet.read_grids", read_result)

    def _march(self, media: Any, view: Any) -> Any:
        self.views.append(view)
        self.opacity.append(float(media[0].extinction.max()))
        emission = media[0].emission
        self.light.append(0.0 if emission is None else float(emission.sum()))
        self.held.append(tuple(name for name, item in self._given if item() is not None))
        return SimpleNamespace(rgba=np.ones((view.height, view.width, 4), np.float32))

    @property
    def angles(self) -> list[float]:
        return [view.azimuth for view in self.views]


@pytest.fixture
def drawn(core: FakeCore, monkeypatch: pytest.MonkeyPatch) -> Drawn:
    return Drawn(monkeypatch)


def test_four_frames_are_shown_from_the_front_and_a_middle_one_all_round(
    tmp_path: Path, drawn: Drawn
) -> None:
    run(make_shot(tmp_path, n_frames=7))
    # source and result of the first, of two between, the first of them all round, and of the last
    assert drawn.angles == [0, 0, 0, 0, 30, 90, 180, 0, 0, 0, 0]
    values = [0.5 + code / 8 for code in (1, 3, 5, 7)]
    sources = [drawn.opacity[n] for n in (0, 2, 7, 9)]
    assert sources == pytest.approx(values)
    assert len({(view.height, view.width, view.pixel_size) for view in drawn.views}) == 1


def test_what_is_shown_was_written(shot: Shot, drawn: Drawn) -> None:
    """The stand-in halves the density, and doubles its extinction where there is colour."""
    (sheet,) = run(shot).contact_sheets
    assert drawn.opacity[1] == pytest.approx(drawn.opacity[0], rel=0.1)
    pixels = np.asarray(Image.open(sheet).convert("RGB"))
    view = drawn.views[0]
    assert pixels.shape[0] > 3 * view.height and pixels.shape[1] > 4 * view.width
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 100  # the style's ramp is in it


@pytest.mark.parametrize(("height", "expected"), [(512, None), (8, 8)])
def test_pictures_have_the_height_that_is_set_and_at_most_four_pixels_a_voxel(
    height: int, expected: int | None, shot: Shot, drawn: Drawn
) -> None:
    (sheet,) = run(shot, f"layer.contact_sheet={height}").contact_sheets
    view = drawn.views[0]
    # a voxel is half a stage unit; 1.5 pixels of it are drawn at most, and enlarged
    assert view.pixel_size >= 0.5 / 1.5 * 0.9
    (made,) = drawn.sizes
    assert made[0] == (expected or pytest.approx(4 / 1.5 * view.height, abs=3))
    with Image.open(sheet) as image:
        assert image.height > 3 * made[0]


def test_only_one_frames_fields_are_held_at_a_time(shot: Shot, drawn: Drawn) -> None:
    run(shot)
    assert len(drawn.held) == 9
    assert all(held in (("source",), ("result", "result"), ()) for held in drawn.held)


def test_smoke_without_a_third_dimension_has_no_turn(tmp_path: Path, drawn: Drawn) -> None:
    shot = make_shot(tmp_path, n_frames=1)
    flat = raw_grid(np.ones((6, 5, 1)))
    write_raw(shot.stage.parent / "cache/smoke.0001.vdb", flat)
    run(shot)
    assert drawn.angles == [0, 0]


def test_smoke_in_light_is_exposed(
    tmp_path: Path, drawn: Drawn, core: FakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both what it emits and what it scatters; the source glows all the same."""
    monkeypatch.setitem(sys.modules, lighting.__name__, lighting)  # the real one
    shot, light = make_shot(tmp_path, n_frames=1), []
    for number, (stops, albedo) in enumerate([(0, 0), (0, 0.8), (3, 0.8)]):
        core.scene = replace(core.scene, stops=float(stops))
        here = replace(shot, output=tmp_path / str(number))
        run(here, "optics.sky=[1,1,1]", f"optics.albedo={albedo}")
        light.append(drawn.light[:2])  # of the source and of the result, from the front
        drawn.light.clear()
    (source, emitted), (source_in_light, lit), (source_exposed, exposed) = light
    assert source == source_in_light == source_exposed
    assert lit > 1.01 * emitted
    assert exposed == pytest.approx(8 * lit, rel=1e-4)


def test_no_sheet_is_drawn_where_its_height_is_0(shot: Shot, drawn: Drawn) -> None:
    result = run(shot, "layer.contact_sheet=0")
    assert result.contact_sheets == () and not list(shot.output.glob("*.png"))
    assert drawn.views == []
    assert any(
        omission.what == "contact sheet" and not omission.expected
        for omission in result.plan.omitted
    )


@pytest.mark.usefixtures("core")
def test_a_contact_sheet_that_fails_is_a_warning(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*arguments: object) -> None:
        raise ImageError("the picture cannot be drawn")

    monkeypatch.setattr("usdsmoke.runs.assemble.write_contact_sheet", fail)
    result = run(shot)
    assert result.contact_sheets == ()
    assert any("the picture cannot be drawn" in warning for warning in result.warnings)
    assert result.root_stage.is_file() and result.look_layer.is_file()
