"""The state of a frame in its window, one immutable record per phase, and how a frame is opened.

A frame is opened, shaped, moved and painted. Each record has everything of the one before it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.frame_report import Estimate, FrameReport, Progress, ProgressCallback
from usdsmoke.base.volume import DenseField, Scattering, VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.fields.resample import refine_field
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.sequence.controls import (
    are_independent,
    check_storable,
    frame_config,
    step_iterations,
    without_network,
)
from usdsmoke.core.sequence.start import Carried, CoarseStart, on_device
from usdsmoke.core.sequence.transit import Transit, ride_between
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.smoke.device import choose_device
from usdsmoke.core.smoke.field_checks import check_fields, field_warnings
from usdsmoke.core.steps.optimize import Minimum
from usdsmoke.core.steps.shape import max_displacement
from usdsmoke.core.steps.targets import StepProblem, StyleTargets, make_targets
from usdsmoke.core.views.lighting import Lighting, light_smoke
from usdsmoke.core.views.scene import Scene, frame_scene
from usdsmoke.core.views.visibility import (
    EffectMask,
    Visibility,
    changed_in_part,
    effect_mask,
    frame_visibility,
    mask_warnings,
    sight_of,
)

Watch = Callable[[str, Sequence[int]], Callable[[int, Minimum], None]]

NO_STRENGTH = "optimize.strength is 0"  # why a frame is left out


@dataclass(frozen=True)
class WindowContext:
    """What all frames of a window share."""

    targets: StyleTargets
    scene: Scene
    config: Config
    device: torch.device
    time_codes_per_second: float
    starts: Callable[[float], CoarseStart | None]
    watch: Callable[[float], Watch]  # by timeCode
    known: Carried | None = None  # of a frame that is not optimised again
    generator: Generator | None = None  # paints what colours start from, without a neighbour
    independent: bool = False  # frames, of each other: see ``controls.are_independent``

    def transit(self, earlier: "OpenedFrame", later: "OpenedFrame") -> Transit:
        """From a frame to a later one.

        The pattern goes with ``windows.pattern_speed`` times the earlier frame's velocity, in both
        directions, and with the Volume. An estimated velocity has the Volume's motion in it.
        """
        span = later.time_code - earlier.time_code
        seconds = span / self.time_codes_per_second * earlier.config.windows.pattern_speed
        if self.config.stage.motion == "estimate":
            return Transit(earlier.frame, seconds)
        return Transit(earlier.frame, seconds, ride_between(earlier.frame, later.frame))

    def known_of(self, frame: "OpenedFrame") -> Carried | None:
        """The result of a frame that is not optimised again."""
        is_known = self.known is not None and self.known.time_code == frame.time_code
        return self.known if is_known else None


@dataclass(frozen=True, kw_only=True)
class OpenedFrame:
    """A checked frame with its own settings."""

    frame: VolumeFrame
    density: DenseField  # refined; all of it
    source: ActiveSmoke  # what the shape step moves: the visible smoke and a little around it
    smoke: ActiveSmoke  # what is painted: the visible smoke alone
    mask: EffectMask | None
    visibility: Visibility | None  # None: all of the smoke is visible
    coarse: CoarseStart | None
    config: Config  # the window's, with the frame's own controls
    scene: Scene  # likewise, with its camera
    targets: StyleTargets  # likewise
    report: FrameReport

    @property
    def time_code(self) -> float:
        """Of the frame."""
        return self.frame.time_code

    @property
    def left_out(self) -> str:
        """Why nothing is done; "" for a frame that is stylized."""
        return self.report.left_out

    @property
    def ends_chain(self) -> bool:
        """Whether the frame after it does not start from the frames before it."""
        return self.left_out == NO_STRENGTH

    @property
    def in_effect(self) -> bool:
        """Whether the result differs from the source."""
        return not self.left_out and self.config.optimize.strength > 0

    @property
    def has_coarse_displacement(self) -> bool:
        """Whether the shared coarse step has moved the frame."""
        return self.coarse is not None and self.coarse.displacement is not None

    def todo(self, step: str, is_warm: bool) -> list[int]:
        """Iterations of a step per octave.

        A frame that starts from the shared coarse step leaves out the octaves that were done there.
        """
        iterations = step_iterations(self.config, step, is_warm, len(self.smoke.ijk))
        by_network = step == "colour" and self.config.optimize.paints
        if is_warm or by_network or self.coarse is None:
            return iterations
        n_done = self.coarse.n_octaves(len(iterations))
        return [0 if number < n_done else n for number, n in enumerate(iterations)]

    def lighting(self) -> Lighting | None:
        """Light that the pictures show beside the colours, or that the colours weigh; exposed.

        None without lights, and where the emission makes up for what the light cannot give: such
        pictures do not depend on it.
        """
        return None if self.config.colour.target == "both" else self.all_light()

    def whole_smoke(self) -> ActiveSmoke:
        """What hides light: the painted smoke, and what the camera does not see."""
        if self.visibility is None:
            return self.smoke
        return activate(self.density, self.frame.density_to_stage, self.smoke.ijk.device)

    def all_light(self) -> Lighting | None:
        """Light in the smoke, all of it: what the camera does not see casts shadows too."""
        lights, config = self.frame.lights, self.config
        if not lights or config.albedo == 0:
            return None
        smoke, optics = self.whole_smoke(), config.optics
        scattering = Scattering(lights, config.albedo, optics.anisotropy, optics.bounces)
        found = light_smoke(smoke, self.scene.gamma_w, scattering.exposed(self.scene.stops))
        weighs = config.colour.target == "albedo"
        return None if found is None else replace(found, weighs_light=weighs)

    def problem(self, smoke: ActiveSmoke) -> StepProblem:
        """What a step works on."""
        return StepProblem(smoke, self.targets, self.scene, self.config, self.mask)

    def colour_problem(self) -> StepProblem:
        """What the colour step works on."""
        return replace(self.problem(self.smoke), lighting=self.lighting())


@dataclass(frozen=True, kw_only=True)
class ShapedFrame(OpenedFrame):
    """Has a displacement, unless it is left out."""

    unclamped: Displacement | None = None  # its velocity; averaged with the next one's later
    is_cold: bool = False  # next to none of its smoke comes from the frame before
    carried: Carried | None = None  # what the next frame starts from

    @property
    def is_start(self) -> bool:
        """Whether the next frame can start from it."""
        return self.unclamped is not None


@dataclass(frozen=True, kw_only=True)
class MovedFrame(ShapedFrame):
    """Its density and smoke are moved."""

    displacement: Displacement | None = None  # clamped, at full strength
    moved_by: Displacement | None = None  # the same at the frame's own strength; None: not at all


@dataclass(frozen=True, kw_only=True)
class PaintedFrame(MovedFrame):
    """Has colours, unless it is left out."""

    painted: ActiveSmoke | None = None
    colours: Tensor | None = None  # display-encoded [N 3], of the painted voxels
    independent: bool = False  # the next frame takes nothing from this one
    n_views: int = 0  # that its last octave had; 0: ``views.pool``
    unseen: Estimate | None = None  # of views outside the pool; None: not looked at yet

    @property
    def is_start(self) -> bool:
        """Whether the next frame can start from it."""
        return self.paint is not None

    @property
    def paint(self) -> tuple[ActiveSmoke, Tensor] | None:
        """The painted voxels and their colours; None where there are none."""
        if self.painted is None or self.colours is None or len(self.painted.ijk) == 0:
            return None
        return self.painted, self.colours

    @property
    def checkpoint(self) -> Carried | None:
        """What a sequence goes on with behind the frame; None where it takes earlier frames too."""
        steps, carried = self.config.optimize.steps, self.carried
        if carried is None or not self.in_effect:
            return None
        if self.independent:
            return Carried(self.time_code)
        is_whole = "shape" not in steps or carried.unclamped is not None
        return carried if is_whole and ("colour" not in steps or self.paint is not None) else None


Phase = TypeVar("Phase", bound=OpenedFrame)


def advance(frame: OpenedFrame, phase: type[Phase], **values: Any) -> Phase:
    """The frame's record of a later phase: all that it has, and ``values``."""
    return phase(**{**vars(frame), **values})


