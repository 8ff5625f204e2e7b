"""Smoke with holes in it, the options that clients want, and what they have to give."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdVol

from tests.grids_fixtures import make_field, openvdb, raw_grid, write_raw
from tests.pipeline_fixtures import FakeCore, Shot, make_shot

__all__ = [
    "ALL",
    "CD",
    "COLOR",
    "GAMMA_W",
    "PARTS",
    "PER_DENSITY",
    "SPLIT",
    "VECTORS",
    "WINDOWS",
    "dense",
    "expected",
    "fields_of",
    "make_plume",
    "plume",
]

GAMMA_W = 2.0  # of the stand-in for the core
CD, COLOR = "layer.scatter_colour=Cd", "layer.scatter_colour=[Cd,color]"
SPLIT, PER_DENSITY = "layer.split_rgb=true", "layer.emission_mode=perDensity"
ALL = (COLOR, SPLIT, PER_DENSITY)
WINDOWS = ("windows.size=3", "windows.overlap=2")
VECTORS = ("emission", "Cd", "color")
PARTS = tuple(f"{name}_{part}" for name in VECTORS for part in "rgb")


@pytest.fixture
def plume(tmp_path: Path, core: FakeCore) -> Shot:
    """``make_plume``, stylized by the stand-in for the core."""
    return make_plume(tmp_path)


def make_plume(folder: Path) -> Shot:
    """Seven frames of different smoke with holes in it, off the origin."""
    shot = make_shot(folder / "shot", n_frames=7)
    for code in range(1, 8):
        values = make_field(seed=code).values * np.float32(3)
        values[:, 0] = 0  # the box begins elsewhere
        write_raw(shot.folder / f"in/cache/smoke.{code:04d}.vdb", raw_grid(values, ijk=(-3, 2, 7)))
    return shot


def dense(file_path: str | Path) -> dict[str, np.ndarray]:
    """Every grid in one common box, by OpenVDB alone."""
    grids, _ = openvdb().readAll(str(file_path))
    arrays = {}
    for grid in grids:
        is_vector = isinstance(grid.background, tuple)
        arrays[grid.name] = np.zeros((8, 8, 8, 3) if is_vector else (8, 8, 8), np.float32)
        grid.copyToArray(arrays[grid.name], ijk=(-4, 1, 6))
    assert len(arrays) == len(grids)
    return arrays


def divided(emission: np.ndarray, density: np.ndarray) -> np.ndarray:
    """emission / density, 0 where there is no smoke, as doubles."""
    smoke = (density > 0)[..., None]
    return np.where(smoke, emission.astype(float) / np.where(smoke, density[..., None], 1), 0)


def expected(plain: dict[str, np.ndarray], settings: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The grids of a file by closed form, from the one without any option."""
    found = dict(plain)
    ratio = divided(plain["emission"], plain["density"])
    if PER_DENSITY in settings:
        found["emission"] = ratio.astype(np.float32)
    for name in VECTORS[1:]:
        if (name == "Cd" and CD in settings) or COLOR in settings:
            found[name] = np.minimum(ratio / GAMMA_W, 1).astype(np.float32)
    if SPLIT in settings:
        for name in [name for name in VECTORS if name in found]:
            found |= {f"{name}_{part}": found[name][..., n] for n, part in enumerate("rgb")}
    return found


def fields_of(stage: Usd.Stage) -> dict[str, Usd.Prim]:
    paths = UsdVol.Volume(stage.GetPrimAtPath("/World/smoke")).GetFieldPaths()
    return {str(name): stage.GetPrimAtPath(path) for name, path in paths.items()}
