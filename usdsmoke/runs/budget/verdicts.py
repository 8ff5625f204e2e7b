"""What to make of a result, part by part: a few rows in plain words, worst first."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from usdsmoke.runs.budget import rows

FINE, LOOK = "fine", "look at it"
_LIGHT = "light and opacity"  # findings that belong to no error
_PARTS = {
    "detail of the pictures": (rows.QUADRATURE, rows.RESOLUTION, rows.PIXEL_FILTER),
    "smoke that was moved": (
        rows.TRANSPORT,
        rows.LINEAR_TRANSPORT,
        rows.MASS,
        rows.FOLDED,
        rows.UNREAD,
        rows.READ_TWICE,
        rows.MOTIONLESS,
    ),
    "end of the optimisation": (rows.SHAPE_OPTIMISER, rows.COLOUR_OPTIMISER),
    "seen from other sides": (rows.VIEW_SAMPLING, rows.UNSEEN_VIEWS),
    "steadiness over time": rows.TEMPORAL,
    "borders of windows": (rows.OVERLAP_DENSITY, rows.OVERLAP_EMISSION),
    "numbers in the files": (rows.STORAGE_DENSITY, rows.STORAGE_EMISSION),
}
_MOST = {row.name: row.most for part in _PARTS.values() for row in part}
_MEANINGS = {  # of a figure, by the beginning of the error's name
    "quadrature": "off exact rays through the smoke",
    "resolution": "off infinitely fine voxels and pixels",
    "pixel filter": "off the mean over each pixel",
    "transport": "off exact interpolation",
    "optimiser's transport": "off, as the optimiser interpolates",
    "mass, unread": "of the smoke is lost",
    "mass, read twice": "of the smoke appears twice",
    "mass": "of the mass, before it is corrected",
    "folded smoke": "of the voxels are turned inside out",
    "motionless mass": "of the smoke cannot be moved",
    "optimiser": "off four times as many iterations",
    "view sampling": "off other views of the kind",
    "unseen views": "off on views outside the pool",
    "temporal": "of the pattern does not follow the smoke",
    "windows": "between the versions of two windows",
    "storage": "lost by half floats and pruning",
}


@dataclass(frozen=True)
class Verdict:
    """One part of a result."""

    about: str
    verdict: str  # "fine", "look at it" or "change SETTING"
    error: str = ""  # its worst one; "" where findings alone decide
    largest: float | None = None  # of that error over the frames; None likewise
    meaning: str = ""  # of the figure, in plain words


def judge_parts(
    largest: Mapping[str, float], verdict_of: Callable[[str], str], is_lit_well: bool
) -> tuple[Verdict, ...]:
    """A verdict for each part that has an error or a finding.

    Worst first: those that ask for a setting, those that deserve a look, the others; and by how
    near an error comes to the bound above which something is wrong.

    Args:
        largest: of each error over the frames, by name.
        verdict_of: an error's verdict by its name; of "" that on findings of no error.
        is_lit_well: whether there are no such findings.
    """
    found = [] if is_lit_well else [Verdict(_LIGHT, verdict_of(""))]
    for about, part in _PARTS.items():
        names = sorted((row.name for row in part), key=lambda name: urgency(verdict_of(name)))
        there = [name for name in names if name in largest]
        worst = min(
            there,
            key=lambda name: (urgency(verdict_of(name)), -largest[name] / _MOST[name]),
            default="",
        )
        if worst:
            verdict = Verdict(about, verdict_of(names[0]), worst, largest[worst], _meaning(worst))
            found.append(verdict)
        elif verdict_of(names[0]) != FINE:
            found.append(Verdict(about, verdict_of(names[0])))
    return tuple(sorted(found, key=_badness))


def _meaning(name: str) -> str:
    return next((text for start, text in _MEANINGS.items() if name.startswith(start)), "")


def urgency(verdict: str) -> int:
    """0 where a setting should change, 1 where a look is due, 2 where all is fine."""
    return 2 if verdict == FINE else 1 if verdict == LOOK else 0


def _badness(item: Verdict) -> tuple[int, float]:
    share = 0.0 if item.largest is None else item.largest / _MOST[item.error]
    return urgency(item.verdict), -share
