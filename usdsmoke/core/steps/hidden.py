"""Colours of voxels that hardly any light of an octave's pictures comes from."""

from collections.abc import Sequence

import torch
from torch import Tensor

from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.spread import spread_colours
from usdsmoke.core.steps.colour_rules import opacity_alone
from usdsmoke.core.steps.pictures import ColourView
from usdsmoke.core.views.scene import Scene

# share of a voxel's light in the view that sees most of it, where half of its colour is its
# neighbourhood's; a mean over views would blur whatever is hidden from the other side
DIM = 0.1


def trust_of(
    views: Sequence[ColourView],
    painted: ActiveSmoke,
    share: Tensor | None,
    scene: Scene,
    factor: int,
) -> Tensor:
    """How far the colour of each voxel is the pictures' own, [N] in [0, 1).

    Args:
        views: that the octave has drawn.
        painted: its painted voxels.
        share: the mask's values of all of its voxels; None without a mask.
        scene: of the frame.
        factor: the octave's pixels are this many times the scene's.
    """
    part = None if share is None else share[share > 0]
    seen = _seen(views, painted, part, scene, factor)
    return seen**2 / (seen**2 + DIM**2)


def complete(
    painted: ActiveSmoke,
    colours: Tensor,
    trust: Tensor,
    earlier: tuple[Tensor, Tensor] | None = None,
) -> tuple[Tensor, Tensor]:
    """Colours [N 3], those of hidden voxels from earlier octaves and from around them.

    Args:
        painted: the voxels.
        colours: [N 3], as the octave has left them.
        trust: see ``trust_of``.
        earlier: colours [N 3] that this octave has started from, and the trust in them, [N]; None
            where its views see all that those before it have seen.

    Returns:
        Also the trust in what is painted, [N].
    """
    if earlier is not None:
        known, before = earlier
        rest = (1 - trust) * before
        total = trust + rest
        tiny = torch.finfo(total.dtype).tiny
        colours = torch.lerp(known, colours, (trust / total.clamp_min(tiny))[:, None])
        trust = total
    return spread_colours(painted, colours, trust), trust


def _seen(
    views: Sequence[ColourView],
    painted: ActiveSmoke,
    share: Tensor | None,
    scene: Scene,
    factor: int,
) -> Tensor:
    """The share of each voxel's light that reaches the picture that it reaches best, [N]; >= 0.

    About the transmittance in front of it; 1 is a voxel by itself with nothing in front.
    """
    light = _reaching(views[0])
    for view in views[1:]:
        light = torch.maximum(light, _reaching(view))
    alone = opacity_alone(painted, scene) * (painted.voxel_size / (factor * scene.pixel_size)) ** 2
    alone = alone if share is None else alone * share
    return light / alone.clamp_min(torch.finfo(light.dtype).tiny)


def _reaching(view: ColourView) -> Tensor:
    """How much of each voxel's colour reaches a picture, [N]; in the dark an albedo hardly does."""
    weight = view.image.total_weights()
    return weight if view.light is None else weight * view.light.mean(dim=1).clamp(max=1)
