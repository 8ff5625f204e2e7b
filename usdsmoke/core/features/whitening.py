"""The colour axes of a style image: what networks see of colours."""

import torch
from torch import Tensor


def colour_whitening(pixels: Tensor, floor: float, relative: float = 0.0) -> tuple[Tensor, Tensor]:
    """Mean [3] and ZCA matrix [3 3] of colours [... 3].

    W = U diag((e + max(floor, relative * e_max))^-1/2) U^T with the covariance's eigenvalues e and
    eigenvectors U. The floors keep directions that the style hardly has from being blown up:
    without them a two-colour style gets green and yellow tints, and a constant one divides by zero.
    """
    flat = pixels.reshape(-1, 3).double()
    mean = flat.mean(0)
    centred = flat - mean
    covariance = centred.T @ centred / max(len(flat), 1)
    values, vectors = torch.linalg.eigh(covariance)
    values = values.clamp_min(0)
    least = (relative * values[-1]).clamp_min(floor)
    matrix = vectors @ torch.diag((values + least).rsqrt()) @ vectors.T
    return mean.to(pixels.dtype), matrix.to(pixels.dtype)
