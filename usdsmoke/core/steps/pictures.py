"""The pictures that the steps compare: opacity of moving smoke in grey, painted smoke in colour.

Grey pictures need column sums only, which are linear in density. [Christen2020, eq. 9] A coloured
picture is a fixed sparse linear map of the voxel colours, computed once per view and octave.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic, TypeVar

import torch
from torch import Tensor

from usdsmoke.core.fields.sparse_image import SparseImage
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.memory import LazyList, accumulate
from usdsmoke.core.smoke.srgb import decode_srgb, encode_srgb
from usdsmoke.core.style.losses import Content
from usdsmoke.core.views.cameras import View, draw_views
from usdsmoke.core.views.lighting import Lighting
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.project import Shown, colour_map

THIN = 0.05  # exposed opacity at which the guidance mask is one half
BACKDROP = 0.2  # of that, where a pixel of the colour picture is half background: thin smoke that
# is seen mixed with it takes complementary tints, which cancel it and which the style does not have

AnyView = TypeVar("AnyView")


@dataclass(frozen=True)
class ViewPool(Generic[AnyView]):
    """The views of one octave, of which every iteration draws some."""

    views: Sequence[AnyView]
    n_drawn: int = 1  # in one iteration
    seed: int = 0  # of the order
    n_front: int | None = None  # views from where the result is looked at, the first; None: all

    @property
    def passage(self) -> int:
        """Iterations in which every view is drawn: the mean of their losses has no noise of views.

        With several views an iteration that do not divide the pool, some are drawn twice.
        """
        return -(-len(self.views) // min(self.n_drawn, len(self.views)))

    def prepare(self, n_iterations: int) -> None:
        """Make the views that so many iterations draw, shared among threads."""
        self._make(self._drawn(n_iterations))

    def drawn(self, n_iterations: int) -> list[AnyView]:
        """The views that so many iterations have drawn, each once."""
        return [self.views[number] for number in self._drawn(n_iterations)]

    def drawn_in_front(self, n_iterations: int) -> list[AnyView]:
        """Those of ``drawn`` from where the result is looked at."""
        numbers = self._drawn(n_iterations)
        return [self.views[n] for n in numbers if self.n_front is None or n < self.n_front]

    def _make(self, numbers: Sequence[int]) -> None:
        if isinstance(self.views, LazyList):
            self.views.prepare(numbers)

    def _drawn(self, n_iterations: int) -> list[int]:
        n, seen = min(self.n_drawn, len(self.views)), set[int]()
        for iteration in range(min(n_iterations, self.passage)):
            seen.update(draw_views(iteration, n, len(self.views), self.seed))
        return sorted(seen)

    def mean_loss(
        self, shared: Tensor, iteration: int, loss: Callable[[AnyView, Tensor], Tensor]
    ) -> Tensor:
        """Mean of ``loss(view, shared)`` over an iteration's views, in the memory of one view.

        Gradients: through ``shared``.
        """
        n = min(self.n_drawn, len(self.views))  # the same view twice adds nothing
        drawn = draw_views(iteration, n, len(self.views), self.seed)
        self._make(drawn)
        return accumulate(shared, [partial(loss, self.views[number]) for number in drawn]) / n


@dataclass(frozen=True)
class GreyView:
    """A view's sums over the voxels that smoke can come to, and the unmoved picture [H W]."""

    image: SparseImage
    gamma_w: float
    exposure: float
    grey: Tensor
    guide: Tensor  # T of the guidance mask, [H W]: 1 in all but the thinnest smoke, 0 outside
    content: Content | None = None

    def picture(self, density: Tensor) -> Tensor:
        """Exposed opacity [H W] of the density [N]."""
        return opacity(self.gamma_w * self.image.apply(density[:, None])[..., 0]) * self.exposure

    def over_grey(self, grey: Tensor, background: float) -> Tensor:
        """What the network sees, [H W 3]: a grey level beyond the silhouette instead of black.

        Against black the silhouette's edge is the strongest structure of the picture, and the
        optimiser sees little else.
        """
        seen = self.grey / (self.grey + THIN)
        return (grey + (1 - seen) * background)[..., None].expand(-1, -1, 3)

    def outside_change(self, grey: Tensor) -> Tensor:
        """Mean change of the picture where there was no smoke."""
        return ((grey - self.grey).abs() * (1 - self.grey).clamp_min(0)).mean()


