"""Sweeps over the window size: temporal error and style against time."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from usdsmoke.base.boxes import union_box, values_in_box
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.engine import Sweep
from usdsmoke.work_precision.film import Fields, draw_film
from usdsmoke.work_precision.records import Plan, Task
from usdsmoke.work_precision.trial import (
    EXCESS,
    N_RUNS,
    Reference,
    base_iterations,
    copy_text,
    main_step,
    need_seconds,
    reference_of,
    reference_seconds,
    trial_seconds,
)
from usdsmoke.work_precision.unseen_loss import Outcome

if TYPE_CHECKING:
    from torch import Tensor

    from usdsmoke.core.sequence.stylize import StylizedFrame
    from usdsmoke.core.sequence.transit import Transit
    from usdsmoke.core.smoke.active import ActiveSmoke

_NO_MOTION = "the Volume has no velocity: nothing is carried from frame to frame"
_ONE_FRAME = "one frame: nothing is carried from frame to frame"
_LEAST_FRAMES, _FEW_FRAMES = 3, 4
_CARRYING = 1.2  # assumed: times the iterations' cost, as a warm frame also moves its neighbour's
_TEXTS = {
    "temporal": (
        "temporal error (mean over neighbouring frames)",
        "0, a pattern that moves exactly with the smoke; 1 is one drawn anew in every frame. "
        "Borders of windows are included. The next sweep has the style errors of the same runs.",
    ),
    "style": (
        EXCESS,
        "{style} They are runs of the measured frame alone. The other frames use the same share of "
        "their own start as reference. The runs are those of the previous sweep.",
    ),
}


def _applies(case: Case) -> str:
    if len(case.neighbours(2)) < 2:
        return _ONE_FRAME
    if case.config.losses.style == 0:
        return "losses.style is 0: nothing is optimised"
    if case.config.stage.motion == "estimate":
        return ""
    velocity = case.read_with_velocity(case.plan).velocity
    return _NO_MOTION if velocity is None or velocity.is_empty else ""


@dataclass(frozen=True)
class _Shot:
    """Some neighbouring frames, small, and how they are stylized."""

    case: Case
    frames: Sequence[VolumeFrame]
    config: Config
    reference: Reference
    shown: dict[int, Sequence[Fields]] = field(default_factory=dict)  # first runs by window size

    @cached_property
    def smokes(self) -> list["ActiveSmoke"]:
        """The source's."""
        from usdsmoke.core.smoke.active import activate

        return [activate(frame.density, np.eye(4), self.case.device) for frame in self.frames]

    @cached_property
    def starts(self) -> list[float]:
        """The loss of each frame before it is stylized."""
        unseen = self.reference.trial.unseen
        return [
            unseen.start(smoke, frame.density, ("frame", frame.time_code))
            for smoke, frame in zip(self.smokes, self.frames, strict=True)
        ]

    def stylized(self, size: int, run: int) -> list["StylizedFrame"]:
        """All frames, in windows of this size."""
        from usdsmoke.core.sequence.stylize import stylize_window

        case, seed = self.case, self.config.optimize.seed + run
        rate = case.job.plan.source.time_codes_per_second
        config = self.config.replace(optimize=self.config.optimize.replace(seed=seed))
        found: list[StylizedFrame] = []
        for first in range(0, len(self.frames), size):
            window = self.frames[first : first + size]
            found += stylize_window(window, case.styles, case.small_scene, config, None, rate)
        self.shown.setdefault(size, [(frame.density, _light(frame)) for frame in found])
        return found

    def film(self) -> bytes:
        """Frames alone, in the largest windows, and the source; nothing if one is missing."""
        if 1 not in self.shown or len(self.shown) < 2:
            return b""
        sizes = (1, max(self.shown))
        versions = {_label(size, size): self.shown[size] for size in sizes}
        return draw_film(self.frames, versions, self.case.small_scene)

    def style_error(self, found: Sequence["StylizedFrame"]) -> float:
        """The mean error of the frames' style losses, each relative to its own start."""
        reference, errors = self.reference, []
        for number, frame in enumerate(self.frames):
            smoke = self.smokes[number]
            result: Any = found[number].density
            if found[number].painted:
                result = _painted(self.case, frame, found[number])[1]
            outcome = Outcome(smoke, result, ("frame", frame.time_code))
            loss = reference.trial.unseen.loss(outcome) * reference.start / self.starts[number]
            errors.append(reference.of_loss(loss))
        return float(np.mean(errors))


