"""A stage whose Volume has a mask with field prim, place and file of its own."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.grids_fixtures import raw_grid, uniform, write_raw
from tests.usd_fixtures import density_prim, sequence, volume_prim, world, write_text, write_vdb
from usdsmoke.base.resolve import resolve_config
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.make_plan import make_plan
from usdsmoke.planning.plan import Plan
from usdsmoke.usd.stage import find_volumes, open_stage

PLACED = (
    "double3 xformOp:translate = (5, 0, 0)\n float3 xformOp:scale = (2, 2, 2)\n"
    'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]'
)


def plan_of(stage: Path, *settings: str) -> Plan:
    """The plan of a stage with the mask called fade."""
    config = resolve_config(["stage.mask=fade", *settings])
    return make_plan(find_volumes(open_stage(stage), config.stage), config)


def frames_of(stage: Path, *settings: str) -> list[VolumeFrame]:
    """What the core gets, frame by frame."""
    plan = plan_of(stage, *settings)
    reader, (volume,) = FrameReader(plan), plan.volumes
    return [reader.read(volume, frame) for frame in volume.frames]


def make_stage(
    folder: Path,
    mask_files: str = "asset filePath = @./fade.vdb@",
    grid: str = 'token fieldName = "weight"',
    time_codes: Sequence[float] = (1, 2, 3),
) -> Path:
    """An animated density, and a mask with field prim, place and file of its own."""
    for code in time_codes:
        write_vdb(folder / f"cache/smoke.{code:04d}.vdb", value=code)
    relations = "\n".join(f"rel field:{n} = </World/smoke/{n}>" for n in ("density", "fade"))
    mask = density_prim(mask_files, "fade", PLACED, grid)
    body = volume_prim(density_prim(sequence(time_codes)) + mask, relations=relations)
    return write_text(folder / "shot.usda", world(body))


def write_mask(file_path: Path, value: float = 0.5, name: str = "weight") -> np.ndarray:
    """A mask of 3 x 2 x 2 voxels of size 2 from index -4; what was written."""
    values = np.linspace(0.0, value, 12, dtype=np.float32).reshape(3, 2, 2)
    file_path.parent.mkdir(parents=True, exist_ok=True)
    write_raw(file_path, raw_grid(values, name, (-4, 0, 1), "unknown", uniform(2.0)))
    return values
