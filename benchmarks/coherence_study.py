"""The runs of benchmarks.coherence: what is stylized, how, and what is kept of each.

Figures and pictures of a run are written when it ends, so that a study that was stopped goes on
with the runs that are missing. A kept run is used if the settings of its way are still the same.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.coherence_measures import style_distances, temporal_errors
from benchmarks.coherence_pictures import draw_panels
from benchmarks.coherence_runs import (
    Run,
    Shot,
    make_shot,
    run_alone,
    run_windows,
    simulate_plume,
    some_frames,
)
from usdsmoke.config.resolve import resolve_config

__all__ = [
    "ALONE",
    "LONGER",
    "PLAN",
    "QUICK",
    "WAYS",
    "WINDOWS",
    "Case",
    "Kept",
    "Study",
    "keep_runs",
    "load_panels",
    "make_case_shot",
    "same_smoke",
]

ALONE, LONGER, WINDOWS = "alone", "alone for longer", "windows"
_DEFAULTS = resolve_config()
_TWICE = tuple(
    f"{step}.iterations={[2 * n for n in getattr(_DEFAULTS, step).iterations]}".replace(" ", "")
    for step in ("shape", "colour")
)
# What the ways to stylize a sequence change from the defaults. One way has a setting of each step:
# displacements do not depend on those of colour.
WAYS: Mapping[str, Sequence[str]] = {
    ALONE: ("windows.size=1",),
    LONGER: ("windows.size=1", *_TWICE),
    WINDOWS: (),
    "one window": (),
    "one window for longer": _TWICE,
    "crisper": ("windows.steadiness=0.08", "colour.warm_rate=0.7"),
    "steadier": ("windows.steadiness=0.8", "colour.warm_rate=0.25"),
    "much steadier": ("windows.steadiness=2.5", "colour.warm_rate=0.175"),
}


@dataclass(frozen=True)
class Case:
    """A way to stylize frames of the example plume, counted from 1."""

    resolution: int
    style: str
    seed: int
    way: str
    codes: tuple[int, ...]

    @property
    def name(self) -> str:
        """Of its files."""
        parts = (self.resolution, self.style, self.seed, self.way, self.codes[0], self.codes[-1])
        return "-".join(str(part).replace(" ", "_") for part in parts)


@dataclass(frozen=True)
class Kept:
    """What was measured of a run; by timeCode where frames have figures."""

    case: Case
    settings: list[str]
    distances: dict[str, dict[int, float]]  # by kind of picture
    errors: dict[str, dict[int, dict[int, float]]]  # by kind and by frames in between
    seconds: float  # of CPU for a frame, coarse step included
    starts: list[int]  # first frames of windows, but for the first
    touched: list[int]  # frames that blending has changed the step to
    differences: list[tuple[float, float]]  # of two versions: density, emission
    own: dict[str, dict[int, float]]  # errors of touched steps before blending, mean of versions

    def mean_distance(self, kind: str, codes: Sequence[int]) -> float:
        """The mean style distance of some frames."""
        return float(np.mean([self.distances[kind][code] for code in codes]))

    def mean_error(self, kind: str, lag: int) -> float:
        """The mean temporal error; NaN where no two frames are so far apart."""
        found = list(self.errors[kind].get(lag, {}).values())
        return float(np.mean(found)) if found else float("nan")


@dataclass(frozen=True)
class Study:
    """The runs of one command."""

    shots: tuple[tuple[Case, ...], ...]  # alone, in windows as configured, alone for longer
    curve: tuple[Case, ...]  # other settings, on fewer frames and in one window
    n_frames: int
    settings: tuple[str, ...] = ()  # of all runs
    style_size: int = 512

    @property
    def cases(self) -> tuple[Case, ...]:
        """All runs, in the order in which they are made."""
        return (*(case for shot in self.shots for case in shot), *self.curve)


def _shot(resolution: int, style: str, seed: int, alone: Sequence[int]) -> tuple[Case, ...]:
    return (
        Case(resolution, style, seed, ALONE, tuple(alone)),
        Case(resolution, style, seed, WINDOWS, tuple(range(1, 25))),
        Case(resolution, style, seed, LONGER, FEW),
    )


def _curve(resolution: int, style: str, seed: int, ways: Sequence[str]) -> tuple[Case, ...]:
    window = tuple(range(5, 13))
    alone = (Case(resolution, style, seed, way, FEW) for way in (ALONE, LONGER))
    return (*alone, *(Case(resolution, style, seed, way, window) for way in ways))


FEW = (6, 7, 10, 11)  # frames alone: two steps of one and two of four
ONE = ("one window", "one window for longer")
MORE = (*range(5, 13), 18, 19)  # a piece to be animated, and steps of eight
PLAN = Study(
    shots=(
        _shot(64, "strokes", 0, MORE),
        _shot(64, "strokes", 1, FEW),
        _shot(64, "petals", 0, FEW),
        _shot(64, "waves", 0, FEW),
        _shot(96, "strokes", 0, FEW),
    ),
    curve=(
        *_curve(40, "strokes", 0, (*ONE, "crisper", "steadier", "much steadier")),
        *_curve(40, "strokes", 1, ONE),
        *_curve(40, "waves", 0, ONE),
        *_curve(40, "petals", 0, ONE),
    ),
    n_frames=24,
    settings=("optimize.error_budget=false",),
)
QUICK = Study(
    shots=(
        (
            Case(24, "strokes", 0, ALONE, (1, 2, 3, 4, 5, 6)),
            Case(24, "strokes", 0, WINDOWS, (1, 2, 3, 4, 5, 6)),
        ),
    ),
    curve=(Case(24, "strokes", 0, "steadier", (2, 3, 4)),),
    n_frames=6,
    settings=(
        "windows.size=3",
        "windows.overlap=1",
        "optimize.iterations=6",
        "views.pool=2",
    ),
    style_size=128,
)


def keep_runs(study: Study, folder: Path, most: int | None = None) -> dict[Case, Kept]:
    """The runs of a study: those in the folder, and those that are missing, which are made.

    Args:
        folder: is made if missing; gets a ``.json`` and a ``.npz`` file for each run.
        most: make so many runs at most, and leave the others out; None makes all.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found, left = {}, most
    for case in study.cases:
        settings = [*study.settings, f"optimize.seed={case.seed}", *WAYS[case.way]]
        if case.way not in (ALONE, LONGER, WINDOWS):
            settings += [f"windows.size={len(case.codes)}"]
        kept = _read(folder, case, settings)
        if kept is None:
            if left == 0:
                continue
            left = None if left is None else left - 1
            kept = _measure(case, settings, study, folder)
            print(f"{case.name}: {kept.seconds:.1f} s a frame", file=sys.stderr, flush=True)
        found[case] = kept
    return found


