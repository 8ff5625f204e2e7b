"""The form of the generator: its octaves, channels and parameters, and how long it is trained;
without torch."""

FORMAT = "3"  # rises with every change after which older parameters paint something else
N_LEVELS = 5  # octaves; a colour depends on smoke at most 92 voxels away
N_NOISE = 3  # channels of noise in each octave but the finest
WIDTH = 12  # channels of features
N_NEIGHBOURS = 27  # of 3 x 3 x 3, the voxel itself in the middle

N_ITERATIONS = 1200  # of a training, at most
N_VIEWS = 2  # of an iteration
MOST_VOXELS = 60_000  # of a crop, which keeps an iteration cheap; it cuts smoke off


def parameter_shapes() -> dict[str, tuple[int, ...]]:
    """The parameters by name, in the order in which they are stored."""
    shapes: dict[str, tuple[int, ...]] = {}
    for number in range(N_LEVELS):
        is_finest, has_coarser = number == N_LEVELS - 1, number > 0
        n_in = (N_NOISE + 1) * (not is_finest) + WIDTH * has_coarser  # noise, density, features
        for name, width in (("first", n_in), ("second", WIDTH)):
            shapes[f"{number}.{name}.weight"] = (N_NEIGHBOURS, width, WIDTH)
            shapes[f"{number}.{name}.bias"] = (WIDTH,)
    return shapes | {"colour.weight": (WIDTH, 3), "colour.bias": (3,)}
