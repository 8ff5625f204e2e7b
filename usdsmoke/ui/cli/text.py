"""What the commands print: results, error budgets, inspections, findings."""

import argparse
import json
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from usdsmoke.base.errors import count_text
from usdsmoke.base.naming import ORIGINAL, VARIANT_SET
from usdsmoke.base.time_codes import find_holes, format_time_code, name_time_codes

LINE_EVERY = 10.0  # seconds between two lines of a log

if TYPE_CHECKING:
    from usdsmoke.farm import JobBundle
    from usdsmoke.pipeline import StylizeResult, TaskResult
    from usdsmoke.runs.train import TrainPlan, TrainResult
    from usdsmoke.usd.rules import Finding
    from usdsmoke.usd.source_stage import SourceStage


def print_json(value: Any) -> None:
    """Print one JSON value on stdout. NaN and infinity raise ValueError: JSON has neither.

    Values of other types, such as those of attributes that USD does not know, become text.
    """
    print(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False, default=str))


def show(arguments: argparse.Namespace, value: Callable[[], Any], text: Callable[[], str]) -> None:
    """Print a command's outcome on stdout: its JSON value with ``--json``, or else its text."""
    if arguments.json:
        print_json(value())
    else:
        print(text())


def format_seconds(seconds: float) -> str:
    """A duration as text.

    >>> format_seconds(7.4), format_seconds(95), format_seconds(7260)
    ('7 s', '1 min 35 s', '2 h 1 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def result_text(result: "StylizeResult") -> str:
    """Where a result is and what to do next."""
    folders = sorted({str(file_path.parent) for file_path in result.frames})
    opened = [("open", str(result.root_stage))] if result.root_stage else []
    rows = [
        *opened,
        ("look layer", str(result.look_layer)),
        (count_text(len(result.frames), "VDB file"), ", ".join(folders)),
        *(("contact sheet", str(file_path)) for file_path in result.contact_sheets),
        *_extinctions(result.extinction),
    ]
    checked = result.root_stage or result.look_layer
    only = "--look-only " if result.root_stage else ""  # what is wrong with the source is no news
    check = f"check: usdsmoke validate {only}{shlex.quote(str(checked))}"
    return "\n".join([*columns(rows), "", *_use_of(result), check])


def _extinctions(extinctions: Mapping[str, float]) -> list[tuple[str, str]]:
    """The factor that a material built by hand needs: a row for each Volume."""
    return [
        ("gamma_w", f"{value:.4g} per stage unit, of <{path}>: extinction = gamma_w * density")
        for path, value in extinctions.items()
    ]


def _use_of(result: "StylizeResult") -> list[str]:
    """What to do with a result that is not a root layer over the source."""
    layer = result.plan.config.layer
    if layer.mode == "layer":
        return [f"use: add it above its source, subLayers = [@{result.look_layer}@, ...]"]
    if layer.mode == "reference":
        names = f"{layer.look} (selected now), {ORIGINAL}, or another look in the folder"
        return [f"use: select a variant of {VARIANT_SET!r} on the root prims: {names}"]
    return []


def task_text(task: "TaskResult") -> str:
    """The files of one task of a run."""
    what = "already done" if task.was_done else "finished"
    manifest = [("manifest", str(task.manifest))] if task.manifest.is_file() else []
    return "\n".join(columns([(what, str(task.folder)), *manifest]))


def job_text(bundle: "JobBundle") -> str:
    """The files of a queue job, and the commands that run it."""
    values = [part for pair in bundle.parameters.items() for part in ("-p", "=".join(pair))]
    run = shlex.join(["openjd", "run", str(bundle.template), *values])
    rows = [
        ("job template", str(bundle.template)),
        (count_text(bundle.n_windows, "window"), "one task each"),
        (
            "Deadline Cloud",
            shlex.join(["deadline", "bundle", "submit", str(bundle.template.parent)]),
        ),
        ("this machine", run),
    ]
    return "\n".join(columns(rows))


def inspection_text(found: Mapping[str, Any]) -> str:
    """What ``inspect`` found, one line per field and timeCode."""
    stage = found["stage"]
    unsaid = {name: " (not authored)" for name in stage["not_authored"]}
    lines = [
        f"{stage['file']}",
        f"  {stage['up_axis']} up{unsaid.get('up_axis', '')}, {stage['meters_per_unit']:g} m per "
        f"unit{unsaid.get('meters_per_unit', '')}, "
        f"{stage['time_codes_per_second']:g} timeCodes per second, "
        f"{stage['frames_per_second']:g} frames per second",
    ]
    for volume in found["volumes"]:
        lines += ["", _inspected_volume(volume)]
        rows: list[tuple[str, ...]] = [
            ("timeCode", "field", "grid", "type", "class", "voxels", "box", "file")
        ]
        for frame in volume["frames"]:
            rows += [_inspected_field(frame, *item) for item in frame["fields"].items()]
        lines += [f"  {line}" for line in columns(rows)]
        if asked := request_rows(volume["request"]):
            lines += ["  stylized with", *(f"    {line}" for line in columns(asked))]
    for omission in found["omitted"]:
        lines += ["", f"left out: {omission['what']}: {omission['reason']}"]
    for word in ("note", "problem"):
        if texts := found[f"{word}s"]:
            lines += ["", *(f"{word}: {text}" for text in texts)]
    return "\n".join(lines)


def source_stage_text(made: "SourceStage") -> str:
    """A stage made from VDB files, and what to do next."""
    codes = f", {name_time_codes(made.time_codes)}" if made.time_codes else ""
    return "\n".join(
        [
            f"{made.file}",
            f"  <{made.prim_path}>: {', '.join(made.fields)}{codes}",
            *(
                f"  no file between {before} and {after}: that of {before} is held there"
                for before, after in find_holes(made.time_codes)
            ),
            *(f"  left out: {item}" for item in made.left_out),
            *(
                f"  {name} is a level set, which holds a surface: convert it to a fog volume to "
                "stylize it"
                for name in made.level_sets
            ),
            *(["  no field can be a density: it takes a float grid"] * (not made.densities)),
            f"next: usdsmoke inspect {shlex.quote(str(made.file))}",
        ]
    )


def validation_text(
    file_path: str,
    findings: Sequence["Finding"],
    of_source: Sequence["Finding"] = (),
    ignored: Mapping[str, int] | None = None,
    everything: bool = True,
) -> str:
    """Findings, one line each, and their number; those of the source behind them.

    Args:
        ignored: the number of those that were left out, by rule.
        everything: False: of many findings of one rule the first ones.
    """
    counts = Counter(_SEVERITIES[str(finding.severity)] for finding in findings)
    summary = ", ".join(count_text(n, word) for word, n in counts.items()) or "no findings"
    left_out = ", ".join(f"{rule} {number}" for rule, number in (ignored or {}).items())
    summary += f"; ignored: {left_out}" if left_out else ""
    lines = [*_finding_lines(findings, everything), f"{file_path}: {summary}"]
    if of_source:
        lines += ["in the source too, and not counted:"]
        lines += [f"  {line}" for line in _finding_lines(of_source, everything)]
    return "\n".join(lines)


def _finding_lines(findings: Sequence["Finding"], everything: bool) -> list[str]:
    """A line each; those of one rule together, and their number where they are many."""
    kinds: dict[tuple[str, str], list[str]] = {}
    for item in findings:
        kinds.setdefault((str(item.severity), item.rule), []).append(_finding_line(item))
    found = []
    for (severity, rule), lines in kinds.items():
        is_long = len(lines) > _MOST_FINDINGS and not everything
        found += lines[: _MOST_FINDINGS - 1] if is_long else lines
        if is_long:
            n_more = len(lines) - _MOST_FINDINGS + 1
            found.append(f"{severity:<5} {rule}: {n_more} more (--verbose)")
    return found


_MOST_FINDINGS = 4  # of one rule
_SEVERITIES = {"error": "error", "warn": "warning", "info": "note"}


def _finding_line(finding: "Finding") -> str:
    where = f" <{finding.prim_path}>" if finding.prim_path else ""
    when = f" {name_time_codes([finding.time_code])}" if finding.time_code is not None else ""
    return f"{finding.severity:<5} {finding.rule}{where}{when}: {finding.message}"


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as lines with aligned columns."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _inspected_volume(volume: Mapping[str, Any]) -> str:
    codes = volume["time_codes"]
    others = (
        f"; other fields: {', '.join(volume['other_fields'])}" if volume["other_fields"] else ""
    )
    lights = ", ".join(f"<{light['prim_path']}> ({light['type']})" for light in volume["lights"])
    others += f"; lights: {lights}" if lights else ""
    span = (
        f"{format_time_code(codes[0])} to {format_time_code(codes[-1])}"
        if volume["animated"]
        else "not animated"
    )
    return f"Volume <{volume['prim_path']}>: {count_text(len(codes), 'frame')}, {span}{others}"


def _inspected_field(
    frame: Mapping[str, Any], name: str, field: Mapping[str, Any]
) -> tuple[str, ...]:
    grids = list(field.get("grids", ()))
    is_only = not field["grid"] and len(grids) == 1
    named = grids if is_only else [grid for grid in grids if grid["name"] == field["grid"]]
    index = (field["grid_index"] or 0) if len(named) > 1 else 0  # it tells equal names apart
    grid: Mapping[str, Any] = next((grid for grid in named if grid["index"] == index), {})
    label = f"{field['grid']}[{index}]" if index else grid.get("name", field["grid"])
    kind = f"{grid.get('type', '?')}{' (half)' if grid.get('half') else ''}"
    voxels = grid.get("active_voxels")
    return (
        format_time_code(frame["time_code"]),
        name,
        label,
        kind,
        str(grid.get("class", "?")),
        "?" if voxels is None else f"{voxels:,}",
        box_text(grid["box"]) if grid.get("box") else ("empty" if voxels == 0 else "?"),
        Path(field["file"]).name,
    )


def box_text(shape: Iterable[int]) -> str:
    """Voxels along the axes."""
    return " x ".join(str(n) for n in shape)


_WORDS = {"config": "configuration", "option": "option", "default": "default"}


def request_rows(request: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Name, value and origin of everything but defaults, and the number of defaults."""
    images = ", ".join(Path(name).name for name in request["styles"]["value"])
    rows = [("style images", images or "none", _origin(request["styles"]))] if images else []
    settings = request["settings"]
    rows += [
        (name, _value(entry), _origin(entry))
        for name, entry in settings.items()
        if entry["origin"] != "default"
    ]
    n_others = sum(entry["origin"] == "default" for entry in settings.values())
    if rows and n_others:
        rows.append(("others", f"{n_others} settings", "default"))
    return rows


