"""Previews around the smoke, and previews that move."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Usd

from tests.fixtures.preview_fixtures import add_camera, look_of_four_frames, pixels
from tests.fixtures.usd_fixtures import file_hashes, make_look, plume_stage
from usdsmoke.base.errors import ConfigError
from usdsmoke.core.smoke.tasks import n_sharing
from usdsmoke.pictures.preview import preview

pytestmark = pytest.mark.usefixtures("quick_grids")


@pytest.fixture
def look(tmp_path: Path) -> Path:
    """The root layer of a look of four frames; its smoke is a box of 4 x 3 x 2 voxels."""
    return look_of_four_frames(tmp_path)


def animation(file_path: Path) -> tuple[list[np.ndarray], list[int]]:
    """The pictures in [0, 1] and their durations in milliseconds."""
    pictures, durations = [], []
    with Image.open(file_path) as image:
        for number in range(image.n_frames):
            image.seek(number)
            pictures.append(np.asarray(image.convert("RGB")).astype(np.float32) / 255)
            durations.append(int(image.info["duration"]))
    return pictures, durations


def width_of_smoke(picture: np.ndarray) -> int:
    """Columns that are lighter than the background."""
    return int((picture.max(axis=(0, 2)) > 0.4).sum())


def test_a_turn_shows_the_middle_frame_from_angles_around_the_up_axis(
    look: Path, tmp_path: Path
) -> None:
    result = preview(look, tmp_path / "turn.webp", turntable=4, size=(80, 60))
    assert result.time_codes == (3,) and result.angles == (0, 90, 180, 270)
    pictures, durations = animation(tmp_path / "turn.webp")
    assert durations == [1000] * 4  # a turn takes four seconds
    assert [picture.shape for picture in pictures] == [(60, 80, 3)] * 4
    front, side, back, other = map(width_of_smoke, pictures)
    assert front / side == pytest.approx(4 / 3, rel=0.15)  # one scale; the box is 4 x 3 x 2
    assert front == pytest.approx(back, abs=2) and side == pytest.approx(other, abs=2)


def test_frames_that_a_look_leaves_out_are_shown_only_if_they_are_named(tmp_path: Path) -> None:
    """A look of frames 1 and 2 of four: the others are grey."""
    stage, output = plume_stage(tmp_path / "in", (1, 2, 3, 4)), tmp_path / "out"
    output.mkdir()
    look = Path(make_look(stage, output, frames="1-2", empty=True).root_stage)
    file = tmp_path / "a.png"
    assert preview(look, file, width=16).time_codes == (1, 2)
    for name in ("a.png", "a.webp"):
        assert preview(look, tmp_path / name, turntable=4, width=16).time_codes in ((1,), (2,))
    assert preview(look, file, width=16).notes == ()
    moving = preview(look, tmp_path / "a.webp", width=16)
    assert moving.time_codes == (1, 2, 3, 4) and "grey at timeCodes 3,4:" in moving.notes[0]
    named = preview(look, file, frames="3", width=16)
    assert named.time_codes == (3,) and "grey at timeCode 3:" in named.notes[0]
    source = preview(stage, file, width=16)
    assert source.time_codes == (1, 3, 4) and source.notes == ()  # no look at all


def test_a_turn_as_png_is_a_sheet(look: Path, tmp_path: Path) -> None:
    preview(look, tmp_path / "turn.png", turntable=8, frames="2", size=(60, 40))
    rows, columns = pixels(tmp_path / "turn.png").shape[:2]
    assert rows > 2 * 40 and columns > 6 * 60  # eight pictures, six in a row


def test_an_animation_has_all_frames_at_the_stages_rate(look: Path, tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(look))
    rate = stage.GetTimeCodesPerSecond()
    for level in (0.2, 0.4, 0.8, 1.6):  # equal pictures would be stored as one
        extinction = stage.GetPrimAtPath("/World/smoke").GetAttribute(
            "usdSmoke:extinctionPerDensity"
        )
        extinction.Set(level, len(extinction.GetTimeSamples()) + 1)
    result = preview(stage, tmp_path / "shot.webp", size=(60, 40))
    assert result.time_codes == (1, 2, 3, 4) and result.files == (tmp_path / "shot.webp",)
    pictures, durations = animation(tmp_path / "shot.webp")
    assert sum(durations) == pytest.approx(4000 / rate, abs=1)
    assert max(durations) - min(durations) <= 1
    means = [float(picture.mean()) for picture in pictures]
    assert means == sorted(means, reverse=True) and len(set(means)) == 4  # thicker is darker
    preview(stage, tmp_path / "few.webp", size=(60, 40), frames="1,2,4")
    shares = np.array(animation(tmp_path / "few.webp")[1]) * rate / 1000
    assert shares == pytest.approx([1, 2, 2], abs=0.05)


def test_a_comparison_that_moves_shows_the_original_at_the_left(look: Path, tmp_path: Path) -> None:
    preview(look, tmp_path / "a.webp", size=(60, 40), compare=True, turntable=2)
    preview(look, tmp_path / "b.webp", size=(60, 40), turntable=2)
    both, alone = (animation(tmp_path / name)[0] for name in ("a.webp", "b.webp"))
    assert both[0].shape == (40, 120, 3)
    assert np.abs(both[0][:, 60:] - alone[0]).mean() < 0.02
    assert np.abs(both[0][:, :60] - alone[0]).mean() > 0.02


@pytest.mark.parametrize("count", [1, 2])
def test_threads_are_those_asked_for_and_afterwards_as_before(
    count: int, look: Path, tmp_path: Path
) -> None:
    seen: list[int] = []
    before = n_sharing()
    preview(
        look, tmp_path / f"{count}.png", frames="2", width=16, threads=count,
        progress=lambda done, total: seen.append(n_sharing()),
    )  # fmt: skip
    assert set(seen) == {count} and n_sharing() == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"turntable": 1}, "--turntable is 1"),
        ({"turntable": 4, "frames": "1-2"}, "selects 2"),
        ({"turntable": 4, "output": "a.exr"}, r"\.exr"),
        ({"turntable": 4, "camera": "/cameras/side"}, "--turntable and --camera"),
        ({"threads": 0}, "--threads is 0"),
        ({"output": "a.webp", "frames": "1", "background": "none"}, "an animation.*transparent"),
        ({"output": "a.webp", "size": (4000, 4000), "turntable": 9}, "9 pictures of 4000 x 4000"),
    ],
)
def test_what_cannot_turn_or_move_is_refused_and_nothing_written(
    options: dict[str, object], message: str, look: Path, tmp_path: Path
) -> None:
    stage = add_camera(look, "/cameras/side", (0.0, -50.0, 0.0))
    before = file_hashes(tmp_path)
    words = {"output": "a.png", **options}
    words["output"] = tmp_path / str(words["output"])
    with pytest.raises(ConfigError, match=message):
        preview(stage, **words)  # type: ignore[arg-type]
    assert file_hashes(tmp_path) == before
