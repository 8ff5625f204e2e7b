"""One window of frames in, the same frames stylized out: shape step, then colour step."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from usdsmoke.config import Config
from usdsmoke.core.colour import run_colour_step
from usdsmoke.core.device import choose_device
from usdsmoke.core.mask import EffectMask, effect_mask
from usdsmoke.core.optimize import Minimum
from usdsmoke.core.progress import Progress, ProgressCallback
from usdsmoke.core.refine import refine_field
from usdsmoke.core.scene import Scene
from usdsmoke.core.schedule import octave_iterations, warm_iterations
from usdsmoke.core.shape import Displaced, run_shape_step
from usdsmoke.core.smoke import ActiveSmoke, activate
from usdsmoke.core.style import decode_srgb
from usdsmoke.core.targets import StyleTargets
from usdsmoke.core.warm import carry_colours
from usdsmoke.errors import NonFiniteError
from usdsmoke.volume import DenseField, VolumeFrame

__all__ = ["StylizedFrame", "stylize_window"]


@dataclass(frozen=True)
class StylizedFrame:
    """One finished frame: what is written, and what it took."""

    time_code: float
    density: DenseField
    emission: DenseField | None  # None without a colour step
    report: dict[str, Any] = field(default_factory=dict)  # plain numbers and texts


@dataclass(frozen=True)
class _Neighbour:
    """What the next frame of a window starts from."""

    time_code: float
    displaced: Displaced | None
    smoke: ActiveSmoke | None
    colours: Tensor | None


@dataclass(frozen=True)
class _Job:
    """What all frames of a window share."""

    targets: StyleTargets
    scene: Scene
    config: Config
    device: torch.device


_Watch = Callable[[str, Sequence[int]], Callable[[int, Minimum], None]]


def stylize_window(
    frames: Iterable[VolumeFrame],
    styles: Sequence[np.ndarray],
    scene: Scene,
    config: Config,
    progress: ProgressCallback | None = None,
    time_codes_per_second: float = 24.0,
) -> Iterator[StylizedFrame]:
    """The stylized frames of one window, one by one: memory is a frame's and not the shot's.

    The first frame starts from noise; each later one starts from its neighbour's result, carried
    along by the velocity, with ``windows.warm_iterations`` of the iterations. Equal inputs and
    settings give equal bits on the same machine; on a GPU sums may differ in their last digits.

    Args:
        frames: ascending time_code; pulled one at a time.
        styles: display-encoded style images [H W 3] in [0, 1].
        scene: see ``scene.measure_scene``; the same for every window of the shot.
        progress: called after every iteration.
        time_codes_per_second: of the stage, for the velocity.

    Raises:
        NonFiniteError: a frame holds NaN or infinity, or the optimisation diverges beyond rescue.
        FeatureError, ConfigError: see ``StyleTargets``.
    """
    device = choose_device(config.optimize)
    job = _Job(StyleTargets(styles, scene, config, device), scene, config, device)
    n_frames = len(frames) if isinstance(frames, Sequence) else 0
    before: _Neighbour | None = None
    for number, frame in enumerate(frames):
        watch = _watcher(progress, frame.time_code, number, n_frames)
        since = frame.time_code - before.time_code if before is not None else 0.0
        seconds = since / time_codes_per_second
        stylized, before = _stylize_frame(frame, before, seconds, job, watch)
        yield stylized


def _watcher(
    progress: ProgressCallback | None, time_code: float, frame: int, n_frames: int
) -> _Watch:
    """Turns the optimiser's states of a step into progress records."""

    def of_step(step: str, iterations: Sequence[int]) -> Callable[[int, Minimum], None]:
        def report(octave: int, state: Minimum) -> None:
            if progress is not None:
                done = sum(iterations[:octave]) + state.iteration
                progress(
                    Progress(
                        step, time_code, frame, n_frames, octave, len(iterations), done,
                        sum(iterations), state.smoothed,
                    )
                )  # fmt: skip

        return report

    return of_step


def _stylize_frame(
    frame: VolumeFrame, before: _Neighbour | None, seconds: float, job: _Job, watch: _Watch
) -> tuple[StylizedFrame, _Neighbour]:
    _check_finite(frame)
    steps = job.config.optimize.steps
    density = refine_field(frame.density, job.config.grids.refine)
    source = smoke = activate(density, frame.density_to_stage, job.device)
    mask = effect_mask(frame)
    report: dict[str, Any] = {"voxels": len(source.ijk)}
    if mask is not None and mask.n_clamped:
        report["warnings"] = [_clamped_text(frame, mask)]
    left_out = _why_left_out(source, mask, job.config)
    if left_out:
        report["left out"] = left_out
        empty = _empty_emission(density) if "colour" in steps else None
        kept = before or _Neighbour(frame.time_code, None, None, None)
        return StylizedFrame(frame.time_code, density, empty, report), kept
    displaced = colours = emission = None
    if "shape" in steps:
        displaced, report["shape"] = _move(
            density, source, mask, frame, before, seconds, job, watch
        )
        density = displaced.density
        smoke = activate(density, frame.density_to_stage, job.device)
    if "colour" in steps:
        share = None if mask is None else mask.at(smoke.positions)
        painted = smoke if share is None else smoke.take(share > 0)
        colours, report["colour"] = _paint(smoke, painted, mask, frame, before, seconds, job, watch)
        strength: float | Tensor = job.config.optimize.strength
        if share is not None:
            strength = strength * share[share > 0]
        emission = _emission_field(density, painted, colours, job.scene, strength)
        smoke = painted
    return (
        StylizedFrame(frame.time_code, density, emission, report),
        _Neighbour(frame.time_code, displaced, smoke, colours),
    )


