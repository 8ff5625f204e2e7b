"""The potential on the voxels that count is the one on the whole box, and so are its gradients."""

from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from tests.fixtures.smoke_fixtures import affine, puff, smoke_of
from usdsmoke.core.fields.displacement import SparseDisplacement, slope_matrix
from usdsmoke.core.fields.lattice import Lattice, grow, surround
from usdsmoke.core.fields.potential import border_mask, unclamped_displacement
from usdsmoke.core.fields.pyramid import SparsePyramid, expand_levels, pyramid_shapes
from usdsmoke.core.fields.resample import interpolation_matrix
from usdsmoke.core.fields.sparse_map import AxisMatrix, Nodes, map_along, nodes_read

CHANNELS = {"stream": 3, "potential": 1, "mixed": 4}
LEVELS = 5
#: name: shape, share of the voxels with an effect
BOXES = {
    "even": ((16, 16, 32), 0.3),
    "odd": ((13, 17, 22), 0.3),
    "thin": ((40, 9, 33), 0.01),
    "full, to the border": ((11, 12, 14), 1.0),
    "nothing": ((9, 10, 11), 0.0),
    "two voxels": ((2, 7, 6), 0.5),
    "slab": ((1, 20, 13), 0.3),
    "slab across j": ((9, 1, 14), 1.0),
    "slab across k": ((12, 11, 1), 0.1),
    "line": ((1, 1, 9), 0.6),
    "one voxel": ((1, 1, 1), 1.0),
}


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def lattice_of(shape: tuple[int, int, int]) -> Lattice:
    low = torch.zeros(3, dtype=torch.int64).numpy()
    return Lattice(low, shape, affine(1))


def compare(effect: Tensor, active: Tensor, kind: str, n_channels: int, lattice: Lattice) -> int:
    """Both ways: displacements at the active voxels and gradients of all levels' coefficients;
    returns how many nodes there are."""
    shape = lattice.shape
    base = random(*shape, n_channels, seed=1)
    dense = [random(*s, n_channels, seed=2).requires_grad_() for s in pyramid_shapes(shape, LEVELS)]
    potential = base + expand_levels(dense)
    wanted = unclamped_displacement(potential, effect, kind, lattice)[active]
    weights = random(*wanted.shape, seed=3)

    nodes = Nodes.where(effect > 0)
    pyramid = SparsePyramid(nodes, LEVELS, effect)
    moves = SparseDisplacement(
        Nodes.where(active), nodes, effect, kind, lattice.spacing, n_channels
    )
    levels = [level.detach().requires_grad_() for level in pyramid.nodes.take(dense)]
    found = moves.apply(pyramid.chosen(base) + pyramid.expand(levels))
    torch.testing.assert_close(found, wanted, rtol=1e-12, atol=1e-12)

    def slopes(displacement: Tensor, unknowns: list[Tensor]) -> list[Tensor]:
        total = (weights * displacement).sum() + 0 * unknowns[0].sum()  # a voxel alone moves not
        return list(torch.autograd.grad(total, unknowns, allow_unused=True, materialize_grads=True))

    for ours, theirs in zip(
        pyramid.nodes.fill(slopes(found, levels)), slopes(wanted, dense), strict=True
    ):
        torch.testing.assert_close(ours, theirs, rtol=1e-12, atol=1e-12)
    return sum(len(level) for level in levels)


@pytest.mark.parametrize("kind", CHANNELS)
@pytest.mark.parametrize("box", BOXES)
def test_values_and_gradients_are_those_of_the_whole_box(box: str, kind: str) -> None:
    shape, share = BOXES[box]
    effect = random(*shape, seed=4) * (random(*shape, seed=5) < share)
    active = (effect > 0) | (random(*shape, seed=6) < 0.3)
    lattice = lattice_of(shape)
    compare(effect, active, kind, CHANNELS[kind], lattice)
    if kind == "stream" and 1 in shape:  # the one component that moves anything
        compare(effect, active, kind, 1, lattice)


def test_lumps_far_from_each_other_have_no_nodes_in_between() -> None:
    lump = puff(10)
    counts = []
    for length in (80, 160):
        density = torch.zeros(length, 10, 10)
        density[:10] = density[-10:] = torch.from_numpy(lump)
        smoke = smoke_of(density.numpy(), affine(2))
        lattice = surround(smoke, 2)
        effect = border_mask(lattice.fill(smoke).double(), 2.0)
        shown = torch.linspace(0, 1, lattice.shape[1], dtype=torch.float64)[:, None]  # a mask
        masked = effect * shown
        active = (lattice.fill(smoke) > 0) | grow(effect > 0)
        counts.append(compare(effect, active, "stream", 3, lattice))
        assert compare(masked, active, "mixed", 4, lattice) <= counts[-1]
    assert counts[0] <= counts[1] < 1.1 * counts[0]


