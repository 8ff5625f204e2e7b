"""Whether two transforms are the same."""

import numpy as np
import pytest
from pxr import Gf

from usdsmoke.base.volume import is_same_transform


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e5])
def test_rounding_of_a_turn_is_forgiven(size: float) -> None:
    turned = np.array(Gf.Matrix4d(Gf.Rotation(Gf.Vec3d(0, 0, 1), 90), Gf.Vec3d(size)))
    exact = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [size, size, size, 1.0]])
    assert (turned != exact).any()
    assert is_same_transform(turned, exact) and is_same_transform(exact, turned)


@pytest.mark.parametrize(("place", "change"), [((0, 1), 1e-6), ((2, 2), 1e-6), ((3, 1), 1e-5)])
def test_a_small_change_is_told_also_far_from_the_origin(
    place: tuple[int, int], change: float
) -> None:
    matrix = np.diag([0.1, 0.1, 0.1, 1.0])
    matrix[3, :3] = (1000.0, 0.0, -2.0)
    moved = matrix.copy()
    moved[place] += change
    assert not is_same_transform(matrix, moved)
