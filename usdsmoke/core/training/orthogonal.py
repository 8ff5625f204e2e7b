"""Steps of a training that turn a convolution's weights as a whole. [Jordan2024]

Adam moves every number by itself. The slopes of a convolution are nearly of low rank: few patterns
of features have most of them, and the others hardly learn. Here the running mean of a convolution's
slopes, as a matrix, is brought to singular values of 1, so all patterns learn alike, and no unit of
the slopes matters. Biases and the weights of the colours, which are few, go by Adam.
"""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from usdsmoke.core.steps.optimize import Adam

LEAP = 7.0  # step of a convolution: its largest singular value, in units of the rate
RECENT = 0.9  # share of the running mean of slopes that an iteration keeps
FLAT = 1e-5  # singular values below this share of the largest one are round-off


@dataclass
class Orthogonal(Adam):
    """Running means for a list of tensors; those of three axes [27 C D] are convolutions."""

    means: list[Tensor] = field(default_factory=list)

    def step(self, parameters: list[Tensor], gradients: list[Tensor], rate: float) -> None:
        """Moves the parameters in place by one step of size ``rate``."""
        pairs = list(zip(parameters, gradients, strict=True))
        turned = [(p, g) for p, g in pairs if p.dim() == 3]
        others = [(p, g) for p, g in pairs if p.dim() != 3]
        self.means = self.means or [torch.zeros_like(p) for p, _ in turned]
        for (p, slopes), mean in zip(turned, self.means, strict=True):
            mean.lerp_(slopes, 1 - RECENT)
            ahead = torch.lerp(slopes, mean, RECENT)  # [Nesterov1983]
            p.add_(orthogonal(ahead.view(-1, p.shape[2])).view_as(p), alpha=-LEAP * rate)
        super().step([p for p, _ in others], [g for _, g in others], rate)

    def restore(self, kept: Adam) -> None:
        """Takes over the means of another state."""
        super().restore(kept)
        if isinstance(kept, Orthogonal):
            self.means = [mean.clone() for mean in kept.means]


def orthogonal(matrix: Tensor) -> Tensor:
    """The matrix [M N] with singular values of 1, and 0 instead of what is round-off; M >= N.

    Computed in 64 bits on the CPU: N is small.
    """
    whole = matrix.detach().cpu().double()
    most = float(whole.abs().max())
    if most == 0:
        return matrix
    whole = whole / most
    squares, vectors = torch.linalg.eigh(whole.T @ whole)
    kept = squares > FLAT**2 * squares[-1]
    scale = torch.where(kept, squares, 1).rsqrt() * kept
    return (whole @ ((vectors * scale) @ vectors.T)).to(matrix)
