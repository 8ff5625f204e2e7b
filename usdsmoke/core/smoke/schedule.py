"""How many iterations each octave gets, and how many views; no torch, because the plan asks too."""

from collections.abc import Sequence

from usdsmoke.config.look_sections import ViewsConfig

# degrees, half the ranges of azimuth and elevation of the views
ALL_ROUND = (180.0, 20.0)
AROUND_CAMERA = (12.0, 6.0)
# of so many views around a camera one is of another side: in the finest octave, in coarser ones
ASIDE, COARSE_ASIDE = 4, 2
# Voxels; behind a network, most iterations of frames with more are done on larger voxels
# (decision 054), and a network is trained on them in fewer iterations
MOST_ALIKE = 60_000
BEHIND = 0.4  # of the finest octave's iterations: behind a network
COARSER = 0.75  # of the iterations behind a network: on larger voxels, if there are more
# From so many voxels on, the shape step moves blocks of two: it takes a third to a half of the
# time, hardly folds, and sequences have fewer specks. A density that is moved voxel by voxel is
# nearer to the style: the fewer voxels smoke has, the more of it is lost (decisions 038 and 075)
MANY_VOXELS = 2**16
SIDEWAYS = 45.0  # half a range of azimuth, degrees, from which on smoke is seen from the side
OCTAVE_SCALE = 2  # of neighbouring octaves: whole blocks of voxels, so that mass is kept exactly


def octave_iterations(per_octave: Sequence[int], total: int | None) -> list[int]:
    """Iterations of each octave, coarse to fine, when a step's total is given or not.

    >>> octave_iterations([60, 50, 40], 30)
    [12, 10, 8]

    Args:
        per_octave: the configured list; an octave with 0 is left out and stays so.
        total: requested sum; None leaves the list unchanged, 0 leaves nothing. Otherwise every
            octave that has iterations keeps at least one.
    """
    whole = sum(per_octave)
    if total is None or whole == 0:
        return list(per_octave)
    if total == 0:
        return [0] * len(per_octave)
    done = configured = 0
    scaled = []
    for n in per_octave:
        configured += n
        scaled.append(max(min(n, 1), round(configured * total / whole) - done))
        done += scaled[-1]
    return scaled


def warm_iterations(per_octave: Sequence[int], share: float) -> list[int]:
    """Iterations of a frame that starts from its neighbour, coarse to fine.

    A share of the finest octave's, none of the others': the coarse structure came with the start.

    >>> warm_iterations([60, 50, 40], 0.5)
    [0, 0, 20]
    """
    finest = last_octave(per_octave)
    return [max(1, round(n * share)) if n and k == finest else 0 for k, n in enumerate(per_octave)]


def network_iterations(per_octave: Sequence[int], n_voxels: int) -> list[int]:
    """Iterations of a frame that starts from what a network paints, coarse to fine.

    Two fifths of the finest octave's, or all of them where no coarser octave has any. On a large
    frame three of four of these are done on voxels of twice the size, where each takes a sixth of
    the time: its network had fewer iterations, and what it leaves is not in the finest detail
    alone.

    >>> network_iterations([40, 40, 40], 10_000), network_iterations([40, 40, 40], 1_000_000)
    ([0, 0, 16], [0, 12, 4])
    >>> network_iterations([0, 0, 32], 10_000)
    [0, 0, 32]

    Args:
        n_voxels: of the frame's smoke.
    """
    iterations = warm_iterations(per_octave, BEHIND if any(per_octave[:-1]) else 1.0)
    finest = last_octave(iterations)
    if finest > 0 and n_voxels > MOST_ALIKE:
        iterations[finest - 1] = round(COARSER * iterations[finest])
        iterations[finest] -= iterations[finest - 1]
    return iterations


def last_octave(iterations: Sequence[int]) -> int:
    """The number of the finest octave that has iterations; 0 where none has."""
    return max((k for k, n in enumerate(iterations) if n), default=0)


def network_views(views: ViewsConfig, n_iterations: int) -> int:
    """Number of different views of an octave behind a network: each is drawn twice at least.

    With 8 iterations of as many views on a million voxels, the last ones undo what the first did.
    """
    return min(pool_size(views), max(1, n_iterations * views.count // 2))


def view_ranges(views: ViewsConfig) -> tuple[float, float]:
    """Half the ranges of azimuth and elevation, degrees: all round, or around the shot's camera.

    Colours that are painted from one side only are streaks from all others. Views from above and
    below keep most smoke from being painted in level slices, which look like strokes from all
    round; steeper ones blur more marks than they mend.
    """
    azimuth, elevation = AROUND_CAMERA if views.camera else ALL_ROUND
    return (
        azimuth if views.azimuth is None else views.azimuth,
        elevation if views.elevation is None else views.elevation,
    )


def has_one_view(views: ViewsConfig, is_thin: bool = False) -> bool:
    """True if smoke is seen from one side only, whatever ``views.pool`` is.

    Args:
        is_thin: the smoke is one voxel thick, see ``Placed.thin_axis``.
    """
    return is_thin or view_ranges(views) == (0, 0)


def pool_size(views: ViewsConfig, is_thin: bool = False) -> int:
    """Number of different views that the iterations of an octave draw from, at least 1.

    An iteration draws ``views.count`` of them, or all if there are fewer.

    Args:
        is_thin: see ``has_one_view``.
    """
    return 1 if has_one_view(views, is_thin) else views.pool


def views_aside(views: ViewsConfig, is_coarse: bool, is_thin: bool = False) -> int:
    """How many views of a colour step's pool are of the sides that the shot's camera does not see.

    Without them these would be of one colour. Coarse octaves have more of them: what the camera
    sees has its marks from the finest one. A range of azimuth or a middle that is set leaves them
    out.

    Args:
        is_coarse: finer octaves follow.
        is_thin: see ``has_one_view``.
    """
    is_chosen = views.azimuth is not None or views.centre_azimuth or views.centre_elevation
    if not views.camera or is_chosen:
        return 0
    return pool_size(views, is_thin) // (COARSE_ASIDE if is_coarse else ASIDE)


def views_in_front(views: ViewsConfig) -> ViewsConfig:
    """The finest octave's views of the colour step without those aside."""
    return views.replace(pool=views.pool - views_aside(views, is_coarse=False))
