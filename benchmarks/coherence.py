"""Whether a stylized sequence holds together: frames in windows against frames alone.

    python -m benchmarks.coherence [--keep FOLDER] [--runs N] [--quick]

Stylizes the example plume with each frame alone, in windows as they are configured, with each frame
alone for twice the iterations, and with other settings of steadiness and of warm starts
(``coherence_study.WAYS``): style distance against temporal error. What a run has shown is kept in
--keep, so that a command that was stopped goes on. Writes the tables to --report, and to --pictures
a plot of the temporal errors, a strip of frames across a window border, and an animation of frames
alone, in windows and of the source. Needs no data but the repository.
"""

import argparse
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.circumstances import circumstances, publish
from benchmarks.coherence_measures import border_ratio
from benchmarks.coherence_pictures import draw_animation, draw_flicker, draw_strip
from benchmarks.coherence_study import (
    ALONE,
    LONGER,
    PLAN,
    QUICK,
    WAYS,
    WINDOWS,
    Case,
    Kept,
    Study,
    keep_runs,
    load_panels,
    make_case_shot,
    same_smoke,
)
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.pictures.animations import write_webp

__all__ = ["main", "render_report"]

MARKS = {"share": 0.25, "border": 1.1, "step": 1.25, "style": 0.05}
SHOT_WAYS = (ALONE, LONGER, WINDOWS)
STYLE_OF = {"displacement": "grey", "colour": "colour"}  # pictures that show a kind's style
MILLISECONDS = 125  # a frame of the animation: three times slower than the shot
KEPT = Path("benchmarks/results/coherence")  # the figures of the committed table
Runs = Mapping[Case, Kept]


def render_report(runs: Runs, study: Study, words: Sequence[str]) -> str:
    """The tables as Markdown."""
    lines = [
        "# Frames that hold together",
        "",
        "The example plume in windows as configured. *Alone*: each frame a window of its own;",
        "*alone for longer*: with twice the iterations, as frames alone are not at their end by",
        "default. Temporal errors are the share of the pattern that does not move with the smoke,",
        "in excess of an exact look-up; 1 is one drawn anew. *Border*: the steps that blending has",
        "a hand in; *inside*: the others. Style distances are the optimiser's own loss of finished",
        "pictures, from views that it never had, means of the frames that both have. All is",
        "measured after blending. CPU seconds are without estimates of errors.",
    ]
    for shot in study.shots:
        made = {case.way: runs[case] for case in shot if case in runs}
        if {ALONE, WINDOWS} <= made.keys():
            lines += _shot_lines(made)
    lines += [
        "",
        "## Other settings",
        "",
        "One window, without a coarse step and blending. A way changes settings of both steps;",
        "displacements do not depend on those of colour. Percentages: farther from the style than",
        "the same frames alone; ratios: of their error.",
        "",
        *(f"- *{way}*: {_settings_text(way)}." for way in WAYS if way not in SHOT_WAYS),
        "",
        "| plume | way | grey distance | colour distance | displacement error, over "
        "1, 4, 8 frames | colour error, over 1, 4, 8 frames | CPU s a frame |",
        "|---|---|---|---|---|---|---|",
        *_curve_rows(runs, study),
        "",
        f"- All runs together took {_cpu_minutes(runs):.0f} minutes of CPU.",
        f"- Not made yet: {_missing(runs, study)}.",
        *circumstances(words),
    ]
    return "\n".join(lines) + "\n"


def _shot_lines(made: Mapping[str, Kept]) -> list[str]:
    """A section on one shot, by way."""
    alone, windows = made[ALONE], made[WINDOWS]
    case = windows.case
    return [
        "",
        f"## {_smoke(case)}, {len(case.codes)} frames",
        "",
        "| | grey distance | colour distance | displacement error, over 1, 4, 8 frames "
        "| colour error, over 1, 4, 8 frames | CPU s a frame |",
        "|---|---|---|---|---|---|",
        *(_row(way, made[way], alone) for way in SHOT_WAYS if way in made),
        "",
        "| temporal error over one frame | windows / alone | mark | border / inside, mean | mark "
        "| worst step | mark | border / the same steps before blending, mean | worst step |",
        "|---|---|---|---|---|---|---|---|---|",
        *(_border_row(kind, windows, alone) for kind in STYLE_OF),
        "",
        *_notes(made),
    ]


def _smoke(case: Case) -> str:
    """What a run and those that it is compared with have in common."""
    return f"{case.resolution} voxels, `{case.style}`, seed {case.seed}"


def _cpu_minutes(runs: Runs) -> float:
    return sum(kept.seconds * len(case.codes) for case, kept in runs.items()) / 60


def _missing(runs: Runs, study: Study) -> str:
    """The runs that have not been made yet."""
    names = [case.name for case in study.cases if case not in runs]
    return ", ".join(names) or "none"


def _settings_text(way: str) -> str:
    return ", ".join(f"`{text}`" for text in WAYS[way]) or "the defaults"


def _row(name: str, kept: Kept, alone: Kept) -> str:
    """Style distances of the frames that both have, temporal errors, and time."""
    codes = sorted(set(kept.case.codes) & set(alone.case.codes))
    cells = []
    for kind in ("grey", "colour"):
        distance, other = (one.mean_distance(kind, codes) for one in (kept, alone))
        change = "" if kept is alone else f" ({distance / other - 1:+.1%})"
        cells.append(f"{distance:.3f}{change}")
    for kind in STYLE_OF:
        errors = (kept.mean_error(kind, lag) for lag in (1, 4, 8))
        text = ", ".join("-" if np.isnan(error) else f"{error:.3f}" for error in errors)
        if kept is not alone:
            text += f" ({kept.mean_error(kind, 1) / alone.mean_error(kind, 1):.2f})"
        cells.append(text)
    return f"| {name} | " + " | ".join([*cells, f"{kept.seconds:.1f}"]) + " |"


