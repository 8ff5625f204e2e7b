"""The shared coarse step: a whole shot at a fraction of its resolution, frame after frame.

It fixes the places of the style once for all windows, which then refine it independently. Its
voxels are blocks of 2 x 2 x 2 (with three octaves, two of them shared, which are the defaults), so
a frame costs an eighth of the voxels and a quarter of the pixels.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np

from usdsmoke.base.frame_report import ProgressCallback
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.controls import coarse_factor, fine_octaves, without_network
from usdsmoke.core.sequence.frame_loop import run_frames
from usdsmoke.core.sequence.frame_state import (
    OpenedFrame,
    WindowContext,
    make_context,
    open_frame,
)
from usdsmoke.core.sequence.start import Carried, CoarseStart, on_device
from usdsmoke.core.views.scene import Scene


def coarse_frames(
    frames: Iterable[VolumeFrame],
    styles: Sequence[np.ndarray],
    scene: Scene,
    config: Config,
    progress: ProgressCallback | None = None,
    time_codes_per_second: float = 24.0,
    known: Carried | None = None,
) -> Iterator[CoarseStart]:
    """The shared start of every frame of a shot, in order; arguments as of ``stylize_window``.

    Where frames start from a network, the coarse step is that of the shape step alone.

    Frames that are left out (empty ones) have an empty start. A frame's own controls apply here as
    they do in the windows.

    Args:
        known: the ``carried`` of one of these frames, the first that takes effect, from an earlier
            call: it is not optimised again, and the frames after it continue from it.

    Raises:
        NonFiniteError, FeatureError, ConfigError: see ``stylize_window``.
    """
    factor = coarse_factor(config)
    if scene.misfit:
        config = without_network(config)
    elif config.optimize.start:  # frames do not take their colours from here
        steps = [step for step in config.optimize.steps if step != "colour"]
        config = config.replace(optimize=config.optimize.replace(steps=steps))
    n_frames = len(frames) if isinstance(frames, Sequence) else 0
    coarse = dataclasses.replace(scene.coarser(factor), is_coarse_step=True)
    context = make_context(
        styles, coarse, _coarse_config(config), progress, time_codes_per_second, None,
        n_frames,
    )  # fmt: skip
    known = on_device(known, context.device)
    context = dataclasses.replace(context, known=known)
    for frame in run_frames(frames, context, partial(_open_coarse, factor)):
        time_code = frame.time_code
        if frame.left_out:
            yield CoarseStart(time_code, factor)
            continue
        yield CoarseStart(
            time_code, factor, frame.unclamped, frame.painted, frame.colours, frame.checkpoint
        )  # fmt: skip


def coarsen_field(field: DenseField, factor: int) -> DenseField:
    """Block means of a scalar field, blocks aligned to absolute indices; thin axes are left alone.

    Args:
        field: [i j k].
        factor: voxels along a block's edge.
    """
    if factor == 1 or field.is_empty:
        return field
    shape = np.array(field.values.shape)
    scale = np.where(shape > 1, factor, 1)
    low = np.floor_divide(field.ijk_min, scale)
    before = np.asarray(field.ijk_min) - low * scale
    after = -(before + shape) % scale
    padded = np.pad(
        field.values, list(zip(before, after, strict=True)), constant_values=field.background
    )
    blocks = np.array(padded.shape) // scale
    cut = [int(n) for pair in zip(blocks, scale, strict=True) for n in pair]
    values = padded.reshape(cut).mean(axis=(1, 3, 5), dtype=np.float64).astype(np.float32)
    block_to_index = np.diag([*scale, 1.0]).astype(float)
    block_to_index[3, :3] = (scale - 1) / 2
    return dataclasses.replace(
        field,
        values=values,
        ijk_min=(int(low[0]), int(low[1]), int(low[2])),
        index_to_world=block_to_index @ field.index_to_world,
    )


def _open_coarse(factor: int, frame: VolumeFrame, context: WindowContext) -> OpenedFrame:
    """The frame's record with everything that is optimised on ``factor`` times larger voxels."""
    fine = open_frame(frame, context)
    if fine.left_out:
        return fine
    coarse = dataclasses.replace(frame, density=coarsen_field(fine.density, factor))
    # it is refined and thickened already
    config = context.config.replace(grids=context.config.grids.replace(refine=1))
    scene = context.scene.without_thickening()
    return open_frame(coarse, dataclasses.replace(context, config=config, scene=scene))


def _coarse_config(config: Config) -> Config:
    """Only the octaves that are as coarse as the coarse voxels, or coarser; without a network.

    ``windows.steadiness`` counts changes in the shot's pixels, not in the coarse ones: what changes
    here from frame to frame, windows pass on (decision 053).
    """
    n_fine, factor = fine_octaves(config), coarse_factor(config)
    shape, colour, windows = config.shape, config.colour, config.windows
    return config.replace(
        shape=shape.replace(iterations=shape.iterations[: -n_fine or None]),
        colour=colour.replace(iterations=colour.iterations[: -n_fine or None]),
        windows=windows.replace(steadiness=windows.steadiness * factor**2),
        optimize=config.optimize.replace(start=""),
    )
