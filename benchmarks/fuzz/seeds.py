"""The sound files that are damaged, and the commands that read them."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.fuzz.mutate import damage_bytes, damage_json, damage_text
from benchmarks.shape_cost import write_vgg19
from tests.fixtures.pipeline_fixtures import make_style
from tests.fixtures.usd_fixtures import (
    density_prim,
    sampled,
    sequence,
    volume_prim,
    world,
    write_text,
)

__all__ = ["KINDS", "Kind", "make_seeds"]

_QUICK = (
    "--set", "optimize.iterations=1", "--set", "views.image_size=16", "--set", "views.pool=2",
    "--set", "windows.size=2", "--set", "windows.overlap=1", "--set", "optimize.threads=1",
)  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """One sort of input: which files are damaged, how, and what then reads them.

    Attributes:
        folder: of the seed; copied for each input.
        pattern: of the files in it, one of which is damaged.
        damage: makes other bytes of a file's bytes.
        commands: argument lists, one of which is run in the copied folder.
        runs: likewise, those that stylize or draw: they take seconds.
    """

    folder: str
    pattern: str
    damage: Callable[[bytes, np.random.Generator], bytes]
    commands: tuple[tuple[str, ...], ...]
    runs: tuple[tuple[str, ...], ...] = ()


READ_NETWORK = "read-network"  # no command: the reader of ``features.vgg19_file`` alone


def _reading(stage: str) -> tuple[tuple[str, ...], ...]:
    asked = ("stylize", stage, "-o", "out", "--dry-run")  # with the style that the prim names
    mend = ("validate", stage, "--mend", "mended.usda")
    return ("inspect", stage), ("validate", stage), mend, asked, (*asked, "--style", "in/style.png")


def _drawing(stage: str) -> tuple[tuple[str, ...], ...]:
    return (("preview", stage, "-o", "picture.png", "--width", "16"),)


def _running(stage: str) -> tuple[tuple[str, ...], ...]:
    return (("stylize", stage, "--style", "in/style.png", "-o", "out", *_QUICK), *_drawing(stage))


_SHOT = ("stylize", "in/shot.usda", "-o", "out", "--style")
_RUN = (*_SHOT, "in/style.png", *_QUICK)
_RECORD = tuple((command, "out") for command in ("provenance", "verify"))
_DRY = "--dry-run"
_BARE = ("stage", "in/cache/smoke.####.vdb", "-o", "bare.usda", "--meters-per-unit", "1")

KINDS: dict[str, Kind] = {
    "usda": Kind(
        "shot", "in/shot.usda", damage_text, _reading("in/shot.usda"), _running("in/shot.usda")
    ),
    "usdc": Kind(
        "shot", "in/shot.usdc", damage_bytes, _reading("in/shot.usdc"), _running("in/shot.usdc")
    ),
    "vdb": Kind(
        "shot",
        "in/cache/*.vdb",
        damage_bytes,
        (*_reading("in/shot.usda"), _BARE),
        _running("in/shot.usda"),
    ),
    "png": Kind("shot", "in/style.png", damage_bytes, ((*_SHOT, "in/style.png", _DRY),), (_RUN,)),
    "exr": Kind(
        "shot",
        "in/style.exr",
        damage_bytes,
        ((*_SHOT, "in/style.exr", _DRY),),
        ((*_SHOT, "in/style.exr", *_QUICK),),
    ),
    "yaml": Kind(
        "shot",
        "in/config.yaml",
        damage_text,
        (
            ("inspect", "in/shot.usda", "--config", "in/config.yaml"),
            (*_SHOT, "in/style.png", "--config", "in/config.yaml", _DRY),
            (*_SHOT, "in/style.png", "--overrides", "in/config.yaml", _DRY),
            ("submit", *_SHOT[1:], "in/style.png", "--overrides", "in/config.yaml"),
        ),
    ),
    "network": Kind(
        "network",
        "in/vgg19.pth",
        damage_bytes,
        ((READ_NETWORK, "in/vgg19.pth"),),
        ((*_RUN, "--set", "features.network=vgg19", "--set", "features.vgg19_file=in/vgg19.pth"),),
    ),
    "unfinished run": Kind(
        "unfinished",
        "out/**/*",
        damage_json,
        (("assemble", "out"), (*_RUN, _DRY), ("verify", "out")),
        (_RUN,),
    ),
    "result": Kind(
        "result",
        "out/**/*",
        damage_json,
        (
            *_RECORD,
            ("provenance", "out", "--prov"),
            ("validate", "out/look.usda"),
            ("inspect", "out/stylized.usda"),
            (*_RUN, _DRY),
        ),
        (*_drawing("out/stylized.usda"), _RUN, ("rerun", "out", "-o", "again")),
    ),
}


def make_seeds(folder: Path) -> None:
    """Write the seed folders. Runs usdsmoke: call it in a process of its own."""
    import OpenEXR
    from pxr import Sdf

    from tests.fixtures.usd_fixtures import write_vdb
    from usdsmoke.ui.cli.main import main

    shot = folder / "shot"
    codes = (1, 2, 3)
    for code in codes:
        write_vdb(shot / f"in/cache/smoke.{code:04d}.vdb", ("density", "vel"), 0.5 + code / 8)
    look = """
        double usdSmoke:request:gamma = 0.8
        uniform int usdSmoke:request:windowSize = 2
        uniform token[] usdSmoke:request:steps = ["shape", "colour"]
        uniform asset[] usdSmoke:request:styleImages = [@style.png@]
    """
    velocity = density_prim(sequence(codes), "vel", grid='token fieldName = "vel"')
    velocity = velocity.replace('"float"', '"float3"').replace("fogVolume", "unknown")
    relations = "rel field:density = </World/smoke/density>\nrel field:vel = </World/smoke/vel>"
    moved = sampled("double3 xformOp:translate", {1: "(0, 0, 0)", 3: "(1, 0, 0)"})
    body = f"""
        float3[] extent = [(-9, -9, -9), (9, 9, 9)]
        {moved}
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {density_prim(sequence(codes))}{velocity}
    """
    prims = volume_prim(look + body, relations=relations).replace(
        'def Volume "smoke"', 'def Volume "smoke" (prepend apiSchemas = ["UsdSmokeStyleAPI"])'
    )
    camera = 'def Camera "shot"\n{\n double3 xformOp:translate = (0, 0, 30)\n'
    camera += ' uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
    write_text(shot / "in/shot.usda", world(prims + camera))
    Sdf.Layer.FindOrOpen(str(shot / "in/shot.usda")).Export(str(shot / "in/shot.usdc"))
    make_style(shot / "in/style.png")
    pixels = np.linspace(0, 1, 8 * 9 * 3, dtype=np.float32).reshape(8, 9, 3)
    OpenEXR.File({}, {"RGB": pixels}).write(str(shot / "in/style.exr"))
    write_text(shot / "in/config.yaml", _SETTINGS)
    shutil.copytree(shot, folder / "network")
    write_vgg19(folder / "network/in/vgg19.pth")
    for name, more in (("unfinished", ("--window", "0")), ("result", ())):
        place = shutil.copytree(shot, folder / name)
        words = [str(place / word) if word in _PATHS else word for word in _RUN]
        if more:
            assert main([*words, "--coarse", "--json"]) == 0
        assert main([*words, *more, "--json"]) == 0, name


_PATHS = ("in/shot.usda", "in/style.png", "out")
_SETTINGS = """optimize:
  iterations: 3
  seed: 7
shape: {reach: 0.05}
views:
  pool: 4
  azimuth: 12.0
windows: {size: 2, overlap: 1}
style:
  tiling: 2
grids:
  half: true
layer: {mode: layer, look: test}
"""