def _value(entry: Mapping[str, Any]) -> str:
    if samples := entry.get("samples"):
        (first, start), (last, end) = samples[0], samples[-1]
        return f"{start} at {first:g} to {end} at {last:g}"
    return str(entry["value"])


def _origin(entry: Mapping[str, Any]) -> str:
    if entry["origin"] != "prim":
        return _WORDS[entry["origin"]]
    return f"<{entry['attribute']}> in {Path(entry['layer']).name}"


def training_plan_text(plan: "TrainPlan") -> str:
    """What a training learns from, and what it takes."""
    is_seen = plan.held_out in plan.time_codes
    judged = "that frame" if is_seen else f"timeCode {plan.held_out:g}, which is held out"
    return (
        f"training for <{plan.prim}> on {name_time_codes(plan.time_codes)}, judged by {judged}\n"
        f"estimate: {plan.memory_gib:.1f} GiB of memory, {format_seconds(plan.seconds)} for "
        f"{count_text(plan.n_iterations, 'iteration')}; it may end earlier"
    )


def training_text(result: "TrainResult") -> str:
    """A trained network, and how good it is."""
    is_seen = result.held_out in result.time_codes
    judged = "the only frame" if is_seen else "which was held out"
    lines = [
        str(result.file),
        f"  style loss {result.loss:.3g} at timeCode {result.held_out:g}, {judged}; "
        f"{result.cold_iterations} iterations from noise reach {result.cold_loss:.3g}",
        f"  {count_text(result.n_iterations, 'iteration')} on "
        f"{name_time_codes(result.time_codes)}, {format_seconds(result.seconds)}",
    ]
    return "\n".join(lines)
