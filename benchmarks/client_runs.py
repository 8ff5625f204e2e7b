"""Runs the scripts that drive other programs, and reads the pictures that they draw.

``storm_render.py`` and ``blender_render.py`` are not part of the repository; they draw one square
picture of a stage in Hydra Storm, with a lamp on the camera, and in Blender's Cycles, with a sun.
``cycles_emission.py`` is our own and has no lamp.
"""

import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.display import decode_display

__all__ = ["GREY", "ClientRuns", "over_black"]

GREY = 0.18  # display-encoded background that the Storm script puts its picture on
_EXAMPLE = Path(__file__).parents[1] / "examples/blender/import_look.py"
_SHOWN = "shows "  # how cycles_emission.py names the file that Blender reads


@dataclass(frozen=True)
class ClientRuns:
    """Draws stages with other programs; every picture is [H W 3] in [0, 1], display-encoded.

    Its methods raise RuntimeError with the script's own words when a script fails, OSError when
    it cannot be run.
    """

    scripts: Path  # folder of storm_render.py and blender_render.py
    python: Path  # that has Blender as a module
    folder: Path  # for pictures
    camera: str  # prim path; its picture is square
    size: int  # pixels of a side
    samples: int  # of Cycles

    def storm(self, stage_file: Path, name: str, frame: int) -> np.ndarray:
        """Storm, on GREY: colour is premultiplied, so what alpha leaves is added in grey."""
        script = self.scripts / "storm_render.py"
        return self._draw(script, stage_file, name, "--frames", str(frame))[0]

    def lit_cycles(
        self, stage_file: Path, name: str, frame: int, gamma_w: float, *words: str
    ) -> np.ndarray:
        """Cycles with a Principled Volume, a sun and a dark grey sky."""
        script = self.scripts / "blender_render.py"
        words = ("--frames", str(frame), "--gain", str(gamma_w), *words, *self._samples())
        return self._draw(script, stage_file, name, *words)[0]

    def bare_cycles(
        self, stage_file: Path, name: str, frame: int, gamma_w: float
    ) -> tuple[np.ndarray, str]:
        """Cycles with absorption and emission alone over black, and the file that it read."""
        script = Path(__file__).with_name("cycles_emission.py")
        words = ["--frame", str(frame), "--extinction", str(gamma_w), *self._samples()]
        picture, said = self._draw(script, stage_file, name, *words)
        files = [line.split(_SHOWN, 1)[1] for line in said.splitlines() if _SHOWN in line]
        return picture, files[0] if files else ""

    def look_in_cycles(self, stage_file: Path, name: str, frame: int) -> np.ndarray:
        """Cycles over black, with the material that examples/blender/import_look.py builds."""
        script, out = _EXAMPLE, self.folder / f"{name}.png"
        command = [str(self.python), str(script), str(stage_file), "--render", str(out)]
        command += ["--frame", str(frame), "--size", str(self.size), *self._samples()]
        _run(command)
        return _read_picture(out)

    def _samples(self) -> list[str]:
        return ["--samples", str(self.samples)]

    def _draw(
        self, script: Path, stage_file: Path, name: str, *words: str
    ) -> tuple[np.ndarray, str]:
        out = self.folder / f"{name}.png"
        command = [str(self.python), str(script), str(stage_file), str(out), *words]
        said = _run([*command, "--camera", self.camera, "--size", str(self.size)])
        return _read_picture(out), said


def _read_picture(file_path: Path) -> np.ndarray:
    with Image.open(file_path) as image:
        return np.asarray(image.convert("RGB"), np.float32) / 255.0


def over_black(picture: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Storm's picture with the grey behind it taken off, linear [H W 3].

    Args:
        picture: display-encoded colour + (1 - alpha) * GREY, as the script writes it.
        alpha: opacity [H W] that Storm draws with; ours, for the script does not keep Storm's.
    """
    own = np.clip(picture - (1.0 - alpha[..., None]) * GREY, 0.0, 1.0)
    return decode_display(own)


def _run(command: Sequence[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{command[1]} ended with {done.returncode}:\n{done.stderr[-2000:]}")
    return done.stdout
