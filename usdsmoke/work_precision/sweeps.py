"""Sweeps over one step's own settings: iterations, views, octaves, resolution, networks.

Embedded features and VGG-19 are compared by a measure that is neither's own.
"""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from usdsmoke.base.errors import FeatureError
from usdsmoke.core.features.layers import find_vgg19_file, named_vgg19_file
from usdsmoke.core.smoke.schedule import has_one_view
from usdsmoke.planning.plan import Plan as RunPlan
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.engine import Sweep
from usdsmoke.work_precision.records import Plan, Task
from usdsmoke.work_precision.trial import (
    EXCESS,
    N_RUNS,
    Setting,
    Trial,
    base_iterations,
    copy_text,
    main_step,
    need_seconds,
    reference_of,
    reference_seconds,
    scaled,
    trial_seconds,
)

if TYPE_CHECKING:
    from torch import Tensor


_SHARES = (0.5, 2.0, 0.25)  # of the iterations
_TOLERANCES = (5e-2, 1e-2, 0.0)
_POOLS, _COUNTS = (1, 4, 64, 32), (2, 4)
_MOST_OCTAVES = 5
_LEAST_PIXELS = 16  # of a picture
_COARSER, _FINER = 0.8, 3.0  # time of half and of twice the resolution

# curve, label, setting, share of a configured run's time
Choice = tuple[str, str, Setting, float]


def _against_reference(case: Case, step: str, choices: Sequence[Choice], about: str) -> Plan:
    """Trials of one step, the configured one first, measured against the reference."""
    reference = reference_of(case, step)
    return Plan(
        [
            reference.trial.task(curve, label, setting, number == 0, effort, reference.error)
            for number, (curve, label, setting, effort) in enumerate(choices)
        ],
        EXCESS,
        f"The {step} step on {copy_text(case)}, {sum(base_iterations(case, step))} iterations as "
        f"configured. {about}",
        reference.text,
        uncertain=reference.apart,
        n_runs=N_RUNS,
        rate=trial_seconds(case, step),
    )


def _need_reference(case: Case, step: str, runs: float = 3.0) -> None:
    seconds = reference_seconds(case, step) + runs * N_RUNS * trial_seconds(case, step)
    need_seconds(case, "two reference runs and three settings", seconds)


def _no_style(case: Case) -> str:
    return "losses.style is 0: nothing is optimised" if case.config.losses.style == 0 else ""


def _without_step(step: str, case: Case) -> str:
    return _no_style(case) if step in case.steps else f"optimize.steps has no {step}"


def _iterations(step: str, case: Case) -> Plan:
    _need_reference(case, step, 1.75)
    base, config = base_iterations(case, step), case.config

    def by_share(share: float) -> Choice:
        per_octave = scaled(base, share)
        label = f"{sum(per_octave)} iterations ({share:g}x)"
        return "iterations", label, Setting(per_octave, config), share

    def by_rule(value: float) -> Choice:
        own = config.replace(optimize=config.optimize.replace(tolerance=value))
        label = f"optimize.tolerance={value:g}" if value else "no rule (optimize.tolerance=0)"
        return "stopping rule", label, Setting(base, own), 1.0

    rules = [by_rule(value) for value in _TOLERANCES if value != config.optimize.tolerance]
    half, double, quarter = map(by_share, _SHARES)
    choices = [by_share(1.0), half, rules[0], double, *rules[1:], quarter]
    about = (
        "Labels say how many iterations were done where optimize.tolerance stopped an octave. "
        "Runs differ in their seeds, so loss and time both spread."
    )
    return _against_reference(case, step, choices, about)


def _views(case: Case) -> Plan:
    step, config = main_step(case), case.config
    base, pool = base_iterations(case, step), config.views.pool
    need_seconds(case, "three points", 3 * N_RUNS * trial_seconds(case, step))
    trial = Trial(case, step, config)
    tasks: list[Task] = []
    for n in (pool, *(n for n in _POOLS if n != pool)):
        own = config if n == pool else config.replace(views=config.views.replace(pool=n))
        setting, label, error = Setting(base, own), f"views.pool={n}", trial.unseen.gap
        tasks.append(trial.task("views in the pool", label, setting, n == pool, 1.0, error))
    return Plan(
        tasks,
        "style loss of unused views: distance from that of the pool's own views",
        f"The {step} step on {copy_text(case)}, {sum(base)} iterations as configured. A small pool "
        "fits its own views and no others. A run reports the same error as “unseen views”.",
        "0, a result that looks as good from everywhere. Single views differ, so the measure does "
        "not reach 0; its standard error over the views is its uncertainty.",
        chance=trial.unseen.chance,
        n_runs=N_RUNS,
        rate=trial_seconds(case, step),
    )


