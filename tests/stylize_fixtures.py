"""Whole runs of the core on a few voxels, in a fraction of a second."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tests.smoke_fixtures import random_style
from usdsmoke.base.frame_report import Progress
from usdsmoke.base.resolve import resolve_config
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import VolumeFrame
from usdsmoke.core.sequence.stylize import StylizedFrame, stylize_window
from usdsmoke.core.views.scene import Scene, measure_scene

__all__ = ["by_voxel", "quick_config", "run_core", "scene_of"]


def quick_config(**sections: Mapping[str, Any]) -> Config:
    """Few iterations, views and features, one thread."""
    base = {
        "views": {"pool": 2, "image_size": 16},
        "features": {"layers": ["oriented1", "oriented2"]},
        "shape": {"iterations": [2, 2]},
        "colour": {"iterations": [2, 2]},
        "optimize": {"threads": 1, "tolerance": 0.0, "error_budget": False},
    }
    return resolve_config(base, sections)


def scene_of(frames: Sequence[VolumeFrame], config: Config, up_axis: str = "Y") -> Scene:
    """The scene measured with the sections of these settings."""
    return measure_scene(frames, config.views, config.optics, up_axis, config.grids.refine)


def run_core(
    frames: Sequence[VolumeFrame],
    config: Config | None = None,
    scene: Scene | None = None,
    styles: Sequence[np.ndarray] | None = None,
    watch: list[Progress] | None = None,
) -> list[StylizedFrame]:
    """One window through the core; the scene is measured on all its frames unless given."""
    config = config or quick_config()
    scene = scene or scene_of(frames, config)
    styles = [random_style()] if styles is None else styles
    tell = watch.append if watch is not None else None
    return list(stylize_window(frames, styles, scene, config, tell))


def by_voxel(field: Any) -> dict[tuple[int, ...], tuple[float, ...]]:
    """What differs from 0, by absolute voxel index."""
    values = field.values if field.values.ndim == 4 else field.values[..., None]
    filled = np.argwhere(values.any(axis=-1))
    index = filled + np.asarray(field.ijk_min)
    return {
        tuple(i): tuple(v)
        for i, v in zip(index.tolist(), values[tuple(filled.T)].tolist(), strict=True)
    }
