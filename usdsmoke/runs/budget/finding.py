"""One thing that deserves a look in a run, and several of them as sentences.

A finding names its place, the row of the error budget that it belongs to, the cause and the remedy.
The table, the JSON, the record and the warnings at the end of a run show the same findings.
"""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One thing that deserves a look."""

    place: str  # file of the frame, or path of the Volume
    row: str  # of the error budget; "" for none
    cause: str
    remedy: str
    setting: str = ""  # that the remedy changes; "" where input or result is to be looked at

    @property
    def kind(self) -> tuple[str, str]:
        """Findings of one kind are said once."""
        return self.row, self.remedy


def finding_texts(findings: Iterable[Finding]) -> tuple[str, ...]:
    """The findings as sentences; those of one row and remedy as one, with the first place's causes.

    >>> found = [Finding(f"{name}.vdb", "mass", "mass is 60%", "Look at it") for name in "ab"]
    >>> finding_texts([*found, Finding("a.vdb", "mass", "it is folded", "Look at it")])
    ('a.vdb and 1 more: mass is 60%, and it is folded. Look at it.',)
    """
    alike: dict[tuple[str, str], dict[str, list[str]]] = {}  # causes by place
    for finding in findings:
        alike.setdefault(finding.kind, {}).setdefault(finding.place, []).append(finding.cause)
    texts = []
    for (_, remedy), places in alike.items():
        (first, causes), *others = places.items()
        more = f" and {len(others)} more" if others else ""
        texts.append(f"{first}{more}: {', and '.join(dict.fromkeys(causes))}. {remedy}.")
    return tuple(texts)
