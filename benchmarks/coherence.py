"""Whether a stylized sequence holds together: frames in windows against frames alone.

    python -m benchmarks.coherence [--resolution 64] [--frames 24] [--style strokes] [--quick]

Stylizes the example plume with each frame alone and in windows as they are configured (settings are
the defaults but for --set), and alone again with fewer iterations: some of these are as far from
the style as the windows are, and are what the windows' temporal error has to be compared with.
Writes the tables to --report, and to --pictures a plot of the temporal errors, a strip of frames
across a window border, and an animation of frames alone, in windows and of the source. Needs no
data but the repository; on one core about an hour.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.circumstances import circumstances
from benchmarks.coherence_measures import (
    Distances,
    border_ratio,
    style_distances,
    temporal_errors,
    unmoved_distance,
)
from benchmarks.coherence_pictures import draw_animation, draw_flicker, draw_strip
from benchmarks.coherence_runs import Run, Shot, make_shot, run_alone, run_windows, simulate_plume
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.pictures.webp import write_webp

__all__ = ["Findings", "main", "measure", "render_report"]

MARKS = {"share": 0.25, "border": 1.1, "style": 0.05}
SHARES = (0.5, 0.25)  # of the iterations, for frames alone that stop early
STYLE_OF = {"displacement": "grey", "colour": "colour"}  # pictures that show a kind's style
QUICK = ["windows.size=3", "windows.overlap=1", "optimize.iterations=6", "views.pool=2"]
MILLISECONDS = 125  # a frame of the animation: three times slower than the shot
STYLE_SIZE = {False: 512, True: 128}  # pixels, by whether it is quick


@dataclass(frozen=True)
class Stopped:
    """Frames alone with a share of the iterations: means over all frames."""

    share: float
    errors: dict[str, float]  # of neighbours, by kind
    distances: dict[str, float]  # by kind of picture


@dataclass(frozen=True)
class Findings:
    """A shot and what was measured on it; ``errors`` and ``distances`` by way of running."""

    shot: Shot
    runs: dict[str, Run]  # "alone" and "windows"
    errors: dict[str, dict[str, dict[int, np.ndarray]]]  # then by kind and by lag, frames
    distances: dict[str, Distances]
    unmoved: float  # grey distance of the source itself
    stopped: list[Stopped]  # descending share, all iterations first


def measure(shot: Shot) -> Findings:
    """Stylize the shot in all ways and measure the results."""
    runs = {}
    for name, stylize in (("alone", run_alone), ("windows", run_windows)):
        runs[name] = stylize(shot)
        print(f"{name}: {runs[name].seconds:.0f} s CPU", file=sys.stderr, flush=True)
    errors = {name: temporal_errors(run, shot.scene.gamma_w) for name, run in runs.items()}
    distances = {name: style_distances(shot, run) for name, run in runs.items()}
    stopped = [_means(1.0, errors["alone"], distances["alone"])]
    for share in SHARES:
        early = run_alone(stop_early(shot, share))
        stopped.append(
            _means(share, temporal_errors(early, shot.scene.gamma_w), style_distances(shot, early))
        )
        print(f"alone, {share:.0%}: {early.seconds:.0f} s CPU", file=sys.stderr, flush=True)
    return Findings(
        shot, runs, errors, distances, unmoved_distance(shot, runs["alone"]), stopped
    )  # fmt: skip


def stop_early(shot: Shot, share: float) -> Shot:
    """The shot with a share of the iterations in every octave, at least one."""
    config = shot.config
    fewer = {
        step: getattr(config, step).replace(
            iterations=[max(1, round(share * n)) for n in getattr(config, step).iterations],
        )
        for step in config.optimize.steps
    }
    return replace(shot, config=config.replace(**fewer))


def error_at_equal_style(stopped: Sequence[Stopped], kind: str, distance: float) -> float:
    """The temporal error of frames alone that stop at a style distance; linear in between.

    Args:
        stopped: two at least.
        kind: displacement or colour.
        distance: of the pictures that show its style.

    Returns:
        NaN where none stops that near to the style, or that far from it.
    """
    points = sorted((item.distances[STYLE_OF[kind]], item.errors[kind]) for item in stopped)
    found, errors = zip(*points, strict=True)
    return float(np.interp(distance, found, errors, left=np.nan, right=np.nan))


def _means(share: float, errors: dict[str, dict[int, np.ndarray]], distances: Distances) -> Stopped:
    return Stopped(
        share,
        {kind: float(found[1].mean()) for kind, found in errors.items()},
        {"colour": float(distances.colour.mean()), "grey": float(distances.grey.mean())},
    )


def render_report(findings: Findings, style: str, arguments: Sequence[str]) -> str:
    """The tables as Markdown."""
    shot, windows = findings.shot, findings.runs["windows"]
    config, shape = shot.config.windows, shot.frames[0].density.values.shape
    n = len(shot.frames)
    lines = [
        "# Frames that hold together",
        "",
        f"The example plume, {' x '.join(map(str, shape))} voxels, {n} frames, style `{style}`.",
        f"*Alone*: every frame a window of its own. *Windows*: of {config.size} frames with an",
        f"overlap of {config.overlap}, {config.shared_octaves} octaves shared. Temporal errors are",
        "the share of the pattern that does not move with the smoke, 1 for one drawn anew, means",
        f"over all frames; *border* are the {len(windows.touched)} of {n - 1} steps that blending",
        "has a hand in, *inside* the others. Style distances are the optimiser's own loss of",
        "finished pictures, from views that it never had. All is measured after blending.",
        "",
        "| | alone | windows | ratio | mark | inside | border / inside, mean | most | mark |",
        "|---|---|---|---|---|---|---|---|---|",
        *(_error_row(findings, kind) for kind in ("displacement", "colour")),
        "",
        "| temporal error over so many frames | alone | windows | ratio |",
        "|---|---|---|---|",
        *_lag_rows(findings),
        "",
        "| style distance | alone | windows | change | mark |",
        "|---|---|---|---|---|",
        *(_style_row(findings, kind) for kind in ("colour", "grey")),
        "",
        "At equal style distance: frames alone with fewer iterations are farther from the style;",
        "*alone* is their error where they are as far from it as the windows are.",
        "",
        "| at equal style distance | distance | alone | windows | ratio | mark |",
        "|---|---|---|---|---|---|",
        *(_equal_row(findings, kind) for kind in STYLE_OF),
        "",
        "| frames alone, share of iterations | displacement error | grey distance | colour error "
        "| colour distance |",
        "|---|---|---|---|---|",
        *(_stopped_row(item) for item in findings.stopped),
        "",
        *_notes(findings),
        "",
        *circumstances(["python -m benchmarks.coherence", *arguments]),
    ]
    return "\n".join(lines) + "\n"


def _error_row(findings: Findings, kind: str) -> str:
    alone, windows = (findings.errors[name][kind][1] for name in ("alone", "windows"))
    touched = findings.runs["windows"].touched
    mean, most = border_ratio(windows, touched)
    inside = np.delete(windows, list(touched)).mean()
    ratio = windows.mean() / alone.mean()
    cells = [
        f"temporal error, {kind}", f"{alone.mean():.3f}", f"{windows.mean():.3f}", f"{ratio:.2f}",
        _verdict(ratio, MARKS["share"]), f"{inside:.3f}", f"{mean:.2f}", f"{most:.2f}",
        _verdict(mean, MARKS["border"]),
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def _lag_rows(findings: Findings) -> list[str]:
    """What drifts has a larger error over more frames; what boils has not."""
    rows = []
    for kind, by_lag in findings.errors["windows"].items():
        for lag, errors in by_lag.items():
            alone, windows = findings.errors["alone"][kind][lag].mean(), errors.mean()
            cells = [f"{kind}, {lag}", f"{alone:.3f}", f"{windows:.3f}", f"{windows / alone:.2f}"]
            rows.append("| " + " | ".join(cells) + " |")
    return rows


def _style_row(findings: Findings, kind: str) -> str:
    alone, windows = (
        float(getattr(findings.distances[name], kind).mean()) for name in ("alone", "windows")
    )
    change = windows / alone - 1
    verdict = _verdict(abs(change), MARKS["style"], "±5 %")
    return f"| {kind} pictures | {alone:.3f} | {windows:.3f} | {change:+.1%} | {verdict} |"


def _equal_row(findings: Findings, kind: str) -> str:
    distance = float(getattr(findings.distances["windows"], STYLE_OF[kind]).mean())
    alone = error_at_equal_style(findings.stopped, kind, distance)
    windows = float(findings.errors["windows"][kind][1].mean())
    cells = [
        f"temporal error, {kind}", f"{distance:.3f}", f"{alone:.3f}", f"{windows:.3f}",
        f"{windows / alone:.3f}", _verdict(windows / alone, MARKS["share"]),
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def _stopped_row(item: Stopped) -> str:
    numbers = (
        number
        for kind, pictures in STYLE_OF.items()
        for number in (item.errors[kind], item.distances[pictures])
    )
    return f"| {item.share:.0%} | " + " | ".join(f"{number:.3f}" for number in numbers) + " |"


def _verdict(value: float, limit: float, text: str = "") -> str:
    return f"{text or f'≤ {limit:g}'} {'met' if value <= limit else 'missed'}"


def _notes(findings: Findings) -> list[str]:
    runs, n = findings.runs, len(findings.shot.frames)
    density, emission = np.array(runs["windows"].differences).mean(axis=0)
    alone, windows = (runs[name].seconds / n for name in ("alone", "windows"))
    return [
        f"- CPU seconds a frame: {alone:.1f} alone, {windows:.1f} in windows, of which the coarse",
        f"  step takes {runs['windows'].coarse_seconds / n:.1f}; frames of overlaps, done twice,",
        "  are counted with their shot's.",
        f"- The two versions of a frame in an overlap differ by {density:.1%} in density and",
        f"  {emission:.1%} in emission, on average.",
        f"- Grey pictures of the source itself have a style distance of {findings.unmoved:.3f}.",
    ]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parse(arguments)
    settings = [*(QUICK if options.quick else []), *options.settings]
    try:
        frames = simulate_plume(options.resolution, options.frames)
        findings = measure(make_shot(frames, options.style, settings, STYLE_SIZE[options.quick]))
        report = render_report(findings, options.style, arguments or sys.argv[1:])
        for folder in (options.report.parent, options.pictures):
            folder.mkdir(parents=True, exist_ok=True)
        options.report.write_text(report, encoding="utf-8")
        neighbours = {
            name: {kind: by_lag[1] for kind, by_lag in kinds.items()}
            for name, kinds in findings.errors.items()
        }
        draw_flicker(neighbours, findings.runs["windows"]).save(
            options.pictures / "flicker.png", optimize=True
        )
        strip = draw_strip(findings.runs, findings.shot).quantize(dither=Image.Dither.NONE)
        strip.save(options.pictures / "coherence_strip.png", optimize=True)
        animation = draw_animation(findings.runs, findings.shot)
        write_webp(options.pictures / "coherence.webp", animation, [MILLISECONDS] * len(animation))
    except (OSError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.coherence: {error}", file=sys.stderr)
        return 1
    print(report)
    return 0


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--resolution", type=int, help="voxels across the plume's box: 64")
    parser.add_argument("--frames", type=int, help="24")
    parser.add_argument("--style", default="strokes", help="one of the example styles")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    parser.add_argument("--report", type=Path, default=Path("benchmarks/results/coherence.md"))
    parser.add_argument("--pictures", type=Path, default=Path("docs/pictures"))
    parser.add_argument("--quick", action="store_true", help="small, few iterations: to try it")
    options = parser.parse_args(arguments)
    options.resolution = options.resolution or (24 if options.quick else 64)
    options.frames = options.frames or (6 if options.quick else 24)
    return options


if __name__ == "__main__":
    sys.exit(main())