def _single_sided(case: Case) -> str:
    if case.small_smoke.thin_axis is not None:
        return "the smoke is one voxel thick and is seen from one side only"
    if has_one_view(case.config.views):
        return "views.azimuth and views.elevation are 0: the smoke is seen from one side only"
    return _no_style(case)


def _views_count(case: Case) -> Plan:
    step, views = main_step(case), case.config.views
    _need_reference(case, step)
    base = base_iterations(case, step)

    def with_count(count: int) -> Choice:
        if count == views.count:
            label, setting = f"views.count={count}, as configured", Setting(base, case.config)
        else:
            fewer = scaled(base, views.count / count)
            label = f"views.count={count}, {sum(fewer)} iterations: as many pictures"
            setting = Setting(fewer, case.config.replace(views=views.replace(count=count)))
        return "views per iteration", label, setting, 1.0

    counts = dict.fromkeys((views.count, 1, *_COUNTS))
    about = (
        "More views per iteration give a better direction; the number of pictures is the same, so "
        "there are fewer iterations."
    )
    return _against_reference(case, step, [with_count(count) for count in counts], about)


def _octaves(case: Case) -> Plan:
    step = main_step(case)
    _need_reference(case, step)
    base, config, size = base_iterations(case, step), case.config, case.small_scene.image_size
    choices: list[Choice] = [("octaves", _octaves_text(base), Setting(base, config), 1.0)]
    numbers = {1, 2, len(base) - 1, len(base) + 1} - {0, len(base)}
    for n in sorted(numbers, key=lambda n: abs(n - len(base))):
        if n <= _MOST_OCTAVES:
            even = tuple(max(1, sum(base) // n) for _ in range(n))
            effort = _effort(even) / _effort(base)
            choices.append(("octaves", _octaves_text(even), Setting(even, config), effort))
    if size // 2 >= _LEAST_PIXELS:
        label = f"pictures of {round(size / 2)} pixels"
        coarser = Setting(base, config, pixels=2)
        choices.insert(2, ("finest resolution", label, coarser, _COARSER))
    label = f"pictures of {2 * size} pixels, grids.refine={2 * config.grids.parts}"
    choices.append(("finest resolution", label, Setting(base, config, refine=2), _FINER))
    about = (
        "Pictures of half and double the size represent half and double views.image_size. All "
        f"results are measured in pictures of {size} pixels, where finer detail is blurred. The "
        "references have the configured octaves."
    )
    return _against_reference(case, step, choices, about)


def _octaves_text(per_octave: Sequence[int]) -> str:
    noun = "octave" if len(per_octave) == 1 else "octaves"
    return f"{len(per_octave)} {noun} ({', '.join(map(str, per_octave))})"


def _effort(per_octave: Sequence[int]) -> float:
    """Small pictures take nearly as long as large ones, because of the network's calls."""
    return sum(n * (1.0 + 0.5 * 4.0 ** (k + 1 - len(per_octave))) for k, n in enumerate(per_octave))


ITERATIONS = tuple(
    Sweep(
        f"iterations_{step}",
        f"Iterations and stopping rule, {step} step",
        partial(_without_step, step),
        partial(_iterations, step),
    )
    for step in ("colour", "shape")
)
VIEWS = Sweep("views", "Views in the pool", _single_sided, _views)
VIEWS_COUNT = Sweep("views_count", "Views per iteration", _single_sided, _views_count)
OCTAVES = Sweep("octaves", "Octaves and finest resolution", _no_style, _octaves)


_NETWORK_SHARES = (1.0, 0.5, 2.0)  # of the iterations
_PATCH = 7  # pixels
_MOST_PATCHES = 20_000  # that are compared, evenly spaced
_N_DIRECTIONS = 64


def check_network(plan: RunPlan) -> None:
    """Refuse a named VGG-19 file that cannot be used, before anything is measured.

    Raises:
        FeatureError: it is missing, or cannot be read.
    """
    files = {
        config.features.vgg19_file
        for config in (volume.config for volume in plan.volumes)
        if config.features.network == "vgg19"
        or ("colour" in config.optimize.steps and config.losses.style > 0
            and named_vgg19_file(config.features.vgg19_file))
    }  # fmt: skip
    for configured in sorted(files):
        _load(configured)


def _load(configured: str) -> None:
    from usdsmoke.core.features.vgg19 import Vgg19Features

    Vgg19Features.from_file(configured)


def _applies(case: Case) -> str:
    if "colour" not in case.steps:
        return "optimize.steps has no colour, and colour patches are what is compared"
    if case.config.losses.style == 0:
        return "losses.style is 0: no network is evaluated"
    configured = case.config.features.vgg19_file
    try:
        find_vgg19_file(configured)
    except FeatureError:
        return (
            "no weights of VGG-19 were given (features.vgg19_file) to compare the embedded "
            "features with"
        )
    if not named_vgg19_file(configured):  # a file in torch's cache that the user has not named
        try:
            _load(configured)
        except FeatureError as error:
            return str(error)
    return ""


def _plan(case: Case) -> Plan:
    base = base_iterations(case, "colour")
    trial = Trial(case, "colour", case.config)
    style = _style_patches(case)

    def error(result: Any) -> float:
        found = [patch_distance(seen, style) for seen in trial.unseen.pictures(result)]
        return sum(found) / len(found)

    tasks = []
    for share in _NETWORK_SHARES:
        for network in ("embedded", "vgg19"):
            chosen = case.config.features.network
            own = case.config.features
            if network != chosen:  # its layers would mean nothing to the other network
                own = own.replace(network=network, layers=[], weights=[], content_layers=[])
            setting = Setting(scaled(base, share), case.config.replace(features=own))
            label = f"{network}, {sum(setting.per_octave)} iterations"
            configured = share == 1.0 and network == chosen
            tasks.append(trial.task(network, label, setting, configured, share, error))
    return Plan(
        tasks,
        "distance of colour patches from the style's",
        "The colour step on the small copy of the frame with either network. Losses of different "
        "networks cannot be compared, so the error is the distance between the distributions of "
        f"{_PATCH} x {_PATCH} pixel patches (sliced Wasserstein), which neither network minimises.",
        "0 is the distance of the style image from itself.",
    )


def _style_patches(case: Case) -> "Tensor":
    """Patches of the first style at the pictures' size, [N D]."""
    import torch

    from usdsmoke.core.steps.targets import sized_style
    from usdsmoke.core.style.style_image import scale_style

    scene, like = case.small_scene, torch.zeros(())
    style = scale_style(
        case.styles[0], scene.image_size, sized_style(case.config.style, scene), like
    )
    return _patches(torch.cat([style, torch.ones_like(style[..., :1])], dim=-1))


def _patches(seen: "Tensor") -> "Tensor":
    """Patches of a picture whose middle lies in its smoke, [N 147], of [H W 4].

    All of them where there is so little smoke that no middle does.
    """
    import torch.nn.functional as F

    columns = F.unfold(seen.permute(2, 0, 1)[None].cpu(), _PATCH)[0].T
    colours, guide = columns[:, : -(_PATCH**2)], columns[:, -(_PATCH**2) :]
    inside = guide[:, _PATCH**2 // 2] > 0.5
    return colours[inside] if bool(inside.any()) else colours


def patch_distance(seen: "Tensor", style: "Tensor") -> float:
    """Sliced Wasserstein distance of a picture's patches from the style's; 0 for the style itself.

    Args:
        seen: [H W 4], picture and guide.
        style: patches [N D].
    """
    import torch

    patches = _patches(seen)
    generator = torch.Generator().manual_seed(0)
    ways = torch.randn(style.shape[1], _N_DIRECTIONS, generator=generator)
    ways = ways / ways.norm(dim=0)
    levels = torch.linspace(0.005, 0.995, 100)
    found, exact = (
        torch.quantile(p[:: -(-len(p) // _MOST_PATCHES)] @ ways, levels, dim=0)
        for p in (patches, style)
    )
    return float((found - exact).square().mean().sqrt())


NETWORK = Sweep("network", "Embedded features against VGG-19", _applies, _plan)
