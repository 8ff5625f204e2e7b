"""One step of the optimisation tried on the small frame, and its result judged by unused views."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from usdsmoke.config import Config
from usdsmoke.report.case import Case
from usdsmoke.report.records import Task

if TYPE_CHECKING:
    from torch import Tensor

    from usdsmoke.core.colour import ColourView
    from usdsmoke.core.picture_loss import PictureLoss
    from usdsmoke.core.scene import Scene
    from usdsmoke.core.smoke import ActiveSmoke
    from usdsmoke.core.targets import StyleTargets
    from usdsmoke.core.views import View

__all__ = ["JUDGED", "Setting", "Trial", "base_iterations", "main_step", "untiring"]

JUDGED = "style loss over views that no run has used"
_N_JUDGES = 6  # views
_JUDGE_SEED = 20_011  # far from any run's
_SHARE = 1 / 400  # of the report's time that one trial may take
_FEWEST = 12  # iterations of a trial


@dataclass(frozen=True)
class Setting:
    """What a trial differs in from the configured one."""

    per_octave: tuple[int, ...]  # iterations, coarse to fine
    config: Config
    refine: int = 1  # voxels are cut this many times
    pixels: int = 1  # voxels of the small frame along a pixel's side; 1 is the small scene's


def main_step(case: Case) -> str:
    """The step that sweeps about both are made with: the one that takes the time."""
    return "colour" if "colour" in case.steps else case.steps[0]


def base_iterations(case: Case, step: str) -> tuple[int, ...]:
    """Iterations per octave of a trial: the configured ones, fewer where time does not allow them.

    Measured by a short trial, which also warms the machine up. A note on the page says by how much.
    """
    if step not in case.iterations:
        case.iterations[step] = _fitting(case, step)
    return case.iterations[step]


def _fitting(case: Case, step: str) -> tuple[int, ...]:
    from usdsmoke.core.schedule import octave_iterations

    whole = octave_iterations(
        getattr(case.config, step).iterations, case.config.optimize.iterations
    )
    trial = Trial(case, step, case.config)
    few, more = (octave_iterations(whole, min(sum(whole), n)) for n in (1, _FEWEST))
    _seconds(trial, few, case.config)  # the machine gets warm
    first, second = (_seconds(trial, pilot, case.config) for pilot in (few, more))
    each = max((second - first) / max(sum(more) - sum(few), 1), 1e-5)
    set_up = max(first - each * sum(few), 0.0)
    target = case.seconds * _SHARE
    wanted = min(sum(whole), max(_FEWEST, int((target - set_up) / each)))
    taken = _seconds(trial, octave_iterations(whole, wanted), case.config)
    if taken > target:  # a pilot of few iterations tells little
        wanted = max(min(_FEWEST, sum(whole)), int(wanted * target / taken))
    if wanted >= sum(whole):
        return tuple(whole)
    case.notes.append(
        f"Trials of the {step} step do {wanted} iterations in all, not the configured "
        f"{sum(whole)}, so that they fit the time; multiples of the configured number mean "
        "multiples of that. A larger --budget comes nearer to it."
    )
    return tuple(octave_iterations(whole, wanted))


def _seconds(trial: "Trial", per_octave: Sequence[int], config: Config) -> float:
    """Of one run, by the clock on the wall: that is what the report's time is measured in."""
    setting = Setting(tuple(per_octave), untiring(config))
    trial.prepare(setting)
    started = time.perf_counter()
    trial.run(setting, 0)
    return time.perf_counter() - started


def untiring(config: Config) -> Config:
    """The settings without the rule that stops an octave early."""
    return replace(config, optimize=replace(config.optimize, tolerance=0.0))


