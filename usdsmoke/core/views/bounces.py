"""Light that smoke scatters more than once, by a sum of six terms.

Light that is scattered k more times arrives as if from smoke ``SOFTER**k`` as thick, and as evenly
as g^(k+1) says:

    L = sum over k of (KEPT albedo s)^k p(g^(k+1)) T^(SOFTER^k)

with T the transmittance to the light, and s the share of light from all around that the smoke
around a point takes away. It is the sum of [Wrenninge2013], whose powers of a constant are those of
s here: thin smoke, and the surface of thick smoke, lose more of the light than the inside. The two
constants were fitted to a path tracer (``benchmarks/light_bounces.py``). Without albedo, or without
smoke around, the first term alone is left, which is light that is scattered once.
"""

import torch
from torch import Tensor

TERMS = 6
SOFTER = 0.8
KEPT = 0.9


def softer(shares: Tensor) -> Tensor:
    """Transmittance through smoke that is thinner term by term, [P K].

    Args:
        shares: transmittance of the smoke, [P] in [0, 1].
    """
    return torch.stack([shares, *(shares**SOFTER**k for k in range(1, TERMS))], 1)


def weights(albedo: float, seen: Tensor) -> Tensor:
    """What each term counts, [P K]; 1 for the first.

    Args:
        albedo: in [0, 1].
        seen: share of light from all around that arrives, [P] in [0, 1].
    """
    again = KEPT * albedo * (1 - seen)
    return torch.stack([again**k for k in range(TERMS)], 1)
