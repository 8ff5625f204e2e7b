"""The command ``preview``: its progress, and what it prints.

A picture takes a second, so nothing is imported here that it does not need.
"""

import argparse
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.ui.cli.text import LINE_EVERY, format_seconds, show

if TYPE_CHECKING:
    from usdsmoke.pictures.preview import PreviewResult


def run_preview(arguments: argparse.Namespace) -> int:
    """``usdsmoke preview``; the exit code."""
    from usdsmoke.pictures.preview import preview

    def draw(progress: Callable[[int, int], None]) -> "PreviewResult":
        return preview(
            arguments.stage[0],
            arguments.output,
            beside=arguments.stage[1:],
            camera=arguments.camera,
            frames=arguments.frames or "",
            allow_missing=bool(arguments.allow_missing),
            compare=arguments.compare,
            prims=arguments.prim,
            look=arguments.look,
            width=arguments.width,
            size=arguments.size,
            background=arguments.background,
            turntable=arguments.turntable,
            threads=arguments.threads,
            settings=arguments.set,
            progress=progress,
        )

    result = _with_bar(draw) if sys.stderr.isatty() else draw(_Lines())
    for note in result.notes:
        print(f"note: {note}", file=sys.stderr)
    show(arguments, lambda: _preview_dict(result), lambda: _preview_text(result))
    return 0


def _with_bar(draw: Callable[[Callable[[int, int], None]], "PreviewResult"]) -> "PreviewResult":
    """Draw with a bar on the terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as TimeLeft

    columns = (TextColumn("drawing"), BarColumn(bar_width=24), MofNCompleteColumn(), TimeLeft())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        return draw(lambda done, total: bar.update(task, completed=done, total=total))


class _Lines:
    """Progress where stderr is no terminal: a line every ten seconds."""

    def __init__(self) -> None:
        self._began = self._last = time.monotonic()

    def __call__(self, done: int, total: int) -> None:
        now = time.monotonic()
        if now - self._last < LINE_EVERY or done == total:
            return
        self._last = now
        left = format_seconds((now - self._began) / done * (total - done))
        print(f"{done / total:4.0%} picture {done}/{total} {left} left", file=sys.stderr)


def _preview_text(result: "PreviewResult") -> str:
    seen = f"camera <{result.camera}>" if result.camera else "the front view"
    if len(result.angles) > 1:
        seen = f"{len(result.angles)} views around the up axis"
    lines = [str(file_path) for file_path in result.files]
    each = " each" if len(result.time_codes) * len(result.angles) > 1 else ""
    lines.append(
        f"  {name_time_codes(result.time_codes)}, "
        f"{seen}, {result.width} x {result.height} pixels{each}"
    )
    for path, extinction in result.extinctions.items():
        lines.append(f"  <{path}>: extinction {extinction:.4g} per density and stage unit")
    return "\n".join(lines)


def _preview_dict(result: "PreviewResult") -> dict[str, Any]:
    return {
        "files": [str(file_path) for file_path in result.files],
        "time_codes": list(result.time_codes),
        "width": result.width,
        "height": result.height,
        "camera": result.camera,
        "angles": list(result.angles),
        "extinction_per_density": result.extinctions,
        "notes": list(result.notes),
    }
