"""Everything that a picture of the smoke is judged by, at one octave."""

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from usdsmoke.base.sections import LossesConfig
from usdsmoke.core.smoke.srgb import luminance
from usdsmoke.core.style.content import laplacian_distance, photorealism_distance
from usdsmoke.core.style.losses import StyleTarget, total_variation

__all__ = ["Content", "PictureLoss"]


@dataclass(frozen=True)
class Content:
    """What is kept of a view's content picture: the smoke's own, before anything is done to it."""

    grey: Tensor  # [H W 3], three equal channels
    maps: tuple[dict[str, Tensor], ...]  # by style image: the embedded network depends on it


class PictureLoss:
    """Weighted sum of the losses of a picture; what has weight 0 is not evaluated.

    The content is a grey picture. Features and edges are compared with those of the picture's
    luminance, so that they keep light and dark and leave the colours to the style.

    Args:
        targets: one for each style image.
        shares: of the style images, adding up to 1.
        losses: the other weights.
    """

    def __init__(
        self, targets: Sequence[StyleTarget], shares: Sequence[float], losses: LossesConfig
    ) -> None:
        self._targets = tuple(zip(shares, targets, strict=True))
        self._losses = losses

    @property
    def wants_content(self) -> bool:
        """Whether any loss looks at the content picture."""
        losses = self._losses
        return losses.content > 0 or losses.laplacian > 0 or losses.photorealism > 0

    def remember(self, grey: Tensor) -> Content:
        """What has to be known of a content picture [H W 3], display-encoded grey."""
        wanted = self._targets if self._losses.content else ()
        return Content(grey, tuple(target.content(grey) for _, target in wanted))

    def __call__(
        self, picture: Tensor, guide: Tensor, content: Content | None = None, draw: int = 0
    ) -> Tensor:
        """The loss of a picture, a scalar.

        Args:
            picture: [H W 3], display-encoded.
            guide: T of the guidance mask, [H W] in [0, 1].
            content: from ``remember``; None leaves out the losses that need it.
            draw: picks random directions where a loss has any, e.g. the iteration.

        Gradients: through ``picture``.
        """
        total = picture.new_zeros(())
        for share, target in self._targets:
            total = total + share * target.loss(picture, guide, draw)
        if self._losses.total_variation:
            total = total + self._losses.total_variation * total_variation(picture)
        return total if content is None else total + self._kept(picture, guide, content)

    def _kept(self, picture: Tensor, guide: Tensor, content: Content) -> Tensor:
        losses, total = self._losses, picture.new_zeros(())
        grey = luminance(picture)[..., None].expand(-1, -1, 3)
        if losses.content:
            for (share, target), maps in zip(self._targets, content.maps, strict=True):
                total = total + share * losses.content * target.kept(grey, maps, guide)
        if losses.laplacian:
            total = total + losses.laplacian * laplacian_distance(grey, content.grey, guide)
        if losses.photorealism:
            distance = photorealism_distance(picture, content.grey, guide)
            total = total + losses.photorealism * distance
        return total