def test_only_nodes_whose_coefficient_reaches_the_smoke_take_part() -> None:
    effect = torch.zeros(33, 34, 35, dtype=torch.float64)
    effect[20:24, 5:8, 16:19] = 1
    dense = [random(*s, 1).requires_grad_() for s in pyramid_shapes(effect.shape, LEVELS)]
    reached = expand_levels(dense)[effect > 0].square().sum()
    pyramid = SparsePyramid(Nodes.where(effect > 0), LEVELS, effect)
    ones = pyramid.nodes.fill([torch.ones_like(level) for level in pyramid.nodes.zeros(1, effect)])
    for box, slope in zip(ones, torch.autograd.grad(reached, dense), strict=True):
        assert torch.equal(box > 0, slope != 0)


def test_what_a_box_of_a_level_takes_it_gives_back() -> None:
    effect = random(9, 12, 7) < 0.2
    like = torch.zeros((), dtype=torch.float64)
    pyramid = SparsePyramid(Nodes.where(effect), 3, like)
    levels = [random(*zero.shape, seed=n) for n, zero in enumerate(pyramid.nodes.zeros(2, like))]
    boxes = pyramid.nodes.fill(levels)
    assert [tuple(box.shape[:3]) for box in boxes] == pyramid_shapes(effect.shape, 3)
    for before, after in zip(levels, pyramid.nodes.take(boxes), strict=True):
        assert torch.equal(before, after)
    assert torch.equal(pyramid.chosen(boxes[-1]), levels[-1])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_map_along_an_axis_is_the_matrix_and_its_transpose(axis: int) -> None:
    """Entry by entry: what is not among the columns is left out of both directions."""
    sides, n = (5, 6, 7), 4
    matrix = random(sides[axis], n, seed=7) * (random(sides[axis], n, seed=8) < 0.6)
    coarse = tuple(n if a == axis else side for a, side in enumerate(sides))
    rows = Nodes.where(random(*sides, seed=9) < 0.5)
    columns = Nodes.where(random(*coarse, seed=10) < 0.5)
    linear = map_along(rows, columns, axis, matrix, matrix)
    full = [torch.eye(side, dtype=torch.float64) for side in sides]
    full[axis] = matrix
    whole = torch.kron(torch.kron(full[0], full[1]), full[2])
    wanted = whole[rows.flat][:, columns.flat]
    assert torch.allclose(linear.forth(torch.eye(len(columns), dtype=torch.float64)), wanted)
    assert torch.allclose(linear.back(torch.eye(len(rows), dtype=torch.float64)), wanted.T)
    read = nodes_read(rows, axis, AxisMatrix.of(matrix, matrix))
    assert torch.equal(read.flat, torch.nonzero(whole[rows.flat].any(0)).squeeze(1))


def test_sums_that_are_put_together_in_parts_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, columns = (Nodes.where(random(9, 8, n, seed=11) < 0.5) for n in (10, 5))
    matrix = interpolation_matrix(10, 5, "cubic")
    assert matrix is not None
    whole = map_along(rows, columns, 2, matrix, matrix)
    monkeypatch.setattr("usdsmoke.core.fields.sparse_map.CHUNK_ROWS", 7)
    parts = map_along(rows, columns, 2, matrix, matrix)
    for one, other in ((whole.forth, parts.forth), (whole.back, parts.back)):
        assert torch.equal(one.index, other.index) and torch.equal(one.weight, other.weight)
        assert torch.equal(one.start, other.start)


@pytest.fixture
def threads() -> Iterator[None]:
    """Puts the number of threads back."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def test_results_repeat_bit_by_bit_on_any_number_of_threads(threads: None) -> None:
    effect = (random(24, 20, 22) * (random(24, 20, 22, seed=1) < 0.3)).float()
    nodes = Nodes.where(effect > 0)
    found = []
    for n_threads in (1, 2):
        torch.set_num_threads(n_threads)
        pyramid = SparsePyramid(nodes, LEVELS, effect)
        moves = SparseDisplacement(nodes, nodes, effect, "stream", (1.0, 1.0, 1.0), 3)
        zeros = pyramid.nodes.zeros(3, effect)
        levels = [random(*zero.shape).float().requires_grad_() for zero in zeros]
        moved = moves.apply(pyramid.expand(levels))
        found.append([moved, *torch.autograd.grad(moved.square().sum(), levels)])
    assert all(torch.equal(one, other) for one, other in zip(*found, strict=True))


def test_slopes_are_those_of_a_parabola_up_to_the_border() -> None:
    x = 0.5 * torch.arange(6, dtype=torch.float64)
    assert torch.allclose(slope_matrix(6, 0.5) @ (x * x - 3 * x), 2 * x - 3)
    assert not slope_matrix(1, 0.5).any()