class Trial:
    """A step on the small frame, from its own start, without neighbours, mask or camera's frustum.

    Args:
        case: gives frame, scene and styles.
        step: ``shape`` or ``colour``.
        config: of the features and losses that results are judged by.
    """

    def __init__(self, case: Case, step: str, config: Config) -> None:
        self._case, self._step = case, step
        self._scene = case.small_scene
        self._judge_config = config
        self._targets: dict[Any, StyleTargets] = {}
        self._smokes: dict[int, ActiveSmoke] = {1: case.small_smoke}
        self._judged: dict[int, Sequence[ColourView]] = {}  # views of a smoke, by its id

    def task(
        self,
        curve: str,
        label: str,
        setting: Setting,
        configured: bool = False,
        effort: float = 1.0,
        error: Callable[[Any], float] | None = None,
    ) -> Task:
        """A task that runs a setting; its error is ``judge``'s unless another one is given."""
        return Task(
            curve, label, partial(self.run, setting), error or self.judge, None, configured,
            effort, prepare=partial(self.prepare, setting),
        )  # fmt: skip

    def run(self, setting: Setting, run: int) -> Any:
        """The result of one run; ``judge`` takes it. Runs differ in their seed alone."""
        config = setting.config
        config = replace(config, optimize=replace(config.optimize, seed=config.optimize.seed + run))
        return self._run(setting, config)

    def prepare(self, setting: Setting) -> None:
        """Makes what is the same for all runs: the style's statistics and finer voxels."""
        scene = self._scene_of(setting)
        targets = self._targets_of(setting)
        for number in range(len(setting.per_octave)):
            if setting.per_octave[number]:
                factor = 2 ** (len(setting.per_octave) - 1 - number)
                targets.at(factor, grey=self._step == "shape")
        self._smoke_of(setting, scene)

    def _run(self, setting: Setting, config: Config) -> Any:
        from usdsmoke.core.colour import run_colour_step
        from usdsmoke.core.move import move_density
        from usdsmoke.core.potential import Displacement, hold
        from usdsmoke.core.shape import longest_move, run_shape_step

        scene = self._scene_of(setting)
        smoke, targets = self._smoke_of(setting, scene), self._targets_of(setting)
        if self._step == "colour":
            colours, _ = run_colour_step(smoke, None, targets, scene, config, setting.per_octave)
            return smoke, colours
        free, _ = run_shape_step(smoke, None, targets, scene, config, setting.per_octave)
        lattice, cap = free.lattice, longest_move(smoke, config)
        held = lattice.to_stage(hold(lattice.from_stage(free.values), cap, None))
        displacement = Displacement(held, lattice)
        moved, _ = move_density(self._field_of(setting), smoke, displacement, config)
        return smoke, moved

    def judge(self, result: Any) -> float:
        """The configured loss of a result, the mean over views that no run has used."""
        import torch

        smoke, found = result
        with torch.no_grad():
            if self._step == "colour":
                losses = list(self._colour_losses(smoke, found))
            else:
                losses = list(self._shape_losses(smoke, found))
        return float(np.mean(losses))

    def pictures(self, result: Any) -> list["Tensor"]:
        """What the network sees in those views, [H W 3] display-encoded, with its guide [H W 1]
        behind them: [H W 4]."""
        import torch

        smoke, found = result
        with torch.no_grad():
            return [
                torch.cat([picture, guide[..., None]], dim=-1)
                for picture, guide in self._seen(smoke, found)
            ]

    def _colour_losses(self, smoke: "ActiveSmoke", colours: "Tensor") -> Any:
        judge = self._judge(grey=False)
        for picture, guide in self._seen(smoke, colours):
            yield float(judge(picture, guide))

    def _seen(self, smoke: "ActiveSmoke", colours: "Tensor") -> Any:
        from usdsmoke.core.colour import prepare_views
        from usdsmoke.core.style import decode_srgb

        targets = self._targets_of(Setting((1,), self._judge_config))
        if id(smoke) not in self._judged:  # those of ``_smokes``, which live as long as this does
            scene = self._scene
            views = prepare_views(smoke, self._views(), scene.gamma_w, scene.exposure)
            self._judged[id(smoke)] = views
        for seen in self._judged[id(smoke)]:
            yield seen.straight_picture(decode_srgb(colours), targets.background), seen.guide

    def _shape_losses(self, smoke: "ActiveSmoke", density: Any) -> Any:
        from usdsmoke.core.grey import look_at
        from usdsmoke.core.optics import opacity
        from usdsmoke.core.project import column_map
        from usdsmoke.core.smoke import activate

        scene, judge = self._scene, self._judge(grey=True)
        keep = self._judge_config.losses.keep
        moved = activate(density, np.eye(4), self._case.device)
        for view in self._views():
            still = column_map(smoke.positions, smoke.voxel_volume, view)
            look = look_at(still, smoke.density, None, scene.gamma_w_shape, scene.exposure_shape)
            image = column_map(moved.positions, moved.voxel_volume, view)
            columns = image.apply(moved.density[:, None])[..., 0]
            grey = opacity(scene.gamma_w_shape * columns) * scene.exposure_shape
            loss = judge(look.filled(grey, scene.grey_mean), look.guide)
            yield float(loss + keep * look.leaving(grey))

    def _judge(self, grey: bool) -> "PictureLoss":
        return self._targets_of(Setting((1,), self._judge_config)).at(1, grey=grey)

    def _views(self) -> Sequence["View"]:
        from usdsmoke.core.scene import frame_views

        views = replace(self._judge_config.views, pool=_N_JUDGES, sampling="poisson")
        config = replace(self._judge_config, views=views)
        return frame_views(self._case.small_smoke, config, self._scene, _JUDGE_SEED)

    def _scene_of(self, setting: Setting) -> "Scene":
        if setting.pixels == 1 and setting.refine == 1:
            return self._scene
        scale = setting.pixels / setting.refine
        return replace(
            self._scene,
            pixel_size=self._scene.pixel_size * scale,
            image_size=max(1, round(self._scene.image_size / scale)),
        )

    def _targets_of(self, setting: Setting) -> "StyleTargets":
        from usdsmoke.core.targets import StyleTargets

        scene, features = self._scene_of(setting), setting.config.features
        key = (scene.image_size, features.network, tuple(features.layers))
        if key not in self._targets:
            case = self._case
            self._targets[key] = StyleTargets(case.styles, scene, setting.config, case.device)
        return self._targets[key]

    def _smoke_of(self, setting: Setting, scene: "Scene") -> "ActiveSmoke":
        from usdsmoke.core.smoke import activate

        if setting.refine not in self._smokes:
            field = self._field_of(setting)
            self._smokes[setting.refine] = activate(field, np.eye(4), self._case.device)
        return self._smokes[setting.refine]

    def _field_of(self, setting: Setting) -> Any:
        from usdsmoke.core.refine import refine_field

        return refine_field(self._case.small.density, setting.refine)