def load_panels(folder: Path, case: Case) -> dict[int, np.ndarray]:
    """The pictures of a kept run by timeCode, [H W 3] uint8."""
    with np.load(folder / f"{case.name}.npz") as file:
        return dict(zip(case.codes, file["panels"], strict=True))


def make_case_shot(case: Case, study: Study, settings: Sequence[str]) -> Shot:
    """All frames of the shot, so that extinction and pictures are the same for every case."""
    frames = _simulate(case.resolution, study.n_frames)
    return make_shot(frames, case.style, settings, study.style_size)


_simulate = cache(simulate_plume)


def _measure(case: Case, settings: Sequence[str], study: Study, folder: Path) -> Kept:
    whole = make_case_shot(case, study, settings)
    shot = some_frames(whole, case.codes)
    run = run_alone(shot) if case.way in (ALONE, LONGER) else run_windows(shot)
    distances = style_distances(shot, run)
    errors = temporal_errors(whole.frames, run, shot.scene.gamma_w)
    kept = Kept(
        case,
        list(settings),
        {
            kind: dict(zip(case.codes, map(float, getattr(distances, kind)), strict=True))
            for kind in ("colour", "grey")
        },
        {
            kind: {
                lag: {round(code): error for code, error in by_code.items()}
                for lag, by_code in by_lag.items()
            }
            for kind, by_lag in errors.items()
        },
        run.seconds / len(case.codes),
        [case.codes[number] for number in run.starts],
        [case.codes[number + 1] for number in run.touched],
        list(run.differences),
        _own_errors(run, whole),
    )
    _write(folder, kept, draw_panels(run, whole))
    return kept


def _own_errors(run: Run, shot: Shot) -> dict[str, dict[int, float]]:
    """What the steps that blending has a hand in have within the windows that take them."""
    found: dict[str, dict[int, list[float]]] = {"displacement": {}, "colour": {}}
    for outcomes in run.versions:
        errors = temporal_errors(shot.frames, Run(outcomes, 0.0), shot.scene.gamma_w)
        for kind, by_lag in errors.items():
            for code, error in by_lag.get(1, {}).items():
                found[kind].setdefault(round(code), []).append(error)
    codes = [round(run.outcomes[number + 1].source.time_code) for number in run.touched]
    return {
        kind: {code: float(np.mean(by_code[code])) for code in codes if code in by_code}
        for kind, by_code in found.items()
    }


def _write(folder: Path, kept: Kept, panels: np.ndarray) -> None:
    np.savez_compressed(folder / f"{kept.case.name}.npz", panels=panels)
    values = {**asdict(kept), "case": list(vars(kept.case).values())}
    (folder / f"{kept.case.name}.json").write_text(json.dumps(values, indent=1), encoding="utf-8")


def _read(folder: Path, case: Case, settings: Sequence[str]) -> Kept | None:
    """A kept run; None if there is none with these settings."""
    file = folder / f"{case.name}.json"
    if not file.exists():
        return None
    values = json.loads(file.read_text(encoding="utf-8"))
    if values["settings"] != list(settings) or tuple(values["case"][-1]) != case.codes:
        return None
    values["case"] = case
    values["distances"] = {kind: _numbered(found) for kind, found in values["distances"].items()}
    values["errors"] = {
        kind: {int(lag): _numbered(by_code) for lag, by_code in by_lag.items()}
        for kind, by_lag in values["errors"].items()
    }
    values["own"] = {kind: _numbered(found) for kind, found in values["own"].items()}
    return Kept(**values)


def _numbered(found: Mapping[str, float]) -> dict[int, float]:
    return {int(code): value for code, value in found.items()}


def same_smoke(one: Case, other: Case) -> bool:
    """Whether two cases differ only in the way and in the frames."""
    return (one.resolution, one.style, one.seed) == (other.resolution, other.style, other.seed)
