"""Divides a sequence of timeCodes into windows of frames.

A window is the unit of work: its frames are stylized together, each starting from its neighbour's
result. No window needs another one, so windows can run on any machine and be resumed separately.
Every frame belongs to exactly one window. A window also computes the next window's first frames,
the overlap, and both versions are blended afterwards.
"""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from usdsmoke.base.errors import ShapeError
from usdsmoke.config.run_sections import WindowsConfig

# A step of more than this many usual steps is a cut: nothing is carried over it. One missing frame
# makes a step of two, over which a velocity still leads; validation reports it as a gap.
_CUT = 2.0


@dataclass(frozen=True)
class Window:
    """A run of neighbouring frames."""

    index: int  # 0-based, over all Volumes of a run
    time_codes: tuple[float, ...]  # ascending, at least one: the frames that are its own
    overlap: tuple[float, ...] = ()  # the next window's first frames, computed here too
    continues: bool = False  # the previous window: there is no cut between them


def find_cuts(
    time_codes: Sequence[float], frame_length: float = 1.0
) -> tuple[tuple[float, float], ...]:
    """Neighbouring timeCodes with a gap between them: two shots in one volume, or missing frames.

    A gap is a step of more than twice the median step, and of more than two frames: a mix of whole
    frames and subframes has no gap.

    >>> find_cuts([1, 2, 3, 10, 11])
    ((3, 10),)
    >>> find_cuts([1, 2, 2.25, 2.5, 2.75, 3, 4])
    ()

    Args:
        time_codes: ascending, each once.
        frame_length: timeCodes in a frame, that is timeCodes per second over frames per second.

    Raises:
        ShapeError: the timeCodes do not ascend.
    """
    steps = [later - earlier for earlier, later in pairwise(time_codes)]
    if any(not step > 0 for step in steps):
        raise ShapeError(
            f"timeCodes {list(time_codes)} are not in ascending order. Sort them and remove "
            "repeats."
        )
    if not steps:
        return ()
    longest = _CUT * max(statistics.median(steps), frame_length)
    return tuple(
        pair for pair, step in zip(pairwise(time_codes), steps, strict=True) if step > longest
    )


def split_windows(
    time_codes: Sequence[float],
    config: WindowsConfig,
    first_index: int = 0,
    frame_length: float = 1.0,
) -> tuple[Window, ...]:
    """Windows of ``config.size`` frames, in order; a cut (``find_cuts``) ends one early.

    Frames that are left before a cut, fewer than the overlap and than half a window, go to the
    window before them. Windows of one frame are independent: nothing is carried between them, and
    none overlaps.

    >>> [window.time_codes for window in split_windows([1, 2, 3, 10, 11], WindowsConfig(size=2))]
    [(1, 2), (3,), (10, 11)]
    >>> [window.overlap for window in split_windows([1, 2, 3, 10, 11], WindowsConfig(size=2))]
    [(3,), (), ()]
    >>> [w.time_codes for w in split_windows([1, 2, 3, 4, 5], WindowsConfig(size=4, overlap=2))]
    [(1, 2, 3, 4, 5)]

    Args:
        time_codes: ascending, each once.
        frame_length: timeCodes in a frame, see ``find_cuts``.

    Raises:
        ShapeError: the timeCodes do not ascend.
    """
    cuts = {later for _, later in find_cuts(time_codes, frame_length)}
    windows: list[Window] = []
    for number, time_code in enumerate(time_codes):
        is_cut = number == 0 or time_code in cuts
        if is_cut or len(windows[-1].time_codes) == config.size:
            continues = not is_cut and config.size > 1
            windows.append(Window(first_index + len(windows), (time_code,), continues=continues))
        else:
            codes = (*windows[-1].time_codes, time_code)
            windows[-1] = replace(windows[-1], time_codes=codes)
    shortest = min(config.overlap, (config.size + 1) // 2)
    overlap = min(config.overlap, config.size)
    return _with_overlaps(_without_short_ends(windows, shortest), overlap)


def _without_short_ends(windows: Sequence[Window], shortest: int) -> list[Window]:
    """A last window before a cut that is too short belongs to the one before it.

    That one computes its frames anyway, and in fewer frames than the overlap the pattern of one
    window would go over too fast into that of the other (decision 009).
    """
    found: list[Window] = []
    for place, window in enumerate(windows):
        is_last = place + 1 == len(windows) or not windows[place + 1].continues
        if window.continues and is_last and len(window.time_codes) < shortest:
            codes = (*found[-1].time_codes, *window.time_codes)
            found[-1] = replace(found[-1], time_codes=codes)
        else:
            found.append(replace(window, index=windows[0].index + len(found)))
    return found


def _with_overlaps(windows: Sequence[Window], overlap: int) -> tuple[Window, ...]:
    """The windows with the first frames of those that continue them."""
    found = list(windows)
    for place, (window, later) in enumerate(pairwise(windows)):
        if later.continues:
            found[place] = replace(window, overlap=later.time_codes[:overlap])
    return tuple(found)


def followed_codes(
    windows: Sequence[Window], runs: Sequence[tuple[float, ...]]
) -> frozenset[float]:
    """The timeCodes from which a window or a coarse step goes on to the next frame.

    The velocity of these frames carries the pattern; that of a chain's last frame is not used.

    >>> sorted(followed_codes(split_windows([1, 2, 3, 10], WindowsConfig(size=9)), ()))
    [1, 2]
    """
    chains = [*(window.time_codes + window.overlap for window in windows), *runs]
    return frozenset(code for chain in chains for code in chain[:-1])


def coarse_runs(windows: Sequence[Window]) -> tuple[tuple[float, ...], ...]:
    """The timeCodes that share a coarse step, separated by cuts; none for a single window.

    >>> coarse_runs(split_windows([1, 2, 3, 10, 11], WindowsConfig(size=2)))
    ((1, 2, 3),)
    """
    runs: list[list[Window]] = []
    for window in windows:
        if not window.continues:
            runs.append([])
        runs[-1].append(window)
    return tuple(
        tuple(code for window in run for code in window.time_codes) for run in runs if len(run) > 1
    )