def _plan(error: str, case: Case) -> Plan:
    shot = _shot(case)
    config, n = case.config, len(shot.frames)
    chosen, warm = min(config.windows.size, n), _warm_share(case)
    sizes = [chosen, *(size for size in (*_first_sizes(n), 2, 3) if size <= n)]
    measure = partial(_temporal_error, shot) if error == "temporal" else shot.style_error
    tasks = [
        Task(
            "window size",
            _label(size, config.windows.size if size == chosen else size),
            partial(shot.stylized, size),
            measure,
            size == chosen,
            _effort(n, size, warm),
            key=("windows", n, size),
        )
        for size in dict.fromkeys(sizes)
    ]
    x_label, reference = _TEXTS[error]
    step, style = main_step(case), shot.reference
    return Plan(
        tasks,
        x_label,
        f"{n} frames, each like {copy_text(case)}, from timeCode {shot.frames[0].time_code:g} on: "
        f"the {step} step with {sum(base_iterations(case, step))} iterations as configured, and "
        "windows.warm_iterations where a frame starts from its neighbour. There is no overlap and "
        f"no shared coarse step. Time is for all {n} frames.{_cut_text(config.windows.size, n)}",
        reference.format(style=style.text),
        uncertain=style.apart if error == "style" else 0.0,
        n_runs=N_RUNS,
        rate=trial_seconds(case, step),
        film=shot.film if error == "temporal" else None,
    )


def _shot(case: Case) -> _Shot:
    """As many frames as the configured window has, three at least, and as the time allows."""
    if "shot" not in case.cache:
        step = main_step(case)
        seconds, warm = trial_seconds(case, step), _warm_share(case)
        first = reference_seconds(case, step)
        most = len(case.neighbours(max(case.config.windows.size, _FEW_FRAMES)))

        def needed(n: int) -> float:
            efforts = [_effort(n, size, warm) for size in set(_first_sizes(n))]
            return first + N_RUNS * seconds * sum(efforts)

        n = next((n for n in range(most, _LEAST_FRAMES, -1) if needed(n) <= case.allowed), None)
        n = n or min(most, _LEAST_FRAMES)
        need_seconds(case, f"three points of {n} frames and the references", needed(n))
        reference = reference_of(case, step)
        case.cache["shot"] = _Shot(case, small_frames(case, n), _main_step_config(case), reference)
    shot: _Shot = case.cache["shot"]
    return shot


