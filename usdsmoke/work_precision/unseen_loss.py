"""How good the result of a trial is: its loss over views that no trial uses."""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.schedule import views_in_front
from usdsmoke.work_precision.case import Case

if TYPE_CHECKING:
    from torch import Tensor

    from usdsmoke.core.smoke.active import ActiveSmoke
    from usdsmoke.core.steps.optimize import Minimum
    from usdsmoke.core.steps.pictures import ColourView
    from usdsmoke.core.style.losses import PictureLoss
    from usdsmoke.core.views.cameras import View

_N_VIEWS = 16  # unused ones, and at most as many of the used ones
_SEED = 20_011  # of the unused views: far from any run's


@dataclass(frozen=True)
class Outcome:
    """What a step made of some smoke."""

    smoke: "ActiveSmoke"  # before
    found: Any  # display-encoded colours [N 3], or the moved density as a field
    place: Hashable  # equal for outcomes of the same smoke
    config: Config | None = None  # with the seed that it was made with
    n_octaves: int = 1
    ends: Sequence["Minimum"] = field(default=())  # of the octaves


class UnseenLoss:
    """The configured style loss of one step's results, over views that the step never uses."""

    def __init__(self, case: Case, step: str, config: Config) -> None:
        from usdsmoke.core.steps.targets import make_targets

        self._case, self._step, self._config = case, step, config
        self._scene = case.small_scene
        self._targets = make_targets(case.styles, case.small_scene, config, case.device)
        self._prepared: dict[Hashable, Sequence[ColourView]] = {}  # by place
        self._chances: list[float] = []  # standard errors of gaps

    def loss(self, outcome: Outcome) -> float:
        """The configured loss of a result, the mean over the unused views."""
        keep = self._config.losses.keep
        return float(np.mean([style + keep * left for style, left in self._unused(outcome)]))

    def gap(self, outcome: Outcome) -> float:
        """How far the style loss of unused views differs from that of used ones, relative to it.

        The same measure as a run's ``unseen views``.
        """
        from usdsmoke.core.views.scene import frame_views

        config = outcome.config or self._config
        seed = config.optimize.seed + outcome.n_octaves - 1  # of the last octave's pool
        views = views_in_front(config.views) if self._step == "colour" else config.views
        pool = frame_views(outcome.smoke, views, self._scene, seed)
        used = pool[:: max(1, len(pool) // _N_VIEWS)][:_N_VIEWS]
        ours = [style for style, _ in self._losses(outcome, used)]
        others = [style for style, _ in self._unused(outcome)]
        mean = float(np.mean(ours))
        if mean <= 0:
            return 0.0
        squares = float(np.var(others)) / len(others) + float(np.var(ours)) / len(ours)
        self._chances.append(squares**0.5 / mean)
        return abs(float(np.mean(others)) - mean) / mean

    def chance(self) -> float:
        """The gap of a result that looks alike from everywhere, because single views differ: the
        standard error of the gap, the smallest of those that were measured."""
        return float(min(self._chances, default=0.0))

    def start(self, smoke: "ActiveSmoke", density: Any, place: Hashable) -> float:
        """The loss before the step: of noise, or of density that was not moved."""
        from usdsmoke.core.steps.colour import initial_colours

        found = density
        if self._step == "colour":
            config = self._config
            found = initial_colours(smoke, config.colour.init, config.optimize.seed)
        return self.loss(Outcome(smoke, found, place))

    def pictures(self, outcome: Outcome) -> list["Tensor"]:
        """What the network sees in the unused views of colours, [H W 3] display-encoded, with its
        guide [H W 1] behind them: [H W 4]."""
        import torch

        with torch.no_grad():
            views = self._unused_views(outcome)
            return [
                torch.cat([picture, guide[..., None]], dim=-1)
                for picture, guide in self._pictures(outcome, views)
            ]

    def _unused(self, outcome: Outcome) -> list[tuple[float, float]]:
        if self._step == "shape":
            return self._losses(outcome, self._angles(outcome.smoke))
        return self._colour_losses(outcome, self._unused_views(outcome))

    def _losses(self, outcome: Outcome, views: Sequence["View"]) -> list[tuple[float, float]]:
        """Style loss and what left the smoke's outline, by view."""
        import torch

        from usdsmoke.core.steps.pictures import prepare_views

        if self._step == "shape":
            with torch.no_grad():
                return list(self._shape_losses(outcome, views))
        scene = self._scene
        made = prepare_views(outcome.smoke, views, scene.gamma_w, scene.exposure)
        return self._colour_losses(outcome, made)

    def _colour_losses(
        self, outcome: Outcome, views: Sequence["ColourView"]
    ) -> list[tuple[float, float]]:
        import torch

        loss: PictureLoss = self._targets.at(1)
        with torch.no_grad():
            return [
                (float(loss(picture, guide)), 0.0)
                for picture, guide in self._pictures(outcome, views)
            ]

    def _pictures(
        self, outcome: Outcome, views: Sequence["ColourView"]
    ) -> Iterator[tuple["Tensor", "Tensor"]]:
        from usdsmoke.core.smoke.srgb import decode_srgb

        for view in views:
            linear = decode_srgb(outcome.found)
            yield view.unpremultiplied(linear, self._targets.background), view.guide

    def _shape_losses(
        self, outcome: Outcome, views: Sequence["View"]
    ) -> Iterator[tuple[float, float]]:
        from usdsmoke.core.smoke.active import activate
        from usdsmoke.core.steps.pictures import grey_view
        from usdsmoke.core.views.optics import opacity
        from usdsmoke.core.views.project import column_map

        scene, smoke = self._scene, outcome.smoke
        loss: PictureLoss = self._targets.at(1, grey=True)
        moved = activate(outcome.found, np.eye(4), self._case.device)
        for view in views:
            still = column_map(smoke.positions, smoke.edges, view)
            look = grey_view(still, smoke.density, None, scene.gamma_w_shape, scene.exposure_shape)
            image = column_map(moved.positions, moved.edges, view)
            columns = image.apply(moved.density[:, None])[..., 0]
            grey = opacity(scene.gamma_w_shape * columns) * scene.exposure_shape
            seen = look.over_grey(grey, scene.grey_mean)
            yield float(loss(seen, look.guide)), float(look.outside_change(grey))

    def _unused_views(self, outcome: Outcome) -> Sequence["ColourView"]:
        from usdsmoke.core.steps.pictures import prepare_views

        if outcome.place not in self._prepared:
            scene, views = self._scene, self._angles(outcome.smoke)
            made = prepare_views(outcome.smoke, views, scene.gamma_w, scene.exposure)
            self._prepared[outcome.place] = made
        return self._prepared[outcome.place]

    def _angles(self, smoke: "ActiveSmoke") -> Sequence["View"]:
        from usdsmoke.core.views.scene import frame_views

        views = self._config.views.replace(pool=_N_VIEWS, sampling="poisson")
        return frame_views(smoke, views, self._scene, _SEED)
