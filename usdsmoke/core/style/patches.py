"""How far patches of a picture are from the nearest ones of a style, and the style's from theirs.

Distributions of features tell how often something appears, and are content with mixtures that the
style has nowhere. The way to the nearest patch [Kwatra2005] is 0 only where every place of a
picture looks like some place of the style. The way back [Simakov2008] is 0 only where every place
of the style is found in the picture: without it, a picture may be of the style's simplest patches
alone. Patches are of pixels, not of features: those whose features agree may lack marks
(decision 090).
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.smoke.memory import chunks
from usdsmoke.core.style.quantiles import some_of
from usdsmoke.core.style.style_image import alpha_of, unless_small

SIDE = 7  # pixels of a patch
# patches of the style that are looked through, drawn at random of more; of a part of them, blurred
# patches find nearer ones than sharp ones do
MOST_STYLE = 50_000
FEWEST_STYLE = 500  # patches, of which some reach out of the areas that count where these are small
MOST_LOOKED_UP = 500  # patches of a picture in one draw, about; the others in the next ones
MOST_LOOKING_BACK = 500  # of the style in one draw, about: more would pull at each several times
AT_ONCE = 1024  # patches that are looked through at once: what is found stays in the cache
N_AXES = 32  # principal axes of the style's patches, along which the nearest one is looked for
COARSER = 3.0  # times the weight in coarser octaves, where it is decided what lies where
BACK = 1.0  # weight of the ways back
LEAST_SHARE = 0.5  # of a patch that is smoke; with less, it is left out
WHOLE = 0.5  # of a draw's largest weight; no way leads back to less, as at the rim of smoke
LEAST_SPREAD = 0.02  # of colours, display-encoded; with less, a style is one colour
_SLACK = 1e-4  # of a share: round-off
_ROUND = 1e-4  # of a way
_SHIFT = 618  # thousandths of the step along a row, by which the next row begins later


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
        known = self._along(self._patches)
        # what a picture's patch has beside the axes too is not known: along them alone
        self._known = _Along(known.short, 0.5 * known.short.square().sum(1))

    def loss(self, picture: Tensor, shares: Tensor, draw: int | Tensor = 0) -> Tensor:
        """The weighted sum of the ways there and back, scalar.

        Root mean squares of differences, in units of the deviation of the style's colours, over a
        draw of the picture's patches and of the style's. Small for the style itself, not 0: its
        patches are of one draw, and the nearest is looked for along the axes alone.

        Args:
            picture: [H W 3], display-encoded; 0 for one that is smaller than a patch.
            shares: of smoke in its patches, see ``patch_shares``.
            draw: which of the patches, e.g. the iteration: draws that follow each other take all of
                them. A tensor on a GPU, where nothing waits for a number.

        Gradients: through ``picture``, with the choice of the nearest held.
        """
        chosen, weights, n_draws = _choose(shares, draw)
        if len(chosen) == 0:
            return picture.sum() * 0
        width, n_across = picture.shape[1], shares.shape[1]
        places = chosen.div(n_across, rounding_mode="floor") * width + chosen % n_across
        found = _rows(picture.flatten(0, 1), _pixels_of(places, width).flatten())
        found = found.view(len(places), -1) * self._scale
        drawn = self._along(found.detach())
        there = (found - _rows(self._patches, drawn.nearest(self._known))).square().mean(1)
        total = weights.sum().clamp_min(LEAST_SHARE**2)  # that of any one
        way = _root((there * weights).sum() / total)
        if self._varies:
            n_turns = max(len(self._patches) // MOST_LOOKING_BACK, 1)
            # all of the style's meet all of the picture's: after the common multiple, one later
            turn = (draw + draw // _common_multiple(n_draws, n_turns)) % n_turns
            back = self._way_back(found, drawn.of_weight(weights), turn, n_turns)
            way = way + BACK * weights.any() * back
        return self._weight * way

    def _way_back(self, found: Tensor, drawn: "_Along", turn: int | Tensor, n_turns: int) -> Tensor:
        n = len(self._patches) // n_turns
        chosen = torch.arange(n, device=found.device) * n_turns + turn
        nearest = self._known.rows(chosen).nearest(drawn)
        return _root((_rows(found, nearest) - self._patches[chosen]).square().mean())

    def _along(self, patches: Tensor) -> "_Along":
        centred = patches - self._mean
        return _Along(centred @ self._axes, 0.5 * centred.square().sum(1))


@dataclass(frozen=True)
class _Along:
    """Patches along the axes [P n], and half of their squares [P], with what is beside the axes."""

    short: Tensor
    half_squares: Tensor

    def rows(self, chosen: Tensor | slice) -> "_Along":
        return _Along(self.short[chosen], self.half_squares[chosen])

    def of_weight(self, weights: Tensor) -> "_Along":
        """Those with little weight are no patch's nearest."""
        far = weights < WHOLE * weights.max()
        return _Along(self.short, self.half_squares.masked_fill(far, torch.inf))

    def nearest(self, others: "_Along") -> Tensor:
        """For each patch the row of the nearest of others, [P]."""
        device, n = self.short.device, len(self.short)
        if device.type != "cpu":
            return self._nearness(others).argmax(dim=1)
        memory = self.short.new_empty(n * AT_ONCE)
        best, rows = np.full(n, -np.inf), np.zeros(n, int)
        for part in chunks(len(others.short), AT_ONCE, device):
            some = others.rows(part)
            out = memory[: n * len(some.short)].view(n, -1)
            nearness = self._nearness(some, out).numpy()
            column = nearness.argmax(axis=1)  # in a ninth of torch's time
            value = np.take_along_axis(nearness, column[:, None], axis=1)[:, 0]
            is_nearer = value > best
            best[is_nearer], rows[is_nearer] = value[is_nearer], column[is_nearer] + part.start
        return torch.from_numpy(rows)

    def _nearness(self, others: "_Along", out: Tensor | None = None) -> Tensor:
        """[P Q]; the largest of a row is that of the nearest."""
        return torch.addmm(others.half_squares, self.short, others.short.T, beta=-1, out=out)


