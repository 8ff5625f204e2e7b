"""Looks of a shot that a reference slows down or speeds up."""

from pathlib import Path

import numpy as np
import pytest

from tests.fixtures.grids_fixtures import raw_grid, uniform, write_raw
from tests.fixtures.pipeline_fixtures import make_shot, values_of
from tests.fixtures.smoke_fixtures import puff
from tests.fixtures.usd_fixtures import density_prim, sampled, volume_prim, world, write_text
from usdsmoke.pipeline import StylizeResult, stylize

STEP, SIZE = 2, 0.5  # voxels that the smoke moves by from file to file; edge of a voxel
SETTINGS = (
    "shape.iterations=[2,3]", "colour.iterations=[2,3]", "optimize.error_budget=false",
    "layer.contact_sheet=0", "layer.copy_velocity=true", "views.image_size=32",
)  # fmt: skip
HEADER = '#usda 1.0\n(\n    defaultPrim = "World"\n    timeCodesPerSecond = 24\n)\n'


def stylized(folder: Path, scale: float) -> StylizeResult:
    """Two files of moving smoke, a frame of 1/24 second apart, behind a reference."""
    style = make_shot(folder).style
    velocity = np.zeros((20, 14, 14, 3), np.float32)
    velocity[..., 0] = STEP * SIZE * 24
    for number in (1, 2):
        density = np.pad(puff(12), ((STEP * number, 8 - STEP * number), (1, 1), (1, 1)))
        write_raw(
            folder / f"s.{number}.vdb",
            raw_grid(density, matrix=uniform(SIZE)),
            raw_grid(velocity, name="vel", matrix=uniform(SIZE)),
        )
    body = world(volume_prim(density_prim(
        sampled("asset filePath", {1: "@./s.1.vdb@", 2: "@./s.2.vdb@"})
    )))  # fmt: skip
    write_text(folder / "asset.usda", HEADER + body[body.index("def ") :])
    reference = f"(prepend references = @./asset.usda@ (scale = {scale}))"
    stage = write_text(folder / "s.usda", f'{HEADER}def "World" {reference}\n{{\n}}\n')
    return stylize(stage, style, folder / "out", settings=SETTINGS)


@pytest.mark.parametrize("scale", [2.0, 0.5])
def test_a_retimed_reference_has_the_look_of_the_shot_at_its_own_speed(
    tmp_path: Path, scale: float
) -> None:
    """The pattern goes with the smoke, bit by bit: factors of 2 round nothing."""
    usual, retimed = (stylized(tmp_path / f"{s}", s) for s in (1.0, scale))
    assert len(usual.frames) == len(retimed.frames) == 2
    for one, other in zip(usual.frames, retimed.frames, strict=True):
        for name in ("density", "emission"):
            np.testing.assert_array_equal(values_of(one, name), values_of(other, name))
        wanted = values_of(one, "vel") / scale
        np.testing.assert_allclose(values_of(other, "vel"), wanted)
    assert retimed.temporal_error == usual.temporal_error