def _first_sizes(n: int) -> tuple[int, int, int]:
    """The window sizes that say most about n frames."""
    return n, max(n // 2, 2), 1


def _effort(n_frames: int, size: int, warm: float) -> float:
    """Of all frames, in configured runs of one."""
    n_windows = -(-n_frames // size)
    return n_windows + (n_frames - n_windows) * warm


def _warm_share(case: Case) -> float:
    """Cost of a frame that starts from its neighbour, in configured runs of one."""
    from usdsmoke.core.smoke.schedule import warm_iterations

    base = base_iterations(case, main_step(case))
    return _CARRYING * sum(warm_iterations(base, case.config.windows.warm_iterations)) / sum(base)


def _label(size: int, meant: int) -> str:
    if size == 1:
        return "single frames"
    return f"windows of {size}" if meant == size else f"windows of {meant}, cut to {size} frames"


def _cut_text(configured: int, n: int) -> str:
    if n >= configured:
        return ""
    return (
        f" The configured windows of {configured} are longer than the {n} frames that exist or fit "
        "the time. What they gain beyond that is not visible here."
    )


def transit_between(case: Case, before: VolumeFrame, frame: VolumeFrame) -> "Transit":
    """From one of ``small_frames`` to the next."""
    from usdsmoke.core.sequence.transit import Transit, ride_between

    rate = case.job.plan.source.time_codes_per_second
    seconds = (frame.time_code - before.time_code) / rate
    if case.config.stage.motion == "estimate":  # the Volume's motion is in it
        return Transit(before, seconds)
    return Transit(before, seconds, ride_between(before, frame))


def small_frames(case: Case, n_frames: int) -> list[VolumeFrame]:
    """The measured frame and its neighbours, small, with the velocity that carries each to the
    next; see ``Case.neighbours``."""
    from usdsmoke.core.sequence.motion import estimate_velocity

    plans = case.neighbours(n_frames)
    frames = [case.shrunk(case.read_with_velocity(plan)) for plan in plans]
    if case.config.stage.motion != "estimate":
        return frames
    rate = case.job.plan.source.time_codes_per_second
    moving = []
    for frame, later in pairwise(frames):
        seconds = (later.time_code - frame.time_code) / rate
        velocity = estimate_velocity(frame, later, seconds, device=case.device)
        moving.append(replace(frame, velocity=velocity, velocity_to_stage=later.density_to_stage))
    return [*moving, replace(frames[-1], velocity=None, velocity_to_stage=None)]


def _main_step_config(case: Case) -> Config:
    """The settings with the main step alone; motion is that of the frames."""
    config = case.config.replace(grids=case.config.grids.replace(refine=1))
    config = config.replace(stage=config.stage.replace(motion="velocity"))
    step = main_step(case)
    optimize = config.optimize.replace(iterations=None, steps=[step], error_budget=False)
    own = getattr(config, step).replace(iterations=list(base_iterations(case, step)))
    return config.replace(optimize=optimize, **{step: own})


def _temporal_error(shot: _Shot, results: Sequence["StylizedFrame"]) -> float:
    from usdsmoke.core.sequence.steadiness import Steadiness

    steadiness, errors = Steadiness(shot.config.optimize.seed), []
    before: VolumeFrame | None = None
    for frame, result in zip(shot.frames, results, strict=True):
        transit = None if before is None else transit_between(shot.case, before, frame)
        errors.append(steadiness.compare(*_painted(shot.case, frame, result), transit).get(1))
        before = frame
    found = [error for error in errors if error is not None]
    return float(np.mean(found)) if found else 1.0  # no smoke stays from frame to frame


def _painted(
    case: Case, source: VolumeFrame, found: "StylizedFrame"
) -> tuple["ActiveSmoke", "Tensor"]:
    """A frame's smoke and its display-encoded colours [N 3].

    Without a colour step: how much its density was changed, as a share of the largest [N 1].
    """
    import torch

    from usdsmoke.core.smoke.active import activate
    from usdsmoke.core.smoke.srgb import encode_srgb

    density = found.density if found.painted else _union(source, found)
    smoke = activate(density, source.density_to_stage, case.device)
    place = tuple((smoke.ijk.cpu().numpy() - np.asarray(density.ijk_min)).T)
    if found.painted:
        values = np.sum([field.values[place] for field in found.painted], axis=0)
        light = torch.from_numpy(values).to(smoke.density)
        linear = light / (case.small_scene.gamma_w * smoke.density)[:, None]
        return smoke, encode_srgb(linear).clamp(0, 1)
    before, after = (field.at(smoke.ijk.cpu().numpy()) for field in (source.density, found.density))
    change = torch.from_numpy((after - before) / max(float(source.density.values.max()), 1e-30))
    return smoke, change[:, None].to(smoke.density)


def _light(found: "StylizedFrame") -> DenseField | None:
    """What is painted: emission, and scattering as it looks in white light."""
    if not found.painted:
        return None
    first, *others = found.painted
    values = sum((other.values for other in others), first.values)
    return replace(first, values=values)


def _union(source: VolumeFrame, found: "StylizedFrame") -> DenseField:
    """A field that is above 0 wherever there is smoke before or after."""
    fields = (source.density, found.density)
    ijk_min, shape = union_box(fields)
    both = [values_in_box(field, ijk_min, shape) for field in fields]
    return replace(found.density, values=np.maximum(*both).clip(0), ijk_min=ijk_min)


WINDOWS = (
    Sweep("windows", "Window size: temporal error", _applies, partial(_plan, "temporal")),
    Sweep("windows_style", "Window size: style", _applies, partial(_plan, "style")),
)
