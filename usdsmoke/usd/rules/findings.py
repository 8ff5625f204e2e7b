"""What a check finds: a rule's own note of it, and the line that people and programs are shown."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from usdsmoke.base.time_codes import format_time_codes


class Severity(str, Enum):
    """How bad a finding is; only an error says that the stage cannot be used as it is."""

    ERROR = "error"
    WARN = "warn"
    INFO = "info"

    def __str__(self) -> str:
        return str(self.value)


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, and where."""

    severity: Severity
    rule: str  # "GridMissing" for ours, "usdGeomValidators:Name.Error" for others
    prim_path: str  # a property's path where one is meant; "" for a whole layer or stage
    time_code: float | None  # the first one concerned; None when time plays no part
    message: str


@dataclass(frozen=True)
class Problem:
    """A finding as a rule notes it, before USD has carried it."""

    severity: Severity
    prim_path: str
    message: str
    time_code: float | None = None


def grouped(
    severity: Severity, prim_path: str, troubles: Mapping[float | None, str]
) -> list[Problem]:
    """One problem for each different trouble, naming all timeCodes that have it.

    Args:
        severity: of all of them.
        prim_path: of the prim they concern.
        troubles: text by timeCode; None stands for a value that has no time samples.
    """
    codes_of: dict[str, list[float]] = {}
    for code, text in troubles.items():
        codes_of.setdefault(text, []).extend([] if code is None else [code])
    problems = []
    for text, codes in codes_of.items():
        others = sorted(codes)[1:]
        also = f" (also at timeCodes {format_time_codes(others)})" if others else ""
        problems.append(Problem(severity, prim_path, text + also, min(codes, default=None)))
    return problems
