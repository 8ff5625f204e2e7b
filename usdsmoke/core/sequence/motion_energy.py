r"""The quadratic problem inside one warp of the motion estimate: its terms and its solver.

The unknown q [4 i j k] has three components of motion and, last, the relative change of density.
Lengths are in voxels of one common size; ``spacing`` is the distance between lattice points along
each axis in that unit. The energy is summed over lattice points:

    sum_x psi (J . dq + e)^2 + smoothness |grad q_motion|^2 + divergence (div q_motion)^2
        + gain_smoothness |grad q_gain|^2 + gain_size q_gain^2

Differences along an axis of length 1 are zero, so a slab one voxel thick is a plane. At the border
nothing is assumed: differences that would reach across it are left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

# Rows and columns of the ten different entries of a symmetric 4 x 4 matrix.
PAIRS = tuple((row, column) for row in range(4) for column in range(row, 4))


@dataclass(frozen=True)
class Prior:
    """Weights of the prior energy of a motion; all >= 0.

    Densities are scaled so that the smoke's root mean square is 1.
    """

    smoothness: float  # of the motion [Horn1981]
    divergence: float  # of the motion: smoke hardly changes its volume
    gain_smoothness: float  # of the relative change of density
    gain_size: float  # of the relative change of density


def central_difference(values: Tensor, axis: int) -> Tensor:
    """Half the difference of the two neighbours along a spatial axis; one-sided at the border.

    Args:
        values: [... I J K].
        axis: 0, 1, 2 for i, j, k.

    Gradients: through ``values``.
    """
    return _central(values, axis, border=1.0)


def apply_prior(motion: Tensor, prior: Prior, spacing: Sequence[float]) -> Tensor:
    """Half the gradient of the prior's energy at ``motion``, [4 i j k]; linear and symmetric.

    Args:
        motion: [4 i j k], see the module.
        prior: the weights.
        spacing: three distances between lattice points, > 0.

    Gradients: through ``motion``.
    """
    total = torch.zeros_like(motion)
    for axis in range(3):
        _add_second_difference(total, motion, axis, spacing[axis] ** -2)
    total[:3] *= prior.smoothness
    total[3] *= prior.gain_smoothness
    total[3] += prior.gain_size * motion[3]
    divergence = sum(central_difference(motion[a], a) / spacing[a] for a in range(3))
    for axis in range(3):
        # The adjoint of the central difference is minus the one that is odd at the border.
        slope = _central(torch.as_tensor(divergence), axis, border=-1.0)
        total[axis] -= (prior.divergence / spacing[axis]) * slope
    return total


def solve_increment(
    tensor: Tensor,
    slope: Tensor,
    motion: Tensor,
    prior: Prior,
    spacing: Sequence[float],
    n_iterations: int,
    tolerance: float,
) -> Tensor:
    """The dq that minimises the energy at motion + dq, [4 i j k], by conjugate gradients.

    Args:
        tensor: [10 i j k] sums of psi J J^T, the entries of ``PAIRS``.
        slope: [4 i j k] sums of psi J e.
        motion: [4 i j k], the motion so far.
        prior: its weights.
        spacing: three distances between lattice points.
        n_iterations: at most this many.
        tolerance: the residual's share at which it is enough, in the preconditioner's norm.
    """
    diagonal = tensor[[PAIRS.index((c, c)) for c in range(4)]]
    inverse = 1.0 / (diagonal + _prior_diagonal(motion, prior, spacing))

    def apply(vector: Tensor) -> Tensor:
        total = apply_prior(vector, prior, spacing)
        for entry, (row, column) in zip(tensor, PAIRS, strict=True):
            total[row].addcmul_(entry, vector[column])
            if row != column:
                total[column].addcmul_(entry, vector[row])
        return total

    right = -slope - apply_prior(motion, prior, spacing)
    return _conjugate_gradients(apply, right, inverse, n_iterations, tolerance)


def _conjugate_gradients(
    apply: Callable[[Tensor], Tensor],
    right: Tensor,
    inverse: Tensor,
    n_iterations: int,
    tolerance: float,
) -> Tensor:
    """Solves apply(x) = right from 0 with a diagonal preconditioner."""
    solution = torch.zeros_like(right)
    residual = right.clone()
    towards = direction = inverse * residual
    size = _dot(residual, towards)
    enough = tolerance**2 * float(size)
    for _ in range(n_iterations):
        if float(size) <= enough:  # also where there is nothing to do at all
            break
        image = apply(direction)
        step = size / _dot(direction, image)
        solution += step * direction
        residual -= step * image
        towards = inverse * residual
        before, size = size, _dot(residual, towards)
        direction = towards + (size / before) * direction
    return solution


def _prior_diagonal(motion: Tensor, prior: Prior, spacing: Sequence[float]) -> Tensor:
    """What the prior adds to the matrix's diagonal away from the border, [4 1 1 1] > 0."""
    long = [motion.shape[axis + 1] > 1 for axis in range(3)]
    second = sum(2.0 / spacing[axis] ** 2 for axis in range(3) if long[axis])
    weights = [
        prior.smoothness * second + (prior.divergence * 0.5 / spacing[a] ** 2 if long[a] else 0.0)
        for a in range(3)
    ]
    weights.append(prior.gain_smoothness * second + prior.gain_size)
    return motion.new_tensor(weights).clamp(min=1e-6)[:, None, None, None]


def _add_second_difference(total: Tensor, values: Tensor, axis: int, weight: float) -> None:
    """Adds D^T D along one axis, D the difference of neighbours inside the box."""
    dim = values.ndim - 3 + axis
    n = values.shape[dim]
    if n == 1:
        return
    step = (values.narrow(dim, 1, n - 1) - values.narrow(dim, 0, n - 1)) * weight
    total.narrow(dim, 1, n - 1).add_(step)
    total.narrow(dim, 0, n - 1).sub_(step)


def _central(values: Tensor, axis: int, border: float) -> Tensor:
    """Central differences of values continued by ``border`` times the outermost ones."""
    dim = values.ndim - 3 + axis
    n = values.shape[dim]
    if n == 1:
        return torch.zeros_like(values)
    first, last = border * values.narrow(dim, 0, 1), border * values.narrow(dim, n - 1, 1)
    padded = torch.cat((first, values, last), dim=dim)
    return 0.5 * (padded.narrow(dim, 2, n) - padded.narrow(dim, 0, n))


def _dot(left: Tensor, right: Tensor) -> Tensor:
    """The sum of products, row by row, so that its bits do not depend on the number of threads."""
    return (left * right).sum(dim=3).sum(dim=2).sum(dim=1).sum()
