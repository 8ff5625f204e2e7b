"""The cheapest settings whose estimated errors stay below a tolerance, from a calibration.

The tolerance E bounds three things, each by itself:

- what discretisation does to the picture and the grids: half of E goes to the resolution, a quarter
  to the transport, an eighth each to 16-bit floats and to pruning. An estimate may be wrong by a
  factor, so each has to stay below half of its part;
- the decrease of the loss that the optimiser leaves, as a share of the whole fall;
- the standard error of the loss over the pool of views, relative to the loss.

It says nothing of errors between frames.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Choice", "choose_settings", "user_values"]

SAFETY = 2.0
FEWEST_VIEWS, MOST_VIEWS = 4, 64
FEWEST_ITERATIONS, LARGEST_FACTOR = 10, 4.0
HARDLY_FALLEN = 0.9  # share of its fall that a pilot has before it, beyond which it tells nothing


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
        """Take a value, unless the user has said something else."""
        if name in self.user:
            self.notes.append(f"{name}={self.user[name]} as set; the tolerance asks for {value}")
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
    """What a tolerance comes to.

    Args:
        measured: from ``core.calibrate``; empty where there is nothing to do.
        target: E, > 0.
        iterations: the steps' lists per octave, whose proportions are kept.
        set_by_user: settings by dotted name that win over the choice.
    """
    choices = _Choices(set_by_user)
    if measured:
        _choose_picture(choices, measured, target / 2)
        _choose_transport(choices, measured, target / 4)
        _choose_storage(choices, measured, target / 8)
        for step, found in measured["steps"].items():
            _choose_iterations(choices, step, found, target, iterations[step])
        _choose_views(choices, measured["view_deviation"], target)
    return Choice(choices.settings, tuple(choices.notes))


def _choose_picture(choices: _Choices, measured: Mapping[str, Any], part: float) -> None:
    sizes = measured["image_sizes"]
    if sizes:
        fits = [pair for pair in sizes if SAFETY * pair[1] <= part]
        size, error = fits[0] if fits else sizes[-1]
        choices.take("views.image_size", int(size), _judged("resolution", error, part))
    quadrature = measured["quadrature"]
    choices.notes.append(
        f"{_judged('quadrature', quadrature, part)}; its step is the voxel, which is no choice"
    )


def _choose_transport(choices: _Choices, measured: Mapping[str, Any], part: float) -> None:
    errors = measured["transport"]
    if "shape" in measured["steps"]:
        scheme = "linear" if SAFETY * errors["linear"] <= part else "cubic"
        choices.take("shape.interpolation", scheme, _judged("transport", errors[scheme], part))


def _choose_storage(choices: _Choices, measured: Mapping[str, Any], part: float) -> None:
    half = SAFETY * measured["half"] <= part
    choices.take("grids.half", half, _judged("16-bit floats", measured["half"], part))
    fits = [pair for pair in measured["prune"] if SAFETY * pair[0] <= part]
    lost, level = fits[-1] if fits else (0.0, 0.0)
    choices.take("grids.prune", level, _judged("pruning", lost, part))


def _choose_iterations(
    choices: _Choices, step: str, found: Mapping[str, float], target: float, planned: Sequence[int]
) -> None:
    """The pilot's tail goes on like an exponential: share(n) = remaining^(n / pilot)."""
    if "optimize.iterations" in choices.user:
        choices.notes.append(f"{step}.iterations follow from optimize.iterations, which is set")
        return
    share = found["remaining"]
    if share > HARDLY_FALLEN:
        choices.notes.append(f"{step}.iterations stay: the pilot's loss did not fall")
        return
    factor = min(math.log(SAFETY / target) / -math.log(share), LARGEST_FACTOR) if target < 1 else 0
    wanted = [max(math.ceil(n * factor - 1e-9), FEWEST_ITERATIONS) if n else 0 for n in planned]
    left = share**factor
    why = f"the loss would then have {left:.2g} of its fall left (wanted {target / SAFETY:.2g})"
    choices.take(f"{step}.iterations", wanted, why)


def _choose_views(choices: _Choices, deviation: float, target: float) -> None:
    wanted = math.ceil((deviation / target) ** 2)
    pool = min(max(wanted, FEWEST_VIEWS), MOST_VIEWS)
    error = deviation / math.sqrt(pool)
    choices.take("views.pool", pool, _judged("view sampling", error, target))


def _judged(what: str, error: float, part: float) -> str:
    kept = "of" if SAFETY * error <= part or what == "view sampling" else "more than its part,"
    return f"{what} {error:.2g}, {kept} {part:.2g}"


def user_values(
    given: Mapping[str, Mapping[str, Any]],
    defaults: Mapping[str, Mapping[str, Any]],
    explicit: Collection[str],
) -> dict[str, Any]:
    """Settings by dotted name that are not the defaults, or that were named."""
    return {
        f"{section}.{key}": value
        for section, values in given.items()
        for key, value in values.items()
        if value != defaults[section][key] or f"{section}.{key}" in explicit
    }