def patch_shares(guide: Tensor) -> Tensor:
    """How much of each patch of a picture is smoke, [H-6 W-6], in [0, 1].

    Args:
        guide: [H W] in [0, 1], where the smoke is.
    """
    if min(guide.shape) < SIDE:
        return guide.new_zeros([max(n - SIDE + 1, 0) for n in guide.shape])
    return F.avg_pool2d(guide[None, None], SIDE, stride=1)[0, 0]


def padded_shares(shares: Tensor, guide: Tensor) -> Tensor:
    """Shares of an enlarged picture, whose guide is given: patches that reach beyond the picture
    have no smoke."""
    height, width = (max(n - SIDE + 1, 0) for n in guide.shape)
    return F.pad(shares, (0, width - shares.shape[1], 0, height - shares.shape[0]))


def _drawn_places(style: Tensor, seed: int) -> Tensor:
    """First pixels of at most ``MOST_STYLE`` patches, in the areas that count."""
    height, width = style.shape[:2]
    alpha, n_across = unless_small(alpha_of(style)), width - SIDE + 1
    if alpha is None:
        places = some_of((height - SIDE + 1) * n_across, MOST_STYLE, seed)
    else:
        shares = patch_shares(alpha).flatten().cpu()
        n_whole = int((shares > 1 - _SLACK).sum())
        n_inside = max(n_whole, min(FEWEST_STYLE, int((shares > _SLACK).sum())))
        inside = shares.argsort(descending=True, stable=True)[:n_inside]
        places = inside[some_of(len(inside), MOST_STYLE, seed)]
    places = places.div(n_across, rounding_mode="floor") * width + places % n_across
    return places.to(style.device)


def _pixels_of(places: Tensor, width: int) -> Tensor:
    """The pixels [N SIDE*SIDE] of patches that begin at places [N] of a picture."""
    side = torch.arange(SIDE, device=places.device)
    return places[:, None] + (side[:, None] * width + side).flatten()


def _choose(shares: Tensor, draw: int | Tensor) -> tuple[Tensor, Tensor, int | Tensor]:
    """The patches of a draw, their weights, and after how many draws all have been drawn.

    Those of a draw lie on a lattice, or marks between them would not be seen.
    """
    enough, is_cpu = shares > LEAST_SHARE, shares.device.type == "cpu"
    n_enough: int | Tensor = int(enough.sum()) if is_cpu else enough.sum()
    n_draws = (n_enough + MOST_LOOKED_UP - 1) // MOST_LOOKED_UP
    n_draws = max(n_draws, 1) if isinstance(n_draws, int) else n_draws.clamp_min(1)
    shift = (_SHIFT * n_draws + 500) // 1000
    down, across = (torch.arange(n, device=shares.device) for n in shares.shape)
    lattice = (down[:, None] * shift + across) % n_draws
    is_drawn = (enough & (lattice == draw % n_draws)).flatten()
    weights = shares.square().flatten()
    if is_cpu:
        chosen = is_drawn.nonzero().squeeze(1)
        return chosen, weights[chosen], n_draws
    # always as many; those that fill up have no weight
    n = len(weights)
    place = torch.where(is_drawn, torch.arange(n, device=shares.device), n)
    chosen = place.sort().values[: 2 * MOST_LOOKED_UP]
    weights = F.pad(weights, (0, 1)).index_select(0, chosen)
    return chosen.clamp(max=max(n - 1, 0)), weights, n_draws


def _common_multiple(n: int | Tensor, m: int) -> int | Tensor:
    return math.lcm(n, m) if isinstance(n, int) else torch.lcm(n, torch.full_like(n, m))


def _root(square: Tensor) -> Tensor:
    """Rounded at 0, where a root has no slope."""
    return square / (torch.sqrt(square + _ROUND**2) + _ROUND)


def _rows(values: Tensor, rows: Tensor) -> Tensor:
    """Rows of [P C]; on a GPU, the slopes of many that are one are added in a fixed order."""
    return values.index_select(0, rows) if rows.device.type == "cpu" else values[rows]
