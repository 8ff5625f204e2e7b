"""The network that paints smoke in one pass: its arithmetic, its bits, its training, its file."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style, smoke_of
from tests.fixtures.stylize_fixtures import problem_of, quick_config, run_core, scene_of
from usdsmoke.base.errors import FeatureError
from usdsmoke.core.features.safetensors import safetensors_bytes
from usdsmoke.core.generator import convolution, levels, network
from usdsmoke.core.generator.convolution import by_number, convolve, row_product
from usdsmoke.core.generator.definition import FORMAT, LEAST_OCTAVES
from usdsmoke.core.generator.levels import make_levels, slabs
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.generator.weights import read_weights
from usdsmoke.core.smoke import schedule
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.tasks import computing_threads
from usdsmoke.core.steps.behind import refine_painted
from usdsmoke.core.training.canvas import Canvas, crop
from usdsmoke.core.training.frames import find_misfit, train_on_frames
from usdsmoke.core.training.train import Trained

FRAMES = [frame_of(puff(12, seed), seed + 1.0) for seed in range(3)]
STYLE = random_style()
CONFIG = quick_config(colour={"smoothing": 0.25})
SCENE = scene_of(FRAMES, CONFIG)


@pytest.fixture(scope="module")
def trained() -> Trained:
    """On two puffs, judged by a third."""
    return train_on_frames(FRAMES, [STYLE], SCENE, CONFIG, 50, lambda state: None).trained


@pytest.fixture
def file_path(trained: Trained, tmp_path: Path) -> Path:
    """Of a trained generator."""
    written = tmp_path / "style.safetensors"
    written.write_bytes(trained.generator.to_bytes({"styles": "a.png"}))
    return written


def paint(smoke: ActiveSmoke, seed: int = 0) -> torch.Tensor:
    generator = Generator.new(torch.tensor([0.2, 0.5, 0.7]), 3)
    return generator(make_levels(smoke, LEAST_OCTAVES), 1.0, seed)


def rod(length: int) -> ActiveSmoke:
    """Smoke three voxels thick along i."""
    density = np.random.default_rng(0).uniform(0.1, 1, (200, 3, 3))
    return smoke_of(density[:length].astype(np.float32))


def test_a_new_network_starts_between_black_and_white_also_in_dense_smoke() -> None:
    """At the ends of a sigmoid it learns nothing."""
    colours = paint(smoke_of(np.full((14, 14, 14), 3.0)))
    assert ((colours > 0.02) & (colours < 0.98)).double().mean() > 0.98


def test_neighbours_are_those_of_a_dictionary_of_voxels() -> None:
    density = np.random.default_rng(0).uniform(0, 1, (6, 5, 7)).astype(np.float32)
    smoke = smoke_of(np.where(density < 0.4, density, 0))
    rows = {tuple(voxel): row for row, voxel in enumerate(smoke.ijk.tolist())}
    found = make_levels(smoke, 1)[0].neighbours
    for row, (i, j, k) in enumerate(smoke.ijk.tolist()):
        around = [(i + a - 1, j + b - 1, k + c - 1) for a, b, c in np.ndindex(3, 3, 3)]
        assert found[row].tolist() == [rows.get(voxel, len(rows)) for voxel in around]


def test_a_convolution_is_the_dense_one_where_there_is_smoke_and_has_its_gradients() -> None:
    density = np.random.default_rng(1).uniform(0, 1, (3, 4, 2)).astype(np.float32)
    smoke = smoke_of(np.where(density < 0.5, density, 0))
    neighbours, ijk = make_levels(smoke, 1)[0].neighbours, tuple(smoke.ijk.T)
    source = torch.Generator().manual_seed(0)
    values, weight, bias = (
        torch.randn(shape, generator=source, dtype=torch.float64, requires_grad=True)
        for shape in ((len(smoke.ijk), 2), (27, 2, 3), (3,))
    )
    box = torch.zeros(3, 4, 2, 2, dtype=torch.float64)
    box[ijk] = values.detach()
    kernel = weight.detach().view(3, 3, 3, 2, 3).permute(4, 3, 0, 1, 2)
    dense = torch.nn.functional.conv3d(box.movedim(3, 0)[None], kernel, bias.detach(), padding=1)
    found = convolve(values, neighbours, weight, bias)
    torch.testing.assert_close(found, dense[0].movedim(0, 3)[ijk])
    assert torch.autograd.gradcheck(
        lambda *given: convolve(given[0], neighbours, given[1], given[2]), (values, weight, bias)
    )


def test_finer_octaves_take_values_between_blocks_and_gradients_go_back_the_same_way() -> None:
    density = np.random.default_rng(2).uniform(0, 1, (9, 12, 10)).astype(np.float32)
    density[4:, :, 5:] *= density[4:, :, 5:] > 0.7  # loose smoke: blocks are missing
    coarse, fine = make_levels(smoke_of(density), 2)
    places, ijk = coarse.smoke.positions.float(), fine.smoke.ijk
    found = fine.finer(places)
    inside = ((ijk > 0) & (ijk < 7)).all(dim=1) & (ijk[:, 2] < 3)
    torch.testing.assert_close(found[inside], fine.smoke.positions.float()[inside])
    torch.testing.assert_close(fine.finer(torch.ones_like(places)), torch.ones_like(found))
    leaf, back = places.clone().requires_grad_(), torch.randn_like(found)
    (slopes,) = torch.autograd.grad(fine.finer(leaf), leaf, back)
    assert float((slopes * places).sum()) == pytest.approx(float((back * found).sum()), rel=1e-4)


def test_bits_do_not_depend_on_threads_or_on_rows_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    smoke = smoke_of(puff(16))
    expected = paint(smoke)
    for n_threads, n_rows in ((2, 256), (1, 77), (2, 1000)):
        monkeypatch.setattr(convolution, "ROWS", n_rows)
        with computing_threads(n_threads):
            assert torch.equal(paint(smoke), expected)


def test_a_colour_depends_on_the_smoke_around_it_alone() -> None:
    whole, part = paint(rod(200)), paint(rod(150))
    same = (whole[: len(part)] == part).all(dim=1).view(150, 9).all(dim=1)
    assert same[:50].all()  # 92 voxels from the changed block
    assert not same[144:].any()


def test_a_network_for_longer_smoke_has_more_octaves_and_sees_farther() -> None:
    """It also paints smoke that is smaller than a block of its coarsest octave."""
    config = CONFIG.with_values({"views.image_size": 16, "colour.iterations": [1]})
    frame = frame_of(np.ones((100, 12, 12), np.float32))
    scene = scene_of([frame], config)
    trained = train_on_frames([frame], [STYLE], scene, config, 2, lambda state: None).trained
    assert trained.generator.n_octaves == LEAST_OCTAVES + 1
    whole, part = (trained.generator.paint(rod(n), 1.0, 0) for n in (200, 150))
    same = (whole[: len(part)] == part).all(dim=1).view(150, 9).all(dim=1)
    assert same.double().mean() < 0.1  # the changed block is less than 188 voxels away from all
    assert trained.generator.paint(rod(1), 1.0, 0).isfinite().all()


def test_smoke_too_far_away_changes_no_colour_however_small_the_box() -> None:
    """Also where a coarse octave is one block wide without it."""
    generator = Generator.new(torch.tensor([0.2, 0.5, 0.7]), 3, LEAST_OCTAVES + 2)
    alone = puff(16)
    far = np.zeros((16, 1200, 500), np.float32)
    far[:16, :16, :16], far[8, 1199, 499] = alone, 0.5
    some, more = (smoke_of(density) for density in (alone, far))
    near = (more.ijk[:, 1] < 16) & (more.ijk[:, 2] < 16)
    found, expected = (generator.paint(smoke, 1.0, 0) for smoke in (more, some))
    assert torch.equal(found[near], expected)


def test_a_crop_is_painted_as_the_frame_is() -> None:
    density = np.random.default_rng(4).uniform(-0.5, 1, (60, 60, 60)).clip(0).astype(np.float32)
    density[30, 30, 30] = 100  # an outlier bounds all densities, wherever it lies
    problem = problem_of(density, SCENE, CONFIG)
    generator = Generator.new(torch.tensor([0.2, 0.5, 0.7]), 3)
    whole = generator.paint(problem.smoke, SCENE.gamma_w, 5)
    colours = dict(zip(map(tuple, problem.smoke.ijk.tolist()), whole, strict=True))
    for number in range(3):
        part = crop(problem, number, 8000)
        found = Canvas(part, 0, 1, problem).paint(generator, 5)
        expected = torch.stack([colours[tuple(voxel)] for voxel in part.smoke.ijk.tolist()])
        assert torch.equal(found, expected)
        assert not torch.equal(Canvas(part, 0, 1).paint(generator, 5), expected)


def test_a_frame_has_the_same_bits_whatever_its_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    density = np.random.default_rng(5).uniform(-0.5, 1, (70, 20, 18)).clip(0).astype(np.float32)
    density[40:60] = 0
    density[50] = density[0]  # a tile that holds one plane still has voxels, not a slab's squares
    density[65:, 0, 0] = 50  # an outlier bounds all densities, wherever it lies
    generator = Generator.new(torch.tensor([0.2, 0.5, 0.7]), 3)
    smoke = smoke_of(density, np.diag([1.0, 1.0, 2.0, 1.0]))
    whole = generator(make_levels(smoke, LEAST_OCTAVES), 0.7, 5)
    monkeypatch.setattr(levels, "THINNEST", 1)
    for n_voxels in (10**6, 4000, 1000, 100, 1):
        monkeypatch.setattr(network, "TILE_VOXELS", n_voxels)
        assert torch.equal(generator.paint(smoke, 0.7, 5), whole)


@pytest.mark.parametrize("function", [torch.log1p, torch.sigmoid])
def test_a_number_has_the_same_bits_wherever_it_stands(
    function: Callable[[torch.Tensor], torch.Tensor],
) -> None:
    values = 6 * torch.rand(5000, generator=torch.Generator().manual_seed(0))
    whole = by_number(function, values)
    for n in range(1, 5000, 7):
        assert torch.equal(by_number(function, values[:n]), whole[:n])


@pytest.mark.parametrize("n", [1, 7, 33, 63])
def test_a_product_of_few_rows_has_the_bits_of_many(n: int) -> None:
    source = torch.Generator().manual_seed(0)
    rows, weight = (torch.randn(*shape, generator=source) for shape in ((5000, 324), (324, 12)))
    for first in range(0, 4900, 97):
        few = row_product(rows[first : first + n].clone(), weight)
        assert torch.equal(few, row_product(rows, weight)[first : first + n])


@pytest.mark.parametrize("most", [1, 50, 400, 10**6])
def test_slabs_hold_every_voxel_once(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels, "THINNEST", 1)
    ijk = smoke_of(puff(12)).ijk - 5
    found = slabs(ijk, most)
    assert sum(slab.holds(ijk).int() for slab in found).eq(1).all()
    largest = torch.unique(ijk[:, found[0].axis], return_counts=True)[1].max()
    assert all(0 < int(slab.holds(ijk).sum()) <= most + largest for slab in found)


def test_slabs_are_not_thinner_than_what_they_depend_on() -> None:
    ijk = smoke_of(np.ones((200, 4, 4))).ijk
    assert all(slab.last - slab.first + 1 >= levels.THINNEST for slab in slabs(ijk, 100))


def test_seeds_give_other_patterns(trained: Trained) -> None:
    smoke = smoke_of(puff(12))
    untrained = paint(smoke, 0), paint(smoke, 1)
    found = tuple(trained.generator.paint(smoke, 1.0, seed) for seed in (0, 1))
    for one, other in (untrained, found):
        assert (one - other).abs().mean() > 0.1 * one.std(dim=0).mean()  # of the pattern


def test_a_loss_falls_along_its_gradient_as_finite_differences_say() -> None:
    canvas = Canvas(problem_of(puff(12), SCENE, CONFIG), 0, 2)
    generator = Generator.new(torch.tensor([0.2, 0.5, 0.7]), 3)
    leaves = [values.requires_grad_() for values in generator.parameters.values()]
    loss = canvas.loss(canvas.paint(generator, 0), 0)
    slopes = torch.autograd.grad(loss, leaves)
    length = sum(float(slope.square().sum()) for slope in slopes) ** 0.5

    def moved(step: float) -> float:
        with torch.no_grad():
            pairs = zip(generator.parameters.items(), slopes, strict=True)
            other = Generator({n: p + step * slope / length for (n, p), slope in pairs})
            return float(canvas.loss(canvas.paint(other, 0), 0))

    step = 2e-3
    assert (moved(step) - moved(-step)) / (2 * step) == pytest.approx(length, rel=0.03)


def test_training_ends_below_cold_iterations_on_a_held_out_frame(trained: Trained) -> None:
    assert trained.loss < trained.cold_loss


def test_a_network_paints_each_frame_by_itself(file_path: Path) -> None:
    config = CONFIG.with_values({"optimize.start": str(file_path), "optimize.iterations": 0})
    together = run_core(FRAMES[:2], config, SCENE, [STYLE])
    for frame, found in zip(FRAMES, together, strict=False):
        (alone,) = run_core([frame], config, SCENE, [STYLE])
        assert alone.emission is not None and found.emission is not None
        assert np.array_equal(alone.emission.values, found.emission.values)


def test_two_fifths_of_the_finest_octave_follow_a_network_and_half_a_neighbour(
    file_path: Path,
) -> None:
    values = {
        "optimize.start": str(file_path), "windows.warm_iterations": 0.5,
        "colour.iterations": [2, 8],
    }  # fmt: skip
    alike = [replace(FRAMES[0], time_code=code) for code in (1.0, 2.0)]
    found = run_core(alike, CONFIG.with_values(values), SCENE, [STYLE])
    done = [one.report.colour.iterations for one in found if one.report.colour is not None]
    assert done == [(3,), (4,)]


def test_behind_a_network_large_frames_are_refined_on_larger_voxels_first(
    file_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = CONFIG.with_values({"optimize.start": str(file_path), "colour.iterations": [0, 0, 8]})
    done = []
    for most_alike in (60_000, 100):
        monkeypatch.setattr(schedule, "MOST_ALIKE", most_alike)
        (found,) = run_core(FRAMES[:1], config, SCENE, [STYLE])
        assert found.report.colour is not None
        done.append(found.report.colour.iterations)
    assert done == [(8,), (6, 2)]


def border_contrast(colours: torch.Tensor, smoke: ActiveSmoke, size: int) -> list[float]:
    """Along each axis of a filled box that is long enough, away from its faces: the mean difference
    of two voxels beside each other across borders of blocks, in that of two within a block."""
    shape, found = (smoke.ijk.amax(0) + 1).tolist(), []
    box, ijk = colours.view(*shape, 3), smoke.ijk.view(*shape, 3)
    for axis, n in enumerate(shape):
        if n < 2 * size:
            continue
        steps = box.diff(dim=axis).abs().mean(-1)
        middle = tuple(slice(8, length - 9) for length in shape)
        is_first = ijk[..., axis].narrow(axis, 1, n - 1)[middle] % size == 0
        found.append(float(steps[middle][is_first].mean() / steps[middle][~is_first].mean()))
    return found


def check_seams(generator: Generator, shape: tuple[int, int, int], size: int) -> None:
    """There are no seams between blocks of this size; seams that are added are found."""
    smoke, seams = smoke_of(np.full(shape, 1.0, np.float32)), torch.tensor([0.03])
    colours = generator.paint(smoke, SCENE.gamma_w, 0)
    assert max(border_contrast(colours, smoke, size)) < 1.1
    checkered = torch.div(smoke.ijk, size, rounding_mode="floor").sum(1, keepdim=True) % 2
    assert min(border_contrast(colours + seams * checkered, smoke, size)) > 1.1


@pytest.mark.parametrize("size", [2, 4, 8, 16])
def test_painted_smoke_has_no_seams_at_borders_of_blocks(trained: Trained, size: int) -> None:
    """Levels of the network have voxels of these sizes, aligned to absolute indices."""
    check_seams(trained.generator, (40, 40, 40), size)


@pytest.mark.parametrize("size", [32, 64])
@pytest.mark.parametrize("axis", range(3))
def test_blocks_of_networks_of_more_octaves_have_no_seams(axis: int, size: int) -> None:
    sides = [24, 24, 24]
    sides[axis] = 4 * size
    generator = Generator.new(torch.tensor([0.2, 0.5, 0.7]), 3, LEAST_OCTAVES + 2)
    check_seams(generator, (sides[0], sides[1], sides[2]), size)


def test_what_is_finer_than_an_octave_behind_a_network_stays(trained: Trained) -> None:
    problem = problem_of(puff(16), SCENE, CONFIG)
    values = {"views.pool": 16, "optimize.tolerance": 0.0}
    problem = replace(problem, config=problem.config.with_values(values))
    neighbours = make_levels(problem.smoke, 1)[0].neighbours

    def roughness(values: torch.Tensor) -> float:
        """Mean second difference along i; a straight line has none."""
        around = torch.cat([values, torch.full((1, 3), torch.nan)])[neighbours[:, [4, 13, 22]]]
        return float((around[:, 0] - 2 * around[:, 1] + around[:, 2]).abs().nanmean())

    painted, changes = trained.generator.paint(problem.smoke, SCENE.gamma_w, 0), []
    for iterations in ([24, 0], [0, 24]):
        found, ends, n_views = refine_painted(problem, iterations, painted)
        assert [end.iteration + 1 for end in ends] == [24]
        assert n_views == 12  # half as many as iterations
        changes.append(found - painted)
    assert roughness(changes[0]) < 0.4 * roughness(changes[1])
    assert roughness(painted + changes[0]) == pytest.approx(roughness(painted), rel=0.1)
    canvas = Canvas(problem, 99, 4)
    assert canvas.loss(painted + changes[1], 0) < canvas.loss(painted, 0)


def test_a_network_of_another_style_does_not_fit(file_path: Path) -> None:
    config = CONFIG.with_values({"optimize.start": str(file_path)})
    assert find_misfit(FRAMES[1], [STYLE], SCENE, config) == ""
    other = np.random.default_rng(5).uniform(0, 1, STYLE.shape).astype(np.float32)
    assert "iterations from noise reach" in find_misfit(FRAMES[1], [other], SCENE, config)


def test_a_file_gives_the_same_parameters_and_equal_generators_equal_bytes(
    trained: Trained, file_path: Path
) -> None:
    longer = Generator.new(torch.full((3,), 0.5), 0, LEAST_OCTAVES + 2)
    for generator in (longer, trained.generator):
        file_path.write_bytes(generator.to_bytes({"styles": "a.png"}))
        found = Generator.from_file(file_path)
        assert found.n_octaves == generator.n_octaves
        for name, values in generator.parameters.items():
            assert torch.equal(found.parameters[name], values)
        assert found.to_bytes({"styles": "a.png"}) == file_path.read_bytes()


def test_damaged_and_foreign_files_are_refused(file_path: Path) -> None:
    whole, parameters = file_path.read_bytes(), Generator.from_file(file_path).parameters
    damaged = bytearray(whole)
    damaged[-5] ^= 1
    lacking = Generator({n: p for n, p in parameters.items() if not n.startswith("2.")})
    colours = Generator({n: p for n, p in parameters.items() if n.startswith("colour.")})
    for content, words in (
        (bytes(damaged), "damaged"),
        (lacking.to_bytes({}), "damaged"),
        (colours.to_bytes({}), "damaged"),
        (whole[:-8], "not a complete safetensors file"),
        (b"", "not a complete safetensors file"),
        (safetensors_bytes({"a": np.zeros(3, np.float32)}, {}), "no network of usdsmoke"),
        (whole.replace(f'_generator":"{FORMAT}"'.encode(), b'_generator":"9"'), "format 9"),
    ):
        file_path.write_bytes(content)
        with pytest.raises(FeatureError, match=words):
            read_weights(file_path)
    file_path.unlink()
    with pytest.raises(FeatureError, match="such file"):
        read_weights(file_path)
