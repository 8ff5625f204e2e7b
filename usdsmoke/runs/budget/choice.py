"""The cheapest settings whose estimated errors stay below a tolerance, from a calibration.

``rows`` declares which part of a tolerance each error may have. An estimate may be wrong by a
factor (``ErrorRow.safety``), so it stays below the bound by that factor. Each choice, and each that
cannot be made, has a sentence in the plan.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from usdsmoke.base.frame_report import LEAST_MOVE
from usdsmoke.runs.budget.rows import (
    COLOUR_OPTIMISER,
    QUADRATURE,
    RESOLUTION,
    SAFETY,
    SHAPE_OPTIMISER,
    STORAGE_DENSITY,
    TRANSPORT,
    UNSEEN_VIEWS,
    VIEW_SAMPLING,
)

FEWEST_VIEWS, MOST_VIEWS = 4, 64
FEWEST_ITERATIONS, LARGEST_FACTOR = 10, 10.0
USUAL_HALF = 15.0  # iterations, the "a" below; plumes that were measured have 10 to 20
HARDLY_FALLEN = 0.9  # share of its fall still ahead of a pilot; above it, the fit means nothing
LEAST_LOSS = 0.05  # of a pilot's loss that is expected to stay
_OPTIMISERS = {"shape": SHAPE_OPTIMISER, "colour": COLOUR_OPTIMISER}


@dataclass(frozen=True)
class Choice:
    """Settings by section, and what was found about each, a sentence each."""

    settings: Mapping[str, Mapping[str, Any]]
    notes: tuple[str, ...]


class _Choices:
    def __init__(self, set_by_user: Mapping[str, Any]) -> None:
        self.user = set_by_user
        self.settings: dict[str, dict[str, Any]] = {}
        self.notes: list[str] = []

    def take(self, name: str, value: Any, why: str) -> None:
        """Take a value, unless the user has set another one."""
        if name in self.user:
            self.notes.append(
                f"{name}={self.user[name]} as you set it; the tolerance needs {value}"
            )
            return
        section, _, key = name.partition(".")
        self.settings.setdefault(section, {})[key] = value
        self.notes.append(f"{name}={value}: {why}")


def choose_settings(
    measured: Mapping[str, Any],
    target: float,
    iterations: Mapping[str, Sequence[int]],
    set_by_user: Mapping[str, Any],
) -> Choice:
    """The settings that a tolerance leads to.

    Args:
        measured: from ``core.sequence.calibrate``; empty where there is nothing to do.
        target: E, > 0.
        iterations: the steps' lists per octave, whose proportions are kept.
        set_by_user: settings by dotted name that win over the choice.
    """
    choices = _Choices(set_by_user)
    if not measured:
        why = "the calibrated frame has nothing to stylize: all settings are unchanged"
        return Choice({}, (why,))
    _choose_picture(choices, measured, target)
    _choose_transport(choices, measured["transport"], TRANSPORT.bound(target))
    _choose_storage(choices, measured, STORAGE_DENSITY.bound(target) / 2)
    for step, planned in iterations.items():
        part = _OPTIMISERS[step].bound(target)
        _choose_iterations(choices, step, measured["steps"].get(step), part, planned)
    _choose_views(choices, measured, target)
    return Choice(choices.settings, tuple(choices.notes))


def _choose_picture(choices: _Choices, measured: Mapping[str, Any], target: float) -> None:
    sizes, part = measured["image_sizes"], RESOLUTION.bound(target)
    if sizes:
        fits = [pair for pair in sizes if RESOLUTION.safety * pair[1] <= part]
        size, error = fits[0] if fits else sizes[-1]
        why = _judged(RESOLUTION.name, error, part, RESOLUTION.safety)
        choices.take("views.image_size", int(size), why)
    else:
        choices.notes.append(
            "views.image_size is unchanged: no whole number of voxels per pixel gives 16 to 2048 "
            "pixels"
        )
    quadrature = _judged(QUADRATURE.name, measured["quadrature"], QUADRATURE.bound(target))
    choices.notes.append(f"{quadrature}; its step is one voxel and cannot be chosen")


def _choose_transport(choices: _Choices, errors: Mapping[str, float] | None, part: float) -> None:
    if errors is None:
        choices.notes.append("shape.interpolation is unchanged: there is no shape step")
        return
    scheme = "linear" if SAFETY * errors["linear"] <= part else "cubic"
    why = _judged(TRANSPORT.name, errors[scheme], part)
    if errors["moved"] < LEAST_MOVE:
        why += (
            "; the pilot hardly moved the smoke, so this was measured for a shift of half a voxel"
        )
    choices.take("shape.interpolation", scheme, why)


def _choose_storage(choices: _Choices, measured: Mapping[str, Any], part: float) -> None:
    half = SAFETY * measured["half"] <= part
    error = measured["half"] if half else 0.0
    why = _judged("16-bit floats", error, part) if half else (
        f"16-bit floats would lose {measured['half']:.2g}, too much for {part:.2g}"
    )  # fmt: skip
    choices.take("grids.half", half, why)
    fits = [pair for pair in measured["prune"] if SAFETY * pair[0] <= part]
    lost, level = fits[-1] if fits else (0.0, 0.0)
    choices.take("grids.prune", level, _judged("pruning", lost, part))


def _choose_iterations(
    choices: _Choices,
    step: str,
    found: Mapping[str, Any] | None,
    part: float,
    planned: Sequence[int],
) -> None:
    """After n iterations, F / (1 + n / a) remains of the last octave's fall F.

    The pilot's noisy tail gives ``a`` within a factor of three, and so does the usual value of
    plumes: their geometric mean is taken. What remains is bounded relative to the final loss.
    """
    name = f"{step}.iterations"
    if found is None:
        choices.notes.append(f"{name} are unchanged: there is no {step} step")
        return
    if "optimize.iterations" in choices.user:
        choices.notes.append(f"{name} follow from optimize.iterations, which is set")
        return
    share = found.get("remaining", 1.0)
    if "why" in found or share > HARDLY_FALLEN:
        why = found.get("why", "the pilot's loss hardly fell")
        choices.notes.append(
            f"{name} are unchanged, and the error that they leave is unknown: {why}"
        )
        return
    half, fall = _tail(found)
    finest = next((n for n in reversed(planned) if n), 0)
    allowed = part / SAFETY
    enough = half * (fall * (1 - allowed) / allowed - 1)
    needed = math.ceil(min(max(enough, FEWEST_ITERATIONS), LARGEST_FACTOR * finest))
    left = fall / (1 + needed / half)
    choices.take(
        name,
        _scaled(planned, needed),
        _judged(f"remaining decrease of the {step} step's loss", left / (1 + left), part),
    )


def _tail(found: Mapping[str, float]) -> tuple[float, float]:
    """``a``, and the whole fall F relative to the loss that no iterations go below.

    After the pilot's n iterations F / (1 + n / a) is left, and F is that and what has fallen.
    """
    n, share = found["iterations"], found["remaining"]
    half = math.sqrt(USUAL_HALF * n * share / (1 - share))
    left = found["fallen"] * half / n
    return half, (found["fallen"] + left) / max(1 - left, LEAST_LOSS)


def _scaled(planned: Sequence[int], finest: int) -> list[int]:
    """The last octave with so many iterations, coarser ones in proportion, but not with more."""
    last = max((place for place, n in enumerate(planned) if n), default=None)
    if last is None:
        return list(planned)
    share = min(finest / planned[last], 1.0)
    return [
        finest if place == last else max(math.ceil(n * share), min(n, FEWEST_ITERATIONS))
        for place, n in enumerate(planned)
    ]


def _choose_views(choices: _Choices, measured: Mapping[str, Any], target: float) -> None:
    """Standard errors of means fall as 1 / sqrt(pool), errors of unseen views as 1 / pool."""
    deviation, unseen = measured["view_deviation"], measured["unseen_views"]
    sampling, beside = VIEW_SAMPLING.bound(target), UNSEEN_VIEWS.bound(target)
    n_views = (SAFETY * deviation / sampling) ** 2
    summed = 0.0 if unseen is None else unseen[0] * unseen[1]
    n_views = max(n_views, SAFETY * summed / beside)
    pool = min(max(math.ceil(min(n_views, MOST_VIEWS)), FEWEST_VIEWS), MOST_VIEWS)
    notes = [_judged(VIEW_SAMPLING.name, deviation / math.sqrt(pool), sampling)]
    if unseen is not None:
        notes.append(_judged(UNSEEN_VIEWS.name, summed / pool, beside))
    choices.take("views.pool", pool, "; ".join(notes))


def _judged(what: str, error: float, part: float, safety: float = SAFETY) -> str:
    if safety * error <= 1.001 * part:  # rounding apart
        return f"{what} {error:.2g}, limit {part:.2g}"
    most_accurate = "even at the most accurate settings"
    if error <= part:
        return (
            f"may not be kept: {what}: the estimated error {error:.2g} is below its limit of "
            f"{part:.2g}, but within the safety factor of {safety:g} {most_accurate}"
        )
    return (
        f"cannot be kept: {what}: the estimated error {error:.2g} exceeds its limit of {part:.2g} "
        f"{most_accurate}"
    )
