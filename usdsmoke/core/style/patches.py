"""How far patches of a picture are from the nearest ones of a style, and the style's from theirs.

Distributions of features tell how often something appears, and are content with mixtures that the
style has nowhere. The way to the nearest patch [Kwatra2005] is 0 only where every place of a
picture looks like some place of the style. The way back [Simakov2008] is 0 only where every place
of the style is found in the picture: without it, a picture may be of the style's simplest patches
alone. Patches are of pixels, not of features: those whose features agree may lack marks
(decision 090).
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.style.style_image import alpha_of, unless_small

SIDE = 7  # pixels of a patch
MOST_STYLE = 3000  # patches of the style that are looked through, drawn at random
MOST_LOOKED_UP = 1500  # patches of a picture in one draw; the others in the next ones
N_AXES = 32  # principal axes of the style's patches, along which the nearest one is looked for
COARSER = 3.0  # times the weight in coarser octaves, where it is decided what lies where
BACK = 1.0  # weight of the ways back
LEAST_WEIGHT = 0.25  # of a patch: the square of the smoke's share; with less, it is left out
WHOLE = 0.5  # of a draw's largest weight; no way leads back to less, as at the rim of smoke
LEAST_SPREAD = 0.02  # of colours, display-encoded; with less, a style is one colour
_SLACK = 1e-4  # of a share: round-off
_ROUND = 1e-4  # of a way


class StylePatches:
    """Patches of one style image at one size.

    Args:
        style: [H W 3], display-encoded, at least ``SIDE`` pixels wide and high; or [H W 4], whose
            alpha is 1 in the areas that count.
        weight: of the loss.
        seed: of the patches that are drawn.
    """

    def __init__(self, style: Tensor, weight: float = 1.0, seed: int = 0) -> None:
        self._weight = weight
        pixels, width = style[..., :3].flatten(0, 1), style.shape[1]
        places = _drawn_places(style, seed)
        patches = pixels[_pixels_of(places, width)].flatten(1)  # [S D], D = SIDE * SIDE * 3
        spread = float(patches.view(-1, 3).std(0, correction=0).mean())
        self._varies, self._scale = spread > LEAST_SPREAD, 1 / max(spread, LEAST_SPREAD)
        self._patches = patches * self._scale
        self._mean = self._patches.mean(0)
        centred = (self._patches - self._mean).cpu().double()
        _, vectors = torch.linalg.eigh(centred.T @ centred)
        self._axes = vectors[:, -N_AXES:].to(style).contiguous()  # [D n]
        self._short = self._along(self._patches)  # [S n]

    def loss(self, picture: Tensor, guide: Tensor | None, draw: int | Tensor = 0) -> Tensor:
        """The weighted sum of the ways there and back, scalar; 0 for the style itself.

        Root mean squares of differences, in units of the deviation of the style's colours: over a
        draw of the picture's patches, and over every other one of the style's, in turns.

        Args:
            picture: [H W 3], display-encoded; 0 for one that is smaller than a patch.
            guide: [H W] in [0, 1], where the smoke is; None is 1 everywhere.
            draw: which of the patches, e.g. the iteration: draws that follow each other take all of
                them. A tensor on a GPU, where nothing waits for a number.

        Gradients: through ``picture``, with the choice of the nearest held.
        """
        height, width = picture.shape[:2]
        if min(height, width) < SIDE:
            return picture.sum() * 0
        guide = torch.ones_like(picture[..., 0]) if guide is None else guide
        share = F.avg_pool2d(guide[None, None], SIDE, stride=1)[0, 0]
        chosen, weights = _choose(share.square().flatten(), draw)
        if len(chosen) == 0:
            return picture.sum() * 0
        n_across = width - SIDE + 1
        places = chosen.div(n_across, rounding_mode="floor") * width + chosen % n_across
        found = _rows(picture.flatten(0, 1), _pixels_of(places, width).flatten())
        found = found.view(len(places), -1) * self._scale
        short = self._along(found.detach())
        there = (found - _rows(self._patches, _nearest(short, self._short))).square().mean(1)
        total = weights.sum().clamp_min(LEAST_WEIGHT)  # that of any one
        way = _root((there * weights).sum() / total)
        if self._varies:
            way = way + BACK * self._way_back(found, short, weights, draw)
        return self._weight * way

    def _way_back(
        self, found: Tensor, short: Tensor, weights: Tensor, draw: int | Tensor
    ) -> Tensor:
        n = len(self._patches)
        turn = torch.arange((n + 1) // 2, device=found.device) * 2 + draw % 2
        turn = turn.clamp_max(n - 1)
        nearest = _nearest(self._short[turn], short, weights)
        back = (_rows(found, nearest) - self._patches[turn]).square().mean()
        return _root(back * weights.any())

    def _along(self, patches: Tensor) -> Tensor:
        return (patches - self._mean) @ self._axes


def _drawn_places(style: Tensor, seed: int) -> Tensor:
    """First pixels of at most ``MOST_STYLE`` patches, which lie in the areas that count as far as
    any do."""
    height, width = style.shape[:2]
    alpha, n_across = unless_small(alpha_of(style)), width - SIDE + 1
    if alpha is None:
        places = torch.arange((height - SIDE + 1) * n_across)
    else:
        share = F.avg_pool2d(alpha[None, None], SIDE, stride=1).flatten()
        places = (share >= share.max() - _SLACK).nonzero().squeeze(1).cpu()
    generator = torch.Generator().manual_seed(seed)
    places = places[torch.randperm(len(places), generator=generator)[:MOST_STYLE]]
    places = places.div(n_across, rounding_mode="floor") * width + places % n_across
    return places.to(style.device)


def _pixels_of(places: Tensor, width: int) -> Tensor:
    """The pixels [N SIDE*SIDE] of patches that begin at places [N] of a picture."""
    side = torch.arange(SIDE, device=places.device)
    return places[:, None] + (side[:, None] * width + side).flatten()


def _choose(weights: Tensor, draw: int | Tensor) -> tuple[Tensor, Tensor]:
    """The patches of a draw, and their weights."""
    if weights.device.type != "cpu":
        return _choose_as_many(weights, draw)
    chosen = (weights > LEAST_WEIGHT).nonzero().squeeze(1)
    n_draws = max(-(-len(chosen) // MOST_LOOKED_UP), 1)
    chosen = chosen[draw % n_draws :: n_draws]
    return chosen, weights[chosen]


def _choose_as_many(weights: Tensor, draw: int | Tensor) -> tuple[Tensor, Tensor]:
    """The same, always as many; those that fill up have the weight 0."""
    n, enough = len(weights), weights > LEAST_WEIGHT
    rank = torch.cumsum(enough, 0) - 1
    n_draws = torch.div(rank[-1] + MOST_LOOKED_UP, MOST_LOOKED_UP, rounding_mode="floor")
    n_draws = n_draws.clamp_min(1)
    is_drawn = enough & (rank % n_draws == draw % n_draws)
    place = torch.where(is_drawn, torch.arange(n, device=weights.device), n)
    chosen = place.sort().values[:MOST_LOOKED_UP]
    weights = F.pad(weights, (0, 1)).index_select(0, chosen)
    return chosen.clamp(max=n - 1), weights


@torch.no_grad()
def _nearest(values: Tensor, others: Tensor, weights: Tensor | None = None) -> Tensor:
    """For each row [P n] the nearest of others [S n], of those with enough weight [S]."""
    half_squares = 0.5 * others.square().sum(1)
    if weights is not None:
        half_squares.masked_fill_(weights < WHOLE * weights.max(), torch.inf)
    nearness = torch.addmm(half_squares, values, others.T, beta=-1)
    if nearness.device.type == "cpu":  # NumPy takes a ninth of the time
        return torch.from_numpy(nearness.numpy().argmax(axis=1))
    return nearness.argmax(dim=1)


def _root(square: Tensor) -> Tensor:
    """Rounded at 0, where a root has no slope."""
    return square / (torch.sqrt(square + _ROUND**2) + _ROUND)


def _rows(values: Tensor, rows: Tensor) -> Tensor:
    """Rows of [P C]; on a GPU, the slopes of many that are one are added in a fixed order."""
    return values.index_select(0, rows) if rows.device.type == "cpu" else values[rows]
