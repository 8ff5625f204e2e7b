"""Pictures for ``benchmarks.one_pass``: what a network paints beside iterations, from all sides.

    python -m benchmarks.one_pass_pictures PAGE.md CURVES.png

draws the curves of a page that ``benchmarks.one_pass --report`` has written.
"""

import re
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.control_studio import COLOURS, Grid, Panel, draw_grid
from benchmarks.display import encode_display
from benchmarks.held_out import Result, cover_box, draw_march, fit_view
from usdsmoke.base.volume import DenseField
from usdsmoke.core.views.scene import Scene

__all__ = ["Gallery", "draw_curves"]

SHOWN = {  # ways and the azimuths that they are drawn from
    "network": {"from the front": 0.0, "from the side": 90.0, "from behind": 180.0},
    "network + 32": {"from the front": 0.0, "from behind": 180.0},
    "cold, 460 iterations": {"from the front": 0.0, "from behind": 180.0},
}
FINER = 3  # pixels along a voxel
LOOKS = {"noise": "C0o-", "neighbour": "C1s-", "network": "C2^-"}  # of starts in a diagram
TITLE = "A trained network beside iterations, on frames and shots that it was not trained on"


@dataclass
class Gallery:
    """Rows of pictures over black: of each smoke the style, then the ways of ``SHOWN``."""

    rows: dict[str, list[Panel]] = field(default_factory=dict)

    def add_style(self, row: str, style: np.ndarray) -> None:
        """Begin a row with its style, display-encoded [H W 3]."""
        small = Image.fromarray(np.rint(style * 255).astype(np.uint8)).resize((160, 160))
        self.rows[row] = [Panel(np.asarray(small, np.float32) / 255, row)]

    def add(
        self, row: str, way: str, density: DenseField, emission: DenseField, scene: Scene
    ) -> None:
        """The pictures of a way; none where it is not in ``SHOWN``."""
        result = Result(density, cover_box(emission, density), np.eye(4), scene.gamma_w)
        for name, azimuth in SHOWN.get(way, {}).items():
            view = fit_view(result, azimuth, 0.0, scene.image_size)
            view = replace(
                view, pixel_size=view.pixel_size / FINER, width=view.width * FINER,
                height=view.height * FINER,
            )  # fmt: skip
            light, _ = draw_march(result, view)
            self.rows[row].append(Panel(encode_display(light), f"{way}\n{name}"))

    def save(self, file_path: Path) -> None:
        """All rows as one picture with a palette."""
        sheet = draw_grid(Grid(file_path.stem, TITLE, list(self.rows.values())))
        sheet.quantize(COLOURS, dither=Image.Dither.NONE).save(file_path, optimize=True)


def draw_curves(page: Path, file_path: Path) -> None:
    """Loss against CPU seconds, a diagram for each smoke of a page that the benchmark wrote."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    curves = _read_curves(page.read_text())
    n_columns = min(len(curves), 3)
    n_rows = -(-len(curves) // n_columns)
    figure = Figure(figsize=(4.2 * n_columns, 3.4 * n_rows), dpi=100, layout="constrained")
    for number, (smoke, ways) in enumerate(curves.items()):
        axes = figure.add_subplot(n_rows, n_columns, number + 1)
        axes.set_title(smoke, fontsize=9)
        axes.set_xscale("log")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel("CPU seconds", fontsize=8)
        axes.set_ylabel("style loss of unseen views", fontsize=8)
        for kind, points in ways.items():
            seconds, losses, labels = zip(*sorted(points), strict=True)
            axes.plot(seconds, losses, LOOKS[kind], label=kind, markersize=4)
            for x, y, label in zip(seconds, losses, labels, strict=True):
                axes.annotate(label, (x, y), (4, 3), textcoords="offset points", fontsize=7)
        axes.legend(fontsize=7)
    figure.savefig(file_path, metadata={"Software": None})


def _read_curves(text: str) -> dict[str, dict[str, list[tuple[float, float, str]]]]:
    """By smoke and kind of start: CPU seconds, loss and iterations of each way but plain noise."""
    curves: dict[str, dict[str, list[tuple[float, float, str]]]] = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        if len(cells) < 4 or "voxels" not in cells[0] or "unseen" in cells[0]:
            continue
        found = re.fullmatch(r"(cold|network|neighbour)\D*(\d*).*", cells[1])
        if found is not None:
            kind, count = {"cold": "noise"}.get(found[1], found[1]), found[2] or "0"
            point = (float(cells[3]), float(cells[2]), count)
            curves.setdefault(cells[0], {}).setdefault(kind, []).append(point)
    return curves


if __name__ == "__main__":
    draw_curves(Path(sys.argv[1]), Path(sys.argv[2]))
