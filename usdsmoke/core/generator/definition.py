"""The form of the generator: its octaves, channels and parameters, and how long it is trained;
without torch."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from usdsmoke.core.smoke.schedule import MOST_ALIKE

FORMAT = "4"  # rises with every change after which older parameters paint something else
LEAST_OCTAVES = 5  # of a network
BLOCKS_ACROSS = 2.5  # blocks of the coarsest octave along the smoke, at least, with more octaves
N_NOISE = 3  # channels of noise in each octave but the finest
WIDTH = 12  # channels of features
N_CONVOLUTIONS = 2  # of each octave
N_NEIGHBOURS = 27  # of 3 x 3 x 3, the voxel itself in the middle

N_ITERATIONS = 1200  # of a training, at most
N_VIEWS = 2  # of an iteration; of a whole frame after its crops, one
USUAL_VOXELS = MOST_ALIKE  # of an iteration; with more, as many fewer iterations take as long
CROP_VOXELS = 240_000  # of the crops of a large frame, before it is learned as a whole
WHOLE_VOXELS = 1_200_000  # of a frame that is learned as a whole; of a larger one, crops are
IN_CROPS, AS_WHOLE = 0.4, 1.6  # of the iterations that as many voxels have otherwise


@dataclass(frozen=True)
class TrainingPart:
    """A part of a training, all of whose iterations are alike."""

    voxels: int  # that an iteration paints at most
    iterations: int
    views: int  # whose mean is the loss of an iteration


def training_parts(n_voxels: int, n_iterations: int = N_ITERATIONS) -> list[TrainingPart]:
    """The parts of a training: a large frame is learned from crops first.

    >>> [(part.voxels, part.iterations, part.views) for part in training_parts(1_000_000)]
    [(240000, 120, 2), (1000000, 115, 1)]

    Args:
        n_voxels: of the largest frame.
        n_iterations: for small frames.
    """
    whole = min(n_voxels, WHOLE_VOXELS)
    parts = [(whole, 1.0, N_VIEWS)]
    if n_voxels > CROP_VOXELS:
        parts = [(CROP_VOXELS, IN_CROPS, N_VIEWS), (whole, AS_WHOLE, 1)]
    usual = [share * n_iterations * min(1, USUAL_VOXELS / size) for size, share, _ in parts]
    return [
        TrainingPart(size, max(1, round(n)), views)
        for (size, _, views), n in zip(parts, usual, strict=True)
    ]


def octaves_for(extent: float) -> int:
    """How many octaves a network has that is trained on frames of that size.

    Marks are wider on more voxels. On 222 voxels, seven octaves end nearer to the style than five
    (decision 073).

    >>> [octaves_for(extent) for extent in (0, 79, 80, 222, 319, 320)]
    [5, 5, 6, 7, 7, 8]

    Args:
        extent: of the smoke, voxels.
    """
    return max(LEAST_OCTAVES, 1 + int(math.log2(max(extent, 1) / BLOCKS_ACROSS)))


def count_octaves(names: Iterable[str]) -> int:
    """How many octaves parameters of these names are of."""
    return sum(name.endswith(".first.bias") for name in names)


def parameter_shapes(n_octaves: int) -> dict[str, tuple[int, ...]]:
    """The parameters by name, in the order in which they are stored."""
    shapes: dict[str, tuple[int, ...]] = {}
    for number in range(n_octaves):
        is_finest, has_coarser = number == n_octaves - 1, number > 0
        n_in = (N_NOISE + 1) * (not is_finest) + WIDTH * has_coarser  # noise, density, features
        for name, width in (("first", n_in), ("second", WIDTH)):
            shapes[f"{number}.{name}.weight"] = (N_NEIGHBOURS, width, WIDTH)
            shapes[f"{number}.{name}.bias"] = (WIDTH,)
    return shapes | {"colour.weight": (WIDTH, 3), "colour.bias": (3,)}
