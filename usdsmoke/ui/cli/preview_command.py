"""The command that draws the smoke of a stage."""

import argparse
import sys
from typing import TYPE_CHECKING, Any

from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.ui.cli.text import print_json

if TYPE_CHECKING:
    from usdsmoke.pictures.preview import PreviewResult


def run_preview(arguments: argparse.Namespace) -> int:
    """``usdsmoke preview``; the exit code."""
    from rich.console import Console
    from rich.progress import Progress

    from usdsmoke.pictures.preview import preview

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("drawing", total=None)
        result = preview(
            arguments.stage,
            arguments.output,
            camera=arguments.camera,
            frames=arguments.frames or "",
            compare=arguments.compare,
            prims=arguments.prim,
            width=arguments.width,
            size=arguments.size,
            background=arguments.background,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    for note in result.notes:
        print(f"note: {note}", file=sys.stderr)
    if arguments.json:
        print_json(_as_dict(result))
    else:
        print(_text(result))
    return 0


def _text(result: "PreviewResult") -> str:
    seen = f"camera <{result.camera}>" if result.camera else "the front view"
    lines = [str(file_path) for file_path in result.files]
    lines.append(
        f"  timeCodes {format_time_codes(result.time_codes)} through {seen}, "
        f"{result.width} x {result.height} pixels each"
    )
    for path, extinction in result.extinctions.items():
        lines.append(f"  <{path}>: extinction {extinction:.4g} per density and stage unit")
    return "\n".join(lines)


def _as_dict(result: "PreviewResult") -> dict[str, Any]:
    return {
        "files": [str(file_path) for file_path in result.files],
        "time_codes": list(result.time_codes),
        "width": result.width,
        "height": result.height,
        "camera": result.camera,
        "extinction_per_density": result.extinctions,
        "notes": list(result.notes),
    }
