"""A Volume with the reports of its frames: why figures are absent, and what pairs leave out."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.core.sequence.controls import are_independent
from usdsmoke.core.smoke.schedule import has_one_view
from usdsmoke.planning.plan import FramePlan, VolumePlan

_MOST_NAMED = 6
_NO_ITERATIONS = "optimize.iterations is 0: a network paints each frame by itself"


@dataclass(frozen=True)
class PlannedVolume:
    """A Volume with the reports of its frames. Each reason is "" where it does not apply."""

    plan: VolumePlan
    reports: tuple[FrameReport | None, ...]  # of ``plan.frames``; None without one
    scene: Mapping[str, Any] = field(default_factory=dict)  # as measured; empty: not known

    def without_step(self, step: str) -> str:
        """Why a step is not run: shape or colour."""
        return "" if step in self.plan.config.optimize.steps else f"no {step} step"

    @property
    def no_shape(self) -> str:
        """Why there is nothing of the shape step."""
        alone = _NO_ITERATIONS if are_independent(self.plan.config) else ""
        return self.without_step("shape") or alone or self.idle

    @property
    def no_colour(self) -> str:
        """Why there is nothing of the colour step."""
        return self.without_step("colour") or self.idle

    @cached_property
    def idle(self) -> str:
        """Why no frame is stylized."""
        why = dict.fromkeys("" if report is None else report.left_out for report in self.reports)
        return "" if not why or "" in why else f"no frame is stylized ({', '.join(why)})"

    @property
    def no_estimates(self) -> str:
        """Why nothing is estimated of the finished frames."""
        config = self.plan.config
        if are_independent(config):
            return _NO_ITERATIONS
        return self.idle or ("" if config.optimize.error_budget else "optimize.error_budget is off")

    @property
    def one_view(self) -> str:
        """Why there is only one view."""
        thin = all(1 in frame.size.box for frame in self.plan.frames)
        if thin:
            return "the smoke is one voxel thick and has one view"
        return "all views are the same" if has_one_view(self.plan.config.views) else ""

    @property
    def no_spread(self) -> str:
        """Why losses of views are not compared."""
        return self.one_view or ("views.pool is 1" if self.plan.config.views.pool == 1 else "")

    @property
    def one_scheme(self) -> str:
        """Why the optimiser's transport scheme has no error of its own."""
        linear = self.plan.config.shape.interpolation == "linear"
        return "shape.interpolation is linear, as in the optimiser" if linear else ""

    def no_chain(self, n: int) -> str:
        """Why no frame is compared with the n-th before it."""
        windows = self.plan.windows
        if are_independent(self.plan.config):
            return _NO_ITERATIONS
        if n > 1 and len(self.plan.frames) <= n:
            return f"there are fewer than {n + 1} frames"
        if len(self.plan.frames) == 1:
            return "there is one frame only"
        if self.plan.config.windows.size == 1:
            return "windows.size is 1: frames are stylized one by one, without the frame before"
        if not list(neighbours(self.plan)):
            return "there is a cut between any two frames"
        if all(len(window.time_codes) + len(window.overlap) == 1 for window in windows):
            return "no two frames share a window"
        if n > 1 and all(len(w.time_codes) + len(w.overlap) <= n for w in windows):
            return f"no window has {n + 1} frames"
        compared = any(report and report.temporal for report in self.reports)
        return "no two neighbouring frames " + (
            "continue each other's smoke" if compared else "are stylized"
        )

    @property
    def no_overlap(self) -> str:
        """Why no frame is computed twice."""
        windows = self.plan.config.windows
        if are_independent(self.plan.config):
            return _NO_ITERATIONS
        if len(self.plan.windows) == 1:
            return "there is one window only"
        if windows.size == 1:
            return "windows.size is 1: such windows share no frames"
        return (
            "windows.overlap is 0" if windows.overlap == 0 else "there is a cut between any windows"
        )


def temporal_note(volumes: Sequence[PlannedVolume], kind: str, step: str) -> str:
    """What a temporal error leaves out: not every frame is compared with the one before.

    Returns:
        "" where all pairs of neighbouring frames are compared as usual.
    """
    measured, n_unlike, n_others, borders = 0, 0, 0, list[str]()
    for volume in volumes:
        if volume.without_step(step):
            continue
        names = [frame.file_name for frame in volume.plan.frames]
        reports = dict(zip(names, volume.reports, strict=True))
        for before, after in neighbours(volume.plan):
            report = reports[after.file_name]
            if report and report.temporal and getattr(report.temporal, kind) is not None:
                measured += 1
            elif _at_border(volume.plan, after):
                borders.append(f"{before.source.time_code:g}-{after.source.time_code:g}")
            elif report and report.temporal:
                n_unlike += 1
            else:
                n_others += 1
    n_pairs = measured + len(borders) + n_unlike + n_others
    texts = [f"{measured} of {n_pairs} pairs of neighbouring frames"]
    if borders:
        texts.append(f"not those on both sides of a window's border ({_shortened(borders)})")
    if n_unlike:
        texts.append(f"not {n_unlike} where a frame starts anew or no smoke is the same")
    if n_others:
        texts.append(f"not {n_others} where a frame is not stylized")
    texts += _unusual_ways([volume.plan for volume in volumes])
    return ", ".join(texts) if len(texts) > 1 else ""


def _unusual_ways(volumes: Sequence[VolumePlan]) -> list[str]:
    """How pairs are compared where it is not as usual."""
    pairs = [(volume.config, frame) for volume in volumes for frame in volume.frames]
    moving = any(
        frame.velocity is not None or config.stage.motion == "estimate" for config, frame in pairs
    )
    texts = [] if moving else ["compared in place, as there is no velocity"]
    speeds = {
        config.windows.pattern_speed if own is None else own
        for config, frame in pairs
        for own in (frame.source.controls.pattern_speed,)
    }
    if moving and speeds != {1.0}:
        texts.append("compared at windows.pattern_speed times the smoke's velocity")
    if any(config.stage.mask or config.views.camera for config, _ in pairs):
        texts.append("where mask and camera select smoke in both frames")
    if any(volume.overlap_frames for volume in volumes):
        texts.append("in overlaps, each window is measured separately")
    return texts


def neighbours(volume: VolumePlan) -> Iterator[tuple[FramePlan, FramePlan]]:
    """Frames that follow each other without a cut, in whatever windows."""
    for pair in pairwise(volume.frames):
        if tuple(frame.source.time_code for frame in pair) not in volume.cuts:
            yield pair


def _at_border(volume: VolumePlan, frame: FramePlan) -> bool:
    """Whether a frame is the first of its window and no earlier window computes it."""
    code = frame.source.time_code
    first = any(window.time_codes[0] == code for window in volume.windows)
    return first and not any(code in window.overlap for window in volume.windows)


def _shortened(texts: Sequence[str]) -> str:
    if len(texts) <= _MOST_NAMED:
        return ", ".join(texts)
    return f"{', '.join(texts[: _MOST_NAMED - 1])} and {len(texts) - _MOST_NAMED + 1} more"