def grey_view(
    image: SparseImage, density: Tensor, share: Tensor | None, gamma_w: float, exposure: float
) -> GreyView:
    """The view of unmoved density [N]; ``share`` [N] is the effect mask there."""
    columns = image.apply(density[:, None])[..., 0]
    grey = opacity(gamma_w * columns) * exposure
    guide = grey / (grey + THIN)
    if share is not None:
        masked = image.apply((density * share)[:, None])[..., 0]
        guide = guide * masked / columns.clamp_min(torch.finfo(columns.dtype).tiny)
    return GreyView(image, gamma_w, exposure, grey, guide)


@dataclass(frozen=True)
class ColourView:
    """A view's linear map from the painted voxels' colours to its picture."""

    image: SparseImage
    alpha: Tensor  # [H W], opacity of the painted smoke in this view
    thin: float = THIN  # opacity at which the guidance mask is one half
    content: Content | None = None
    scattered: Tensor | None = None  # [H W 3], light of the stage in the picture; None: none
    # [N 3], light of the stage that white voxels scatter to the eye; None: the colours are emitted.
    light: Tensor | None = None

    @property
    def guide(self) -> Tensor:
        """T of the guidance mask, [H W] in [0, 1): the share of smoke in the picture."""
        return self.alpha / (self.alpha + self.thin)

    def among(self, chosen: Tensor) -> "ColourView":
        """The same picture, of the colours of some voxels; [N] bool, with all that it shows."""
        if self.image.rows is None:
            return self
        place = torch.cumsum(chosen, 0) - 1
        rows, light = place[self.image.rows], self.light
        image = replace(self.image, rows=rows, n_voxels=int(chosen.sum()))
        return replace(self, image=image, light=None if light is None else light[chosen])

    def unpremultiplied(self, colours: Tensor, background: Tensor) -> Tensor:
        """Display-encoded picture [H W 3] of linear colours [N 3], divided by their opacity.

        Where there is (nearly) no smoke it tends to the linear background [3]. This is what the
        network sees: thin smoke is then painted like thick smoke. Seen through its opacity, it
        would have to take impossible colours to look like the style, and ends in tints that the
        style does not have.
        """
        return self.over(self.shown(colours), background)

    def picture(self, encoded: Tensor, background: Tensor) -> Tensor:
        """``unpremultiplied`` of display-encoded colours [N 3], without decoding what is hidden."""
        return self.over(self._shown(decode_srgb(self.image.pick(encoded))), background)

    def over(self, light: Tensor, background: Tensor) -> Tensor:
        """The same of the painted smoke's light in the picture, [H W 3]."""
        behind = BACKDROP * self.thin
        return encode_srgb((light + behind * background) / (self.alpha[..., None] + behind))

    def shown(self, colours: Tensor) -> Tensor:
        """Light of the painted smoke in the picture, [H W 3]."""
        return self._shown(self.image.pick(colours))

    def _shown(self, colours: Tensor) -> Tensor:
        """The same of the colours that can be seen, [M 3]."""
        if self.light is not None:
            colours = colours * self.image.pick(self.light)
        light = self.image.splat(colours)
        return light if self.scattered is None else light + self.scattered


def prepare_views(
    smoke: ActiveSmoke,
    views: Sequence[View],
    gamma_w: float,
    exposure: float = 1.0,
    share: Tensor | None = None,
    lighting: Lighting | None = None,
    faint: float = 0.0,
) -> LazyList[ColourView]:
    """The linear maps of all views of one octave, each made when it is first used.

    Args:
        smoke: all of it, painted or not.
        gamma_w: extinction per density, 1/stage unit.
        exposure: see ``Scene``.
        share: of the effect mask, see ``project.Shown``.
        lighting: light that the smoke scatters; it is fixed, and is projected once for each view.
        faint: see ``project.Shown``.
    """
    positions, step = smoke.positions, smoke.voxel_size
    painted = positions if share is None else positions[share > 0]
    lit = None if lighting is None else lighting.on(painted)

    def make(number: int) -> ColourView:
        image, alpha = colour_map(
            positions,
            smoke.density,
            smoke.edges,
            gamma_w,
            views[number],
            step,
            Shown(share, faint),
        )
        light = scattered = None
        if lit is not None:
            light = lit.scattered(views[number].forward)
        if light is not None and lighting is not None and not lighting.weighs_light:
            scattered, light = image.apply(light), None
        return ColourView(image, alpha, THIN / exposure, scattered=scattered, light=light)

    return LazyList(len(views), make)