def _move(
    density: DenseField,
    source: ActiveSmoke,
    mask: EffectMask | None,
    frame: VolumeFrame,
    before: _Neighbour | None,
    seconds: float,
    job: _Job,
    watch: _Watch,
) -> tuple[Displaced, dict[str, Any]]:
    """The shape step of one frame, and its report."""
    started = time.perf_counter()
    start = before.displaced if before is not None else None
    plan = _plan_octaves(job.config.shape.iterations, job.config, start is not None)
    displaced = run_shape_step(
        density, source, frame, start, seconds,
        job.targets, job.scene, job.config, plan, watch("shape", plan), mask,
    )  # fmt: skip
    report = {**displaced.report, "seconds": time.perf_counter() - started}
    return displaced, {**_summarize(report.pop("ends")), **report}


def _paint(
    smoke: ActiveSmoke,
    painted: ActiveSmoke,
    mask: EffectMask | None,
    frame: VolumeFrame,
    before: _Neighbour | None,
    seconds: float,
    job: _Job,
    watch: _Watch,
) -> tuple[Tensor, dict[str, Any]]:
    """The colour step of one frame: the painted voxels' encoded colours [N 3], and its report."""
    started = time.perf_counter()
    config, start = job.config, None
    if before is not None and before.smoke is not None and before.colours is not None:
        if len(before.smoke.ijk) and len(painted.ijk):
            start = carry_colours(
                before.smoke, before.colours, frame, painted, seconds, config.optimize.seed
            )
    plan = _plan_octaves(config.colour.iterations, config, start is not None)
    colours, ends = run_colour_step(
        smoke, start, job.targets, job.scene, config, plan, watch("colour", plan), mask
    )
    return colours, {**_summarize(ends), "seconds": time.perf_counter() - started}


def _why_left_out(source: ActiveSmoke, mask: EffectMask | None, config: Config) -> str:
    """Why there is nothing to do for a frame; "" when there is."""
    if len(source.ijk) == 0:
        return "empty frame"
    if mask is not None and not bool(mask.at(source.positions).any()):
        return "the mask is 0 wherever there is smoke"
    if config.optimize.strength == 0:
        return "optimize.strength is 0"
    return "losses.style is 0" if config.losses.style == 0 else ""


def _plan_octaves(per_octave: Sequence[int], config: Config, warm: bool) -> list[int]:
    plan = octave_iterations(per_octave, config.optimize.iterations)
    return warm_iterations(plan, config.windows.warm_iterations) if warm else plan


def _summarize(ends: Sequence[Minimum]) -> dict[str, Any]:
    """How the octaves of a step ended, as plain values."""
    return {
        "loss": [end.smoothed for end in ends],
        "iterations": [end.iteration + 1 for end in ends],
        "rollbacks": sum(end.rollbacks for end in ends),
        "restored": sum(end.restored for end in ends),
        "ended": [end.reason for end in ends],
    }


def _check_finite(frame: VolumeFrame) -> None:
    for item in (frame.density, frame.velocity, frame.mask):
        if item is None:
            continue
        count = sum(int((~np.isfinite(part)).sum()) for part in (item.values, item.background))
        if count:
            raise NonFiniteError(
                f'{count} values of grid "{item.name}" at timeCode {frame.time_code:g} are NaN or '
                "infinite; set grids.repair_nan to the value that shall replace them"
            )


def _clamped_text(frame: VolumeFrame, mask: EffectMask) -> str:
    name = frame.mask.name if frame.mask is not None else ""
    return (
        f'{mask.n_clamped} values of the mask "{name}" at timeCode {frame.time_code:g} are not '
        "between 0 and 1 and were clamped"
    )


def _empty_emission(density: DenseField) -> DenseField:
    values = np.zeros((*density.values.shape, 3), np.float32)
    return DenseField(
        "emission",
        values,
        density.ijk_min,
        density.index_to_world,
        (0.0, 0.0, 0.0),
        "unknown",
        density.half,
    )


def _emission_field(
    density: DenseField,
    smoke: ActiveSmoke,
    colours: Tensor,
    scene: Scene,
    strength: float | Tensor,
) -> DenseField:
    """C x sigma in 1/stage unit, scene-linear, zero where there is no painted smoke.

    So the guidance mask is applied once more to the result, as the paper asks for: whatever the
    network saw beyond the smoke, nothing is left of it. ``strength`` may be one number a voxel.
    """
    emission = _empty_emission(density)
    light = decode_srgb(colours) * (scene.gamma_w * strength * smoke.density)[:, None]
    index = smoke.ijk.cpu().numpy() - np.asarray(density.ijk_min)
    emission.values[tuple(index.T)] = light.cpu().numpy()
    return emission