def make_context(
    styles: Sequence[np.ndarray],
    scene: Scene,
    config: Config,
    progress: ProgressCallback | None,
    time_codes_per_second: float,
    starts: Callable[[float], CoarseStart | None] | None,
    n_frames: int,
) -> WindowContext:
    """The context of a window; arguments as of ``stylize.stylize_window``.

    Raises:
        FeatureError: see ``Generator.from_file``.
    """
    device, generator, independent = choose_device(config.optimize), None, are_independent(config)
    if config.optimize.start and scene.misfit:
        config = without_network(config)
    if config.optimize.paints:
        generator = Generator.from_file(Path(config.optimize.start)).to(device)
    targets = make_targets(styles, scene, config, device)
    watch = partial(_watcher, progress, n_frames, [])
    starts = starts or (lambda time_code: None)
    return WindowContext(
        targets,
        scene,
        config,
        device,
        time_codes_per_second,
        starts,
        watch,
        generator=generator,
        independent=independent,
    )


def _watcher(
    progress: ProgressCallback | None, n_frames: int, seen: list[float], time_code: float
) -> Watch:
    """Turns the optimiser's states of a step into progress records; numbers frames as they come."""
    if time_code not in seen:
        seen.append(time_code)
    frame = seen.index(time_code)

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


def open_frame(frame: VolumeFrame, context: WindowContext) -> OpenedFrame:
    """The first record of a frame.

    Raises:
        NonFiniteError: it holds NaN or infinity.
        ConfigError: its controls are out of range, or 16-bit floats cannot hold the result.
    """
    # check the fields, and find the frame's own settings
    check_fields(frame)
    shared, n_styles = context.config, len(context.targets.images)
    config = frame_config(shared, frame.controls, frame.time_code, n_styles)
    scene, targets = context.scene, context.targets
    if config is not shared:
        scene, targets = frame_scene(scene, config.optics.gamma), targets.weighted(config.style)

    # thicken the smoke, and find what is visible and not masked
    density = raw = refine_field(frame.density, shared.grids.parts)
    if (curve := scene.thickening) is not None:
        density = curve.of_field(raw)
    source = smoke = activate(density, frame.density_to_stage, context.device)
    limit = max_displacement(source, shared.shape.reach) if len(source.ijk) else 0.0
    visibility = frame_visibility(frame, source, limit, shared.views.camera_margin)
    mask = effect_mask(frame, visibility)
    if curve is not None and (mask is not None or config.optimize.strength < 1):
        density = changed_in_part(raw, density, source, mask, config.optimize.strength)
        source = smoke = activate(density, frame.density_to_stage, context.device)
    check_storable(density, frame.time_code, scene.gamma_w, config)
    left_out, n_outside, sight = _why_left_out(source, mask, visibility, config), None, None
    if visibility is not None:
        n_outside = int((visibility.at(source.positions) == 0).sum())
    warnings = (*field_warnings(frame, raw, len(source.ijk)), *mask_warnings(frame, mask, source))
    if frame.camera is not None and len(source.ijk):
        sight = sight_of(source, frame.camera, scene.gamma_w)
    report = FrameReport(len(source.ijk), n_outside, warnings, left_out, sight, scene.gamma_w)
    if visibility is not None and not left_out:
        source, smoke = visibility.padded(source), visibility.visible(source)
    return OpenedFrame(
        frame=frame, density=raw if left_out else density, source=source, smoke=smoke, mask=mask,
        visibility=visibility, coarse=on_device(context.starts(frame.time_code), context.device),
        config=config, scene=replace(scene, camera=frame.camera), targets=targets, report=report,
    )  # fmt: skip


def selected(smoke: ActiveSmoke, mask: EffectMask | None) -> ActiveSmoke:
    """The voxels that a mask selects, at least in part; all without one."""
    return smoke if mask is None else smoke.take(mask.at(smoke.positions) > 0)


def _why_left_out(
    source: ActiveSmoke, mask: EffectMask | None, visibility: Visibility | None, config: Config
) -> str:
    """Why there is nothing to do for a frame; "" when there may be, if its strength is not 0."""
    if len(source.ijk) == 0:
        return "empty frame"
    if visibility is not None and not bool(visibility.at(source.positions).any()):
        return visibility.why_nothing(source)
    if mask is not None and not bool(mask.at(source.positions).any()):
        where = "the camera sees smoke" if visibility is not None else "there is smoke"
        return f"the mask is 0 wherever {where}"
    return "losses.style is 0" if config.losses.style == 0 else ""
