"""How many iterations each octave gets; no torch here, so that the plan can ask too."""

from collections.abc import Sequence

from usdsmoke.base.config import Config

__all__ = ["OCTAVE_SCALE", "coarse_factor", "octave_iterations", "warm_iterations"]

OCTAVE_SCALE = 2  # of neighbouring octaves: whole blocks of voxels, so that mass is kept exactly


def octave_iterations(per_octave: Sequence[int], total: int | None) -> list[int]:
    """Iterations of each octave, coarse to fine, when a step's total is given or not.

    >>> octave_iterations([60, 50, 40], 30)
    [12, 10, 8]

    Args:
        per_octave: the configured list; an octave with 0 is left out and stays so.
        total: wanted sum; None leaves the list as it is. No other octave falls below one iteration.
    """
    whole = sum(per_octave)
    if total is None or whole == 0:
        return list(per_octave)
    done = wanted = 0
    scaled = []
    for n in per_octave:
        wanted += n
        scaled.append(max(min(n, 1), round(wanted * total / whole) - done))
        done += scaled[-1]
    return scaled


def warm_iterations(per_octave: Sequence[int], share: float) -> list[int]:
    """Iterations of a frame that starts from its neighbour, coarse to fine.

    A share of the finest octave's, none of the others': the coarse structure came with the start.

    >>> warm_iterations([60, 50, 40], 0.5)
    [0, 0, 20]
    """
    finest = max((k for k, n in enumerate(per_octave) if n), default=None)
    return [max(1, round(n * share)) if k == finest else 0 for k, n in enumerate(per_octave)]


def coarse_factor(config: Config) -> int:
    """How many times larger the voxels of the shared coarse step are; 1 when there is none.

    Every step keeps one octave at least for the windows, and one that has no more shares none.
    """
    n_octaves = [len(getattr(config, step).iterations) for step in config.optimize.steps]
    n_fine = max(min(n_octaves) - config.windows.shared_octaves, 1)
    return OCTAVE_SCALE**n_fine if n_fine < min(n_octaves) else 1
