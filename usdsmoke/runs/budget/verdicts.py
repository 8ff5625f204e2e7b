"""What to make of a result, part by part: a few rows in plain words, worst first."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from usdsmoke.runs.budget import rows

FINE, LOOK = "fine", "look at it"
_NEAR = 0.1  # share of its bound above which an error is told with it
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
    "seen from other views": (rows.VIEW_SAMPLING, rows.UNSEEN_VIEWS),
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
    "view sampling": "off, with other directions drawn",
    "unseen views": "off, seen from between the optimised directions",
    "temporal": "of the pattern does not move as asked",
    "windows": "between the versions of two windows",
    "storage": "lost by half floats and pruning",
}


@dataclass(frozen=True)
class Verdict:
    """One part of a result."""

    about: str
    verdict: str  # "fine", "look at it" or "change SETTING"
    why: str  # the cause of its worst finding; or what its worst figure says
    error: str = ""  # its worst one; "" where it has no figure
    largest: float | None = None  # of that error over the frames; None likewise


def judge_parts(
    largest: Mapping[str, float], verdict_of: Callable[[str], str], causes: Mapping[str, str]
) -> tuple[Verdict, ...]:
    """A verdict for each part that has an error or a finding.

    Worst first: those that ask for a setting, those that deserve a look, the others; and by how
    near an error comes to the bound above which something is wrong.

    Args:
        largest: of each error over the frames, by name.
        verdict_of: an error's verdict by its name; of "" that on findings of no error.
        causes: of the first finding of each error, by its name or "".
    """
    parts = {_LIGHT: [""]} | {about: [row.name for row in part] for about, part in _PARTS.items()}
    found = []
    for about, names in parts.items():
        names = [name for name in names if name in largest or name in causes]
        if not names:
            continue
        worst = min(names, key=lambda name: (urgency(verdict_of(name)), -_share(name, largest)))
        figure = largest.get(worst)
        why = causes.get(worst) or f"{figure:.2%} {_meaning(worst)}{_bound(worst, largest)}"
        found.append(Verdict(about, verdict_of(worst), why, worst, figure))
    return tuple(sorted(found, key=lambda v: (urgency(v.verdict), -_share(v.error, largest))))


def _share(name: str, largest: Mapping[str, float]) -> float:
    """Of the bound above which something is wrong."""
    return largest[name] / _MOST[name] if name in largest else 0.0


def _meaning(name: str) -> str:
    text = next((text for start, text in _MEANINGS.items() if name.startswith(start)), "")
    span = name.rpartition(", ")[2]  # "8 frames", in which more changes than from one to the next
    return f"{text} within {span}" if span.endswith("frames") else text


def _bound(name: str, largest: Mapping[str, float]) -> str:
    """Above what the error says that something is wrong, if it is not far below."""
    return f"; bound {100 * _MOST[name]:.3g}%" if _share(name, largest) > _NEAR else ""


def urgency(verdict: str) -> int:
    """0 where a setting should change, 1 where a look is due, 2 where all is fine."""
    return 2 if verdict == FINE else 1 if verdict == LOOK else 0
