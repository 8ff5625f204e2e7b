"""Grey pictures of moving smoke: opacity, from column sums alone. [Christen2020, eq. 9]"""

from dataclasses import dataclass

import torch
from torch import Tensor

from usdsmoke.core.style.picture_loss import Content
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.project import SparseImage

__all__ = ["GreyView", "look_at"]

THIN = 0.05  # exposed opacity at which the guidance mask is one half


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

    def filled(self, grey: Tensor, behind: float) -> Tensor:
        """What the network sees, [H W 3]: a grey level beyond the silhouette instead of black.

        Against black the silhouette's edge is the strongest structure of the picture, and the
        optimiser sees little else.
        """
        seen = self.grey / (self.grey + THIN)
        return (grey + (1 - seen) * behind)[..., None].expand(-1, -1, 3)

    def leaving(self, grey: Tensor) -> Tensor:
        """Mean change of the picture where there was no smoke."""
        return ((grey - self.grey).abs() * (1 - self.grey).clamp_min(0)).mean()


def look_at(
    image: SparseImage, density: Tensor, shown: Tensor | None, gamma_w: float, exposure: float
) -> GreyView:
    """The view of unmoved density [N]; ``shown`` [N] is the effect mask there."""
    columns = image.apply(density[:, None])[..., 0]
    grey = opacity(gamma_w * columns) * exposure
    guide = grey / (grey + THIN)
    if shown is not None:
        masked = image.apply((density * shown)[:, None])[..., 0]
        guide = guide * masked / columns.clamp_min(torch.finfo(columns.dtype).tiny)
    return GreyView(image, gamma_w, exposure, grey, guide)
