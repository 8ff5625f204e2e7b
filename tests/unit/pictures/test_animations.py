"""Animated files: what other readers find in them."""

import importlib
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.fixtures.preview_fixtures import look_of_four_frames
from usdsmoke.base.errors import MissingPackage
from usdsmoke.pictures.animations import WRITERS, write_gif, write_mp4
from usdsmoke.pictures.preview import preview

MILLISECONDS = (42, 41, 42, 125)


def ramps(height: int = 31, width: int = 45) -> list[np.ndarray]:
    """Pictures of smooth colours, each of them brighter than the one before."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    parts = (x / width, y / height, np.ones_like(x))
    return [np.stack(parts, axis=-1) * (0.4 + 0.2 * n) for n in range(len(MILLISECONDS))]


def test_a_gif_repeats_and_keeps_colours_and_times(tmp_path: Path) -> None:
    write_gif(tmp_path / "a.gif", ramps(), MILLISECONDS)
    durations = []
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == len(MILLISECONDS) and image.info["loop"] == 0
        for number, wanted in enumerate(ramps()):
            image.seek(number)
            durations.append(image.info["duration"])
            found = np.asarray(image.convert("RGB")) / 255
            assert np.abs(found - wanted).mean() < 0.03
            assert np.abs(found.mean(axis=(0, 1)) - wanted.mean(axis=(0, 1))).max() < 0.01
    assert sum(durations) == 250 and max(np.abs(np.subtract(durations, MILLISECONDS))) < 10


@pytest.mark.skipif(importlib.util.find_spec("av") is None, reason="PyAV is not installed")
def test_an_mp4_keeps_colours_and_times(tmp_path: Path) -> None:
    av = importlib.import_module("av")
    write_mp4(tmp_path / "a.mp4", ramps(), MILLISECONDS)
    with av.open(str(tmp_path / "a.mp4")) as film:
        frames, stream = list(film.decode(video=0)), film.streams.video[0]
        assert stream.duration * stream.time_base == sum(MILLISECONDS) / 1000
    starts = [round(1000 * frame.time) for frame in frames]
    assert starts == [0, *np.cumsum(MILLISECONDS)[:-1]]
    for frame, wanted in zip(frames, ramps(), strict=True):
        found = frame.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray() / 255
        assert found.shape == (32, 46, 3)  # even sides
        assert np.abs(found[:31, :45] - wanted).mean() < 0.02


def test_without_pyav_an_mp4_is_refused_before_anything_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    look, drawn = look_of_four_frames(tmp_path), list[int]()
    with pytest.raises(MissingPackage, match=r"\bav\b"):
        preview(look, tmp_path / "a.mp4", progress=lambda done, total: drawn.append(done))
    assert not drawn and not (tmp_path / "a.mp4").exists()


@pytest.mark.usefixtures("quick_grids")
@pytest.mark.parametrize("suffix", sorted(WRITERS.keys() - {".mp4"}))
def test_a_turntable_is_drawn_in_every_format(suffix: str, tmp_path: Path) -> None:
    result = preview(
        look_of_four_frames(tmp_path), tmp_path / f"a{suffix}", turntable=3, size=(40, 30)
    )
    with Image.open(result.files[0]) as image:
        assert image.n_frames >= 2 and image.size == (40, 30)  # equal pictures may be joined
