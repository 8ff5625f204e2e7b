"""The sweep over feature networks: embedded features against VGG-19, measured by neither."""

from typing import TYPE_CHECKING, Any

from usdsmoke.base.errors import FeatureError
from usdsmoke.core.style.layers import find_vgg19_file, named_vgg19_file
from usdsmoke.planning.plan import Plan as RunPlan
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.engine import Sweep
from usdsmoke.work_precision.records import Plan
from usdsmoke.work_precision.trial import Setting, Trial, base_iterations, scaled

if TYPE_CHECKING:
    from torch import Tensor

_SHARES = (1.0, 0.5, 2.0)
_PATCH = 7  # pixels
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
    from usdsmoke.core.style.vgg19 import Vgg19Features

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
    for share in _SHARES:
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

    from usdsmoke.core.smoke.srgb import scale_style

    style = scale_style(
        case.styles[0], case.small_scene.image_size, case.config.style, torch.zeros(())
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
    found, exact = (torch.quantile(p[:20000] @ ways, levels, dim=0) for p in (patches, style))
    return float((found - exact).square().mean().sqrt())


NETWORK = Sweep("network", "Embedded features against VGG-19", _applies, _plan)
