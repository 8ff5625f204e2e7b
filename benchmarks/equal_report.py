"""What both sides of ``benchmarks.equal_loss`` came to, and the tables of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from benchmarks.circumstances import circumstances
from benchmarks.equal_judge import Verdict

__all__ = ["Comparison", "Point", "render_report"]

MARK = 10.0  # times shorter


@dataclass(frozen=True)
class Point:
    """One result of one side."""

    iterations: int
    cpu_s: float
    verdict: Verdict


@dataclass
class Comparison:
    """Both sides on one scene and step."""

    scene: str
    step: str
    box: tuple[int, ...]
    voxels: int
    start: Verdict
    baseline: list[Point] = field(default_factory=list)
    ours: dict[int, Point] = field(default_factory=dict)  # median seconds, by iterations
    repeats: dict[int, list[float]] = field(default_factory=dict)

    def reached(self, loss: float) -> Point | None:
        """The quickest of ours with at most this loss."""
        found = [point for point in self.ours.values() if point.verdict.loss <= loss]
        return min(found, key=lambda point: point.cpu_s) if found else None

    @property
    def end(self) -> Point:
        """The baseline's last result."""
        return self.baseline[-1]

    @property
    def best(self) -> Point:
        """The baseline at its least loss: its end, unless it has become worse on the way there."""
        return min(self.baseline, key=lambda point: point.verdict.loss)

    @property
    def targets(self) -> list[Point]:
        """What is to be reached: the end, and the least loss where that is another."""
        return [self.end] if self.best is self.end else [self.end, self.best]

    def ratio(self, target: Point) -> float | None:
        """How many times shorter ours takes to a result's loss."""
        found = self.reached(target.verdict.loss)
        return target.cpu_s / found.cpu_s if found else None


def render_report(found: Sequence[Comparison], about: str, command: Sequence[str]) -> str:
    """Markdown: ``about``, a table of the ends, and one of the way there."""
    lines = [
        "# Time to equal style loss",
        "",
        *about.strip().splitlines(),
        "",
        "The baseline's last result, and its least loss where it got worse after that; usdsmoke's",
        f"quickest result that has no more; set-up is in all seconds. Mark: {MARK:g} times less",
        "for the last result. usdsmoke's shape step has iterations in its finest octave alone, and",
        "neither side estimates its own errors.",
        "Patches, colours, spectrum: closures on the same views, where 1 is the style pasted",
        "through the mask; the shape step has no colours to compare.",
        "",
        "| scene | box | voxels | step | loss at start | baseline: iterations x views | CPU s "
        "| loss | usdsmoke: iterations | CPU s | loss | times shorter | mark |",
        "|" + "---|" * 13,
        *(_row(comparison, at) for comparison in found for at in comparison.targets),
        "",
        *_both_steps(found),
        "On the way there, and what measures say that neither side minimises:",
        "",
        "| scene | step | side | iterations | CPU s | loss | patches | colours | spectrum |",
        "|" + "---|" * 9,
    ]
    for comparison in found:
        sides = [("baseline", comparison.baseline)]
        sides.append(("usdsmoke", [comparison.ours[n] for n in sorted(comparison.ours)]))
        lines += [_point_row(comparison, side, p) for side, points in sides for p in points]
    return "\n".join([*lines, "", *circumstances(command)]) + "\n"


def _row(found: Comparison, target: Point) -> str:
    ours, ratio = found.reached(target.verdict.loss), found.ratio(target)
    reached = [ours.iterations, f"{ours.cpu_s:.2f}", f"{ours.verdict.loss:.3f}"] if ours else []
    cells = [
        found.scene, " x ".join(map(str, found.box)), found.voxels, found.step,
        f"{found.start.loss:.3f}", f"{target.iterations} x 9", f"{target.cpu_s:.1f}",
        f"{target.verdict.loss:.3f}",
        *(reached or ["-"] * 3),
        f"{ratio:.1f}" if ratio else "not reached",
        _verdict(ratio) if target is found.end else "(its least loss)",
    ]  # fmt: skip
    return "| " + " | ".join(map(str, cells)) + " |"


def _verdict(ratio: float | None) -> str:
    return "met" if ratio and ratio >= MARK else "missed"


def _point_row(found: Comparison, side: str, point: Point) -> str:
    others = [f"{value:.2f}" for value in point.verdict.closures.values()] or ["", "", ""]
    cells = [found.scene, found.step, side, point.iterations, f"{point.cpu_s:.2f}"]
    return "| " + " | ".join(map(str, [*cells, f"{point.verdict.loss:.3f}", *others])) + " |"


def _both_steps(found: Sequence[Comparison]) -> list[str]:
    """One line a scene: both steps together."""
    lines = []
    for scene in dict.fromkeys(comparison.scene for comparison in found):
        of_scene = [comparison for comparison in found if comparison.scene == scene]
        ends = [(c.end, c.reached(c.end.verdict.loss)) for c in of_scene]
        theirs = sum(last.cpu_s for last, _ in ends)
        ours = [point.cpu_s for _, point in ends if point is not None]
        if len(ours) == len(ends):
            ratio = theirs / sum(ours)
            lines += [
                f"- {scene}, {' and '.join(c.step for c in of_scene)}: {theirs:.1f} against "
                f"{sum(ours):.2f} CPU s, {ratio:.1f} times shorter "
                f"(mark {MARK:g}: {_verdict(ratio)})."
            ]
    return [*lines, ""]
