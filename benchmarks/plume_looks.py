"""Looks of the real plume with several settings, their pictures beside each other."""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageSequence

import usdsmoke
from benchmarks.stages import find_stages
from usdsmoke.runs.assemble import StylizeResult

__all__ = ["Comparison", "join_pictures", "stack_rows"]


def join_pictures(file_paths: Sequence[Path], width: int) -> Image.Image:
    """The pictures beside each other, scaled to a common width of ``width`` pixels."""
    pictures = [Image.open(file_path).convert("RGB") for file_path in file_paths]
    joined = Image.new(
        "RGB", (sum(p.width for p in pictures), max(p.height for p in pictures)), (24, 24, 26)
    )
    left = 0
    for picture in pictures:
        joined.paste(picture, (left, 0))
        left += picture.width
    return joined.resize((width, round(joined.height * width / joined.width)), Image.LANCZOS)


def stack_rows(rows: Sequence[Image.Image]) -> Image.Image:
    """Pictures of one width below each other."""
    whole = Image.new("RGB", (rows[0].width, sum(row.height for row in rows)))
    top = 0
    for row in rows:
        whole.paste(row, (0, top))
        top += row.height
    return whole


@dataclass(frozen=True)
class Comparison:
    """What a benchmark compares.

    Args:
        name: of its module.
        variants: settings by the name of a look.
        turn: views of a turn around the smoke, of which the first two are drawn.
        size: width and height of a picture, pixels.
        width: of a row, pixels.
    """

    name: str
    variants: Mapping[str, Sequence[str]]
    turn: int
    size: tuple[int, int]
    width: int

    def run(
        self,
        parser: argparse.ArgumentParser,
        tell: Callable[[Path, str, StylizeResult, Path], None],
    ) -> None:
        """Run the command line.

        Args:
            parser: with the option ``--picture``, the file of the picture or None; gets the others.
            tell: prints what is measured; called with the style, the name of the variant, its
                result and the folder of real volumes.
        """
        parser.add_argument("styles", nargs="+", type=Path, help="style images")
        parser.add_argument("--data", default="../shared/data", type=Path, help="real volumes")
        parser.add_argument(
            "--out", default=f"out/bench/{self.name}", type=Path, help="folder for looks"
        )
        given = parser.parse_args()
        try:
            stage = find_stages(given.data, given.out)["real_plume"]
        except FileNotFoundError as error:
            sys.exit(f"benchmarks.{self.name}: {error}")
        rows = []
        for style in given.styles:
            pictures = []
            for variant, settings in self.variants.items():
                name = f"{style.stem}_{variant}"
                result = usdsmoke.stylize(
                    stage, style=style, output=given.out / name, force=True,
                    settings=[*settings, "layer.contact_sheet=0"],
                )  # fmt: skip
                tell(style, variant, result, given.data)
                pictures += self._sides(result.root_stage, given.out / f"{name}.webp")
            rows.append(join_pictures(pictures, self.width))
        if given.picture:
            stack_rows(rows).save(given.picture, quality=85, method=6)
            print(given.picture)

    def _sides(self, stage: Path, file_path: Path) -> list[Path]:
        """Pictures of the first two views of a turn."""
        usdsmoke.preview(stage, file_path, turntable=self.turn, size=self.size, background="black")
        found = []
        with Image.open(file_path) as turn:
            for number, picture in zip(range(2), ImageSequence.Iterator(turn), strict=False):
                found.append(file_path.with_name(f"{file_path.stem}_{number}.png"))
                picture.convert("RGB").save(found[-1])
        return found
