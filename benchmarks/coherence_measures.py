"""What a stylized sequence is measured by: temporal errors, and closeness of style of its frames.

All is taken from finished fields, after blending, as they stand in the files.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from benchmarks.coherence_runs import Outcome, Run, Shot
from benchmarks.control_scenes import FRAMES_PER_SECOND
from benchmarks.held_out import held_out_angles
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.sequence.steadiness import Steadiness
from usdsmoke.core.sequence.transit import Transit
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.smoke.schedule import view_ranges
from usdsmoke.core.smoke.srgb import BRIGHTEST, decode_srgb, encode_srgb
from usdsmoke.core.steps.pictures import grey_view, prepare_views
from usdsmoke.core.steps.targets import StyleTargets, make_targets
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import fit_view

__all__ = [
    "Distances",
    "border_ratio",
    "painted_colours",
    "style_distances",
    "temporal_errors",
    "unmoved_distance",
]


@dataclass(frozen=True)
class Distances:
    """The judge's loss of finished pictures, one number a frame."""

    colour: np.ndarray
    grey: np.ndarray


def temporal_errors(
    frames: Sequence[VolumeFrame], run: Run, scene_gamma_w: float
) -> dict[str, dict[int, dict[float, float]]]:
    """The temporal errors of displacement and colour: by kind, frames in between, and timeCode.

    The earlier frame's velocity carries smoke from frame to frame, as in the run itself, also over
    frames that the run has left out.

    Args:
        frames: of the shot, ascending.
        run: some of these frames.
        scene_gamma_w: extinction per density that the emission was made with.
    """
    outcomes = {outcome.source.time_code: outcome for outcome in run.outcomes}
    frames = [f for f in frames if min(outcomes) <= f.time_code <= max(outcomes)]
    codes = [frame.time_code for frame in frames]
    measures = {kind: Steadiness() for kind in ("displacement", "colour")}
    found: dict[str, dict[int, dict[float, float]]] = {kind: {} for kind in measures}
    before = None
    for number, frame in enumerate(frames):
        transit = None
        if before is not None:
            seconds = (frame.time_code - before.time_code) / FRAMES_PER_SECOND
            transit = Transit(before, seconds)
        patterns = _patterns(frame, outcomes.get(frame.time_code), scene_gamma_w)
        for kind, pattern in patterns.items():
            for lag, error in measures[kind].compare(*pattern, transit).items():
                if {frame.time_code, codes[number - lag]} <= outcomes.keys():
                    found[kind].setdefault(lag, {})[frame.time_code] = error
        before = frame
    return found


def _patterns(
    frame: VolumeFrame, outcome: Outcome | None, gamma_w: float
) -> dict[str, tuple[ActiveSmoke, Tensor]]:
    """What is compared, by kind; zeros for a frame that was left out."""
    if outcome is None:
        smoke = activate(frame.density, frame.density_to_stage, torch.device("cpu"))
        nothing = torch.zeros(len(smoke.ijk), 3)
        return {"displacement": (smoke, nothing), "colour": (smoke, nothing)}
    moved = outcome.displacement.at(outcome.still.positions)
    return {"displacement": (outcome.still, moved), "colour": painted_colours(outcome, gamma_w)}


def border_ratio(errors: np.ndarray, touched: Sequence[int]) -> tuple[float, float]:
    """Mean and maximum of the errors at the borders, over the mean of the others.

    Args:
        errors: one a step.
        touched: numbers of the steps at borders.

    Raises:
        ValueError: all steps are at borders, or none is.
    """
    at_border = np.zeros(len(errors), bool)
    at_border[list(touched)] = True
    if at_border.all() or not at_border.any():
        raise ValueError(
            f"{at_border.sum()} of {len(errors)} steps are at borders; wanted some, but not all"
        )
    inside = float(errors[~at_border].mean())
    return float(errors[at_border].mean()) / inside, float(errors[at_border].max()) / inside


def painted_colours(outcome: Outcome, gamma_w: float) -> tuple[ActiveSmoke, Tensor]:
    """The voxels that hold smoke and their display-encoded colours [N 3], from the fields."""
    smoke = _activate(outcome, outcome.density)
    index = smoke.ijk.numpy() - np.asarray(outcome.emission.ijk_min)
    light = torch.from_numpy(outcome.emission.values[tuple(index.T)])
    return smoke, encode_srgb(light / (gamma_w * smoke.density)[:, None]).clamp(0, BRIGHTEST)


def style_distances(shot: Shot, run: Run, n_views: int = 4) -> Distances:
    """The judge's loss at full size, mean of views within the range that were never optimised."""
    targets = make_targets([shot.style], shot.scene, shot.config, torch.device("cpu"))
    views = shot.config.views
    angles = held_out_angles(n_views, *view_ranges(views))
    colour, grey = [], []
    with torch.no_grad():
        for outcome in run.outcomes:
            looks = _views(shot, outcome, angles)
            colour.append(_colour_distance(shot, outcome, looks, targets))
            grey.append(_grey_distance(shot, outcome, outcome.density, looks, targets))
    return Distances(np.array(colour), np.array(grey))


def unmoved_distance(shot: Shot, run: Run, n_views: int = 4) -> float:
    """The grey distance of the sources themselves, mean of all frames: where moving begins."""
    targets = make_targets([shot.style], shot.scene, shot.config, torch.device("cpu"))
    views = shot.config.views
    angles = held_out_angles(n_views, *view_ranges(views))
    found = [
        _grey_distance(shot, item, item.source.density, _views(shot, item, angles), targets)
        for item in run.outcomes
    ]
    return float(np.mean(found))


def _views(shot: Shot, outcome: Outcome, angles: np.ndarray) -> list[View]:
    """Just large enough for the source's smoke: the same ones for every version of a frame."""
    up, size = shot.scene.up_axis, shot.scene.pixel_size
    return [
        fit_view(orbit_view(float(a), float(e), up, np.zeros(3), 1, 1, size), outcome.still)
        for a, e in angles
    ]


def _colour_distance(
    shot: Shot, outcome: Outcome, views: Sequence[View], targets: StyleTargets
) -> float:
    smoke, colours = painted_colours(outcome, shot.scene.gamma_w)
    looks = prepare_views(smoke, views, shot.scene.gamma_w, shot.scene.exposure)
    judge, linear = targets.at(1), decode_srgb(colours)
    found = [judge(look.unpremultiplied(linear, targets.background), look.guide) for look in looks]
    return float(torch.stack(found).mean())


def _grey_distance(
    shot: Shot, outcome: Outcome, density: DenseField, views: Sequence[View], targets: StyleTargets
) -> float:
    """Of the grey pictures of a density, inside the silhouette of the frame's source."""
    scene, still, judge = shot.scene, outcome.still, targets.at(1, grey=True)
    moved = _activate(outcome, density)
    found = []
    for view in views:
        image = column_map(still.positions, still.edges, view)
        look = grey_view(image, still.density, None, scene.gamma_w_shape, scene.exposure_shape)
        look = replace(look, image=column_map(moved.positions, moved.edges, view))
        picture = look.over_grey(look.picture(moved.density), scene.grey_mean)
        found.append(judge(picture, look.guide))
    return float(torch.stack(found).mean())


def _activate(outcome: Outcome, density: DenseField) -> ActiveSmoke:
    return activate(density, outcome.source.density_to_stage, torch.device("cpu"))
