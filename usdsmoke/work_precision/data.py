"""The measured points as CSV and JSON: the same numbers that the page shows."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from usdsmoke.work_precision.records import Point, Report, Spread, SweepResult

__all__ = ["COLUMNS", "report_as_csv", "report_as_dict", "report_as_json"]

COLUMNS = (
    "sweep", "curve", "label", "setting", "configured", "runs",
    "error", "error_low", "error_high", "cost", "cost_low", "cost_high",
    "cpu_s", "cpu_s_low", "cpu_s_high", "wall_s", "wall_s_low", "wall_s_high",
)  # fmt: skip


def report_as_dict(report: Report) -> dict[str, Any]:
    """Everything on the page as plain values."""
    return {
        "title": report.title,
        **{part.title.lower(): dict(part.rows) for part in report.facts},
        "notes": list(report.notes),
        "sweeps": [_sweep(result) for result in report.sweeps],
        "omissions": [asdict(item) for item in report.omissions],
    }


def report_as_json(report: Report, files: Sequence[str] = ()) -> str:
    """``report_as_dict`` as text, with the names of the report's own files."""
    values = {**report_as_dict(report), "files": list(files)}
    return json.dumps(values, indent=1, ensure_ascii=False) + "\n"


def report_as_csv(report: Report) -> str:
    """One row a point under a row of names, ``COLUMNS``."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for result in report.sweeps:
        for point in result.points:
            writer.writerow(_row(result, point))
    return text.getvalue()


def _sweep(result: SweepResult) -> dict[str, Any]:
    return {
        "name": result.name,
        "title": result.title,
        "x": result.plan.x_label,
        "y": result.plan.y_label,
        "about": result.plan.about,
        "reference": result.plan.reference,
        "verdict": result.verdict,
        "sentences": dict(result.sentences),
        "missing": list(result.missing),
        "points": [
            {
                "curve": point.curve,
                "label": point.label,
                "setting": point.setting,
                "configured": point.configured,
                "offered": point.offered,
                "runs": point.n_runs,
                **{name: asdict(getattr(point, name)) for name in ("error", "cost", "cpu", "wall")},
            }
            for point in result.points
        ],
    }


def _row(result: SweepResult, point: Point) -> list[Any]:
    setting = "" if point.setting is None else point.setting
    row: list[Any] = [result.name, point.curve, point.label, setting, int(point.configured)]
    row.append(point.n_runs)
    for spread in (point.error, point.cost, point.cpu, point.wall):
        row += _numbers(spread)
    return row


def _numbers(spread: Spread) -> list[float]:
    return [spread.median, spread.low, spread.high]