def _curve_rows(runs: Runs, study: Study) -> list[str]:
    rows = []
    alones = [kept for case, kept in runs.items() if case.way == ALONE]
    for case in study.curve:
        if case not in runs:
            continue
        (alone, *_) = (kept for kept in alones if same_smoke(kept.case, case))
        rows.append(_row(f"{_smoke(case)} | {case.way}", runs[case], alone))
    return rows


def _border_row(kind: str, windows: Kept, alone: Kept) -> str:
    ratio = windows.mean_error(kind, 1) / alone.mean_error(kind, 1)
    steps = windows.errors[kind][1]
    touched = [number for number, code in enumerate(sorted(steps)) if code in windows.touched]
    mean, most = border_ratio(np.array([steps[code] for code in sorted(steps)]), touched)
    added = [steps[code] / own for code, own in windows.own[kind].items()]
    cells = [
        kind,
        f"{ratio:.3f}", _verdict(ratio, MARKS["share"]),
        f"{mean:.2f}", _verdict(mean, MARKS["border"]),
        f"{most:.2f}", _verdict(most, MARKS["step"]),
        f"{np.mean(added):.2f}", f"{max(added):.2f}",
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def _notes(made: Mapping[str, Kept]) -> list[str]:
    windows = made[WINDOWS]
    density, emission = np.array(windows.differences).mean(axis=0)
    return [
        *(_distance_note(windows, made[way]) for way in (ALONE, LONGER) if way in made),
        f"- The two versions of a frame in an overlap differ by {density:.1%} in density and "
        f"{emission:.1%} in emission, on average.",
        f"- Worst steps: displacement to frame {_worst(windows, 'displacement')}, colour to frame "
        f"{_worst(windows, 'colour')}; windows begin with frames "
        f"{', '.join(map(str, windows.starts))}.",
    ]


def _distance_note(windows: Kept, alone: Kept) -> str:
    """Style distances of the frames that both have; windows may be nearer without a limit."""
    changes = []
    for kind in ("grey", "colour"):
        found, other = (one.mean_distance(kind, alone.case.codes) for one in (windows, alone))
        farther = found / other - 1
        changes.append(f"{kind} {farther:+.1%} ({_verdict(farther, MARKS['style'], '≤ +5 %')})")
    codes = ", ".join(map(str, alone.case.codes))
    return f"- Windows against *{alone.case.way}*, frames {codes}: {', '.join(changes)}."


def _worst(kept: Kept, kind: str) -> int:
    steps = kept.errors[kind][1]
    return max(steps, key=lambda code: steps[code])


def _verdict(value: float, limit: float, text: str = "") -> str:
    return f"{text or f'≤ {limit:g}'} {'met' if value <= limit else 'missed'}"


def draw(runs: Runs, study: Study, kept: Path, folder: Path) -> None:
    """The pictures of the first shot, in windows beside frames alone."""
    names = {case.way: case for case in study.shots[0] if case.way in (ALONE, WINDOWS)}
    windows = runs[names[WINDOWS]]
    errors = {
        way: {kind: runs[case].errors[kind][1] for kind in STYLE_OF} for way, case in names.items()
    }
    borders = windows.starts, windows.touched
    draw_flicker(errors, *borders).save(folder / "flicker.png", optimize=True)
    if not all((kept / f"{case.name}.npz").exists() for case in names.values()):
        print("no strip and no animation: the runs' pictures are gone", file=sys.stderr)
        return
    panels = {way: load_panels(kept, case) for way, case in names.items()}
    strip = draw_strip(panels, *borders).quantize(dither=Image.Dither.NONE)
    strip.save(folder / "coherence_strip.png", optimize=True)
    shot = make_case_shot(windows.case, study, windows.settings)
    animation = draw_animation(panels, shot)
    write_webp(folder / "coherence.webp", animation, [MILLISECONDS] * len(animation))


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--keep", type=Path, help=f"finished runs, as in {KEPT}; default: none")
    parser.add_argument("--runs", type=int, help="make so many of the missing runs; default: all")
    parser.add_argument("--report", type=Path, default=Path("benchmarks/results/coherence.md"))
    parser.add_argument("--pictures", type=Path, default=Path("docs/pictures"))
    parser.add_argument("--quick", action="store_true", help="small, few iterations: to try it")
    options = parser.parse_args(arguments)
    study = QUICK if options.quick else PLAN
    words = ["python -m benchmarks.coherence", *(arguments or sys.argv[1:])]
    try:
        with tempfile.TemporaryDirectory() as name:
            kept = options.keep or Path(name)
            runs = keep_runs(study, kept, options.runs)
            if not {ALONE, WINDOWS} <= {case.way for case in study.shots[0] if case in runs}:
                raise ValueError("frames alone and in windows are not made yet. Raise --runs")
            for folder in (options.report.parent, options.pictures):
                folder.mkdir(parents=True, exist_ok=True)
            publish(render_report(runs, study, words), options.report)
            draw(runs, study, kept, options.pictures)
    except (OSError, ValueError, UsdSmokeError) as error:
        print(f"benchmarks.coherence: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
