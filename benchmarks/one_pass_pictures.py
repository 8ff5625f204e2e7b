"""Pictures for ``benchmarks.one_pass``: what a network paints beside iterations, from all sides."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.control_studio import COLOURS, Grid, Panel, draw_grid
from benchmarks.display import encode_display
from benchmarks.held_out import Result, cover_box, draw_march, fit_view
from usdsmoke.base.volume import DenseField
from usdsmoke.core.views.scene import Scene

__all__ = ["Gallery"]

SHOWN = {  # ways and the azimuths that they are drawn from
    "network": {"from the front": 0.0, "from the side": 90.0, "from behind": 180.0},
    "network + 32": {"from the front": 0.0, "from behind": 180.0},
    "cold, 90 iterations": {"from the front": 0.0},
    "cold, 360 iterations": {"from the front": 0.0, "from behind": 180.0},
}
FINER = 3  # pixels along a voxel
TITLE = "A trained network beside iterations, on a frame that it was not trained on"


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
