"""What a tolerance E bounds: which rows of the error budget, each by which part of E.

The parts of what discretisation does to picture and grids add up to E; the optimiser and the views
have E each. ``error_choice`` aims at half of every part, as an estimate may be wrong by a factor;
at the end of a run its own estimates, the largest over the frames, are held against the whole part.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["PARTS", "PICTURE_SAFETY", "SAFETY", "Tolerance", "Verdict", "judge", "part_of"]

SAFETY = 2.0  # between an estimate before the run and its bound
PICTURE_SAFETY = 4.0  # of the resolution: strokes get finer while the optimiser goes on
PARTS: Mapping[str, float] = {
    "quadrature": 1
    / 2,  # slabs are among what the resolution's estimate changes: no part of its own
    "resolution": 1 / 2,
    "transport": 1 / 4,
    "storage, density": 1 / 4,  # 16-bit floats and pruning
    "storage, emission": 1 / 4,
    "optimiser, shape": 1.0,
    "optimiser, colour": 1.0,
    "view sampling": 1.0,
    "unseen views": 1.0,
}
_FINER = (
    "the strokes are about as fine as the pixels, so larger pictures and finer voxels hardly "
    "change it; a tolerance that holds has to be larger"
)
_STORAGE = "set grids.half=false and grids.prune=0"
_VIEWS = "set a larger views.pool"
_ADVICE = {
    "quadrature": "set grids.refine=2: the step along the rays is a voxel",
    "resolution": _FINER,
    "transport": "set grids.refine=2, or a smaller shape.reach",
    "storage, density": _STORAGE,
    "storage, emission": _STORAGE,
    "optimiser, shape": "set more shape.iterations",
    "optimiser, colour": "set more colour.iterations",
    "view sampling": _VIEWS,
    "unseen views": _VIEWS,
}


@dataclass(frozen=True)
class Verdict:
    """A bounded row at the end of a run."""

    name: str
    value: float  # the largest over the frames that are judged
    bound: float

    @property
    def kept(self) -> bool:
        """Whether the value is not above the bound."""
        return self.value <= self.bound

    def __str__(self) -> str:
        return f"{self.value:.2%}, of {self.bound:.2%}"


@dataclass(frozen=True)
class Tolerance:
    """How a run kept the tolerance that its settings were chosen for."""

    target: float
    verdicts: tuple[Verdict, ...]
    unknown: Mapping[str, str]  # bounded rows that were not estimated, and why

    @property
    def broken(self) -> tuple[Verdict, ...]:
        """What is above its bound."""
        return tuple(verdict for verdict in self.verdicts if not verdict.kept)

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each row that is above its bound, with what to do."""
        return tuple(
            f"the tolerance of {self.target:g} is not kept: {item.name} is {item}; "
            f"{_ADVICE[item.name]}"
            for item in self.broken
        )

    def __str__(self) -> str:
        if self.broken:
            names = "; ".join(f"{item.name} ({item})" for item in self.broken)
            found = f"{self.target:g}: NOT kept by {names}"
        else:
            found = f"{self.target:g}: kept by all {len(self.verdicts)} bounded errors"
        unknown = f"; not estimated: {', '.join(self.unknown)}" if self.unknown else ""
        return f"{found}{unknown}"

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        rows = [{**asdict(item), "kept": item.kept} for item in self.verdicts]
        return {
            "target": self.target, "kept": not self.broken, "rows": rows,
            "unknown": dict(self.unknown),
        }  # fmt: skip

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> "Tolerance":
        """The one that ``to_dict`` gave."""
        rows = [Verdict(row["name"], row["value"], row["bound"]) for row in found["rows"]]
        return cls(found["target"], tuple(rows), found["unknown"])


def part_of(name: str, target: float) -> float:
    """What a row may have of a tolerance."""
    return PARTS[name] * target


def judge(target: float, largest: Mapping[str, float], left_out: Mapping[str, str]) -> Tolerance:
    """How far a run's errors kept a tolerance.

    Args:
        target: E.
        largest: the rows' values, by name; rows that nothing bounds are passed over.
        left_out: why there is none, by name.
    """
    verdicts = [
        Verdict(name, largest[name], part_of(name, target)) for name in PARTS if name in largest
    ]
    unknown = {name: left_out[name] for name in PARTS if name in left_out and name not in largest}
    return Tolerance(target, tuple(verdicts), unknown)
