"""A request that changes over time, through the real core: the effect grows as it says."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import make_style
from tests.fixtures.usd_fixtures import density_prim, sequence, world, write_text
from usdsmoke import pipeline, provenance
from usdsmoke.base.errors import OutputExists
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.pipeline import Request, run_window, stylize
from usdsmoke.vdb.read import GridRequest, read_grids

CODES, SHAPE = range(1, 9), (12, 10, 14)
SETTINGS = {
    "optimize": {"iterations": 6, "threads": 1, "tolerance": 0},
    "views": {"image_size": 32, "pool": 2},
}


def ball() -> np.ndarray:
    """Smoke that thins out towards its border, 12 x 10 x 14 voxels."""
    axes = [np.linspace(-1, 1, n) for n in SHAPE]
    place = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return np.clip(1 - (place**2).sum(-1), 0, 1)


def whole_box(file_path: str | Path, name: str) -> np.ndarray:
    """A grid's voxels in the ball's box, whatever of them is active."""
    (field,) = read_grids(file_path, [GridRequest(name)], GridsConfig())
    whole = np.zeros((*SHAPE, *field.values.shape[3:]), np.float32)
    place = tuple(
        slice(low, low + n) for low, n in zip(field.ijk_min, field.values.shape, strict=False)
    )
    whole[place] = field.values
    return whole


@pytest.mark.usefixtures("quick_grids")
def test_a_strength_from_0_to_1_shows_the_source_first_and_more_in_every_frame(
    tmp_path: Path,
) -> None:
    """Every frame is the same ball: what differs between frames is the effect."""
    (tmp_path / "cache").mkdir()
    for code in CODES:
        write_raw(tmp_path / f"cache/smoke.{code:04d}.vdb", raw_grid(ball()))
    make_style(tmp_path / "style.png")
    body = f"""
    def Volume "smoke" (prepend apiSchemas = ["UsdSmokeStyleAPI"])
    {{
        asset[] usdSmoke:request:styleImages = [@./style.png@]
        double usdSmoke:request:strength.timeSamples = {{ 1: 0, 8: 1 }}
        rel field:density = </World/smoke/density>
        {density_prim(sequence(CODES))}
    }}
"""
    stage = write_text(tmp_path / "shot.usda", world(body))
    result = stylize(stage, None, tmp_path / "out", resolve_config(SETTINGS))
    source = whole_box(tmp_path / "cache/smoke.0001.vdb", "density")
    densities = [whole_box(frame, "density") for frame in result.frames]
    colours = [whole_box(frame, "emission") for frame in result.frames]
    np.testing.assert_array_equal(densities[0], source)
    moved = [float(np.abs(density - source).sum() / source.sum()) for density in densities]
    painted = [float(np.ptp(colour, axis=-1).sum() / source.sum()) for colour in colours]
    for effect in (moved, painted):
        assert effect == sorted(effect)
        assert effect[-1] > 0.01


@pytest.mark.usefixtures("quick_grids")
def test_a_style_that_fades_in_counts_for_the_size_of_the_styles(tmp_path: Path) -> None:
    (tmp_path / "cache").mkdir()
    for code in (1, 2):
        write_raw(tmp_path / f"cache/smoke.{code:04d}.vdb", raw_grid(ball()))
    for name, wavelength in (("fine", 16), ("wide", 64)):  # 2 and 8 voxels
        light = 128 + 127 * np.sin(2 * np.pi / wavelength * np.arange(112))
        pixels = np.broadcast_to(light[:, None, None].astype(np.uint8), (112, 112, 3))
        Image.fromarray(pixels).save(tmp_path / f"{name}.png")
    body = f"""
    def Volume "smoke" (prepend apiSchemas = ["UsdSmokeStyleAPI"])
    {{
        asset[] usdSmoke:request:styleImages = [@./fine.png@, @./wide.png@]
        double[] usdSmoke:request:styleWeights.timeSamples = {{ 1: [1, 0], 2: [0, 1] }}
        rel field:density = </World/smoke/density>
        {density_prim(sequence((1, 2)))}
    }}
"""
    stage = write_text(tmp_path / "shot.usda", world(body))

    def size(name: str, **selected: str) -> float:
        settings = resolve_config({**SETTINGS, "stage": selected})
        (found,) = provenance(stylize(stage, None, tmp_path / name, settings).look_layer)
        return found.record.style_sizes["/World/smoke"]

    assert size("fine", frames="1") > size("both") == size("wide", frames="2") == 1


def test_each_volume_is_seen_through_the_camera_it_asks_for(tmp_path: Path) -> None:
    (tmp_path / "cache").mkdir()
    write_raw(tmp_path / "cache/smoke.0001.vdb", raw_grid(ball()))
    volumes = "".join(
        f"""
    def Volume "{name}" (prepend apiSchemas = ["UsdSmokeStyleAPI"])
    {{
        {camera}
        rel field:density = </World/{name}/density>
        {density_prim(sequence([1]))}
    }}
    def Camera "{name}_camera"
    {{
        double3 xformOp:translate = (0, 0, 100)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
"""
        for name, camera in (
            ("near", "rel usdSmoke:request:camera = </World/near_camera>"),
            ("far", "rel usdSmoke:request:camera = </World/far_camera>"),
            ("free", ""),
        )
    )
    stage = write_text(tmp_path / "shot.usda", world(volumes))
    style = make_style(tmp_path / "style.png")

    def cameras(**settings: str) -> list[str]:
        plan = pipeline.plan_request(Request(stage, style, tmp_path / "out", {"views": settings}))
        sources = [volume.frames[0].source.camera for volume in plan.volumes]
        return [source.prim_path if source else "" for source in sources]

    assert cameras() == ["/World/near_camera", "/World/far_camera", ""]
    assert cameras(camera="/World/free_camera") == ["/World/free_camera"] * 3
    assert cameras(camera="") == [""] * 3


@pytest.mark.usefixtures("core")
def test_another_sample_is_another_run_and_named_by_its_timecode(tmp_path: Path) -> None:
    (tmp_path / "cache").mkdir()
    for code in (1, 2):
        write_raw(tmp_path / f"cache/smoke.{code:04d}.vdb", raw_grid(ball()))
    body = f"""
    def Volume "smoke" (prepend apiSchemas = ["UsdSmokeStyleAPI"])
    {{
        double usdSmoke:request:gamma.timeSamples = {{ 1: 0.5, 2: 0.75 }}
        rel field:density = </World/smoke/density>
        {density_prim(sequence((1, 2)))}
    }}
"""
    stage, style = write_text(tmp_path / "s.usda", world(body)), make_style(tmp_path / "s.png")
    run_window(Request(stage, style, tmp_path / "out"), 0)
    write_text(stage, stage.read_text().replace("0.75", "0.875"))
    with pytest.raises(
        OutputExists,
        match=r"request of </World/smoke> for samples\.optics\.gamma\.2 was 0\.75, now 0\.875",
    ):
        run_window(Request(stage, style, tmp_path / "out"), 0)
