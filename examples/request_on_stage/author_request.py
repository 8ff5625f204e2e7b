"""Author a request on a Volume, and stylize the stage without naming a style.

    python examples/request_on_stage/author_request.py

The request is in a layer of its own over the stage. The strength fades in over the frames, from
black.
"""

import argparse
from pathlib import Path

from pxr import Sdf, Usd, UsdVol

import usdsmoke  # before the first stage is opened, so that USD knows UsdSmokeStyleAPI

DEMO = Path("out/demo")


def author_request(stage_file: Path, style_file: Path, request_file: Path) -> None:
    """Write a stage over ``stage_file`` in which each Volume requests the style image."""
    request_file.parent.mkdir(parents=True, exist_ok=True)
    source = Usd.Stage.Open(str(stage_file))
    stage = Usd.Stage.CreateNew(str(request_file))
    stage.GetRootLayer().TransferContent(_metadata(source))
    stage.GetRootLayer().subLayerPaths.append(str(stage_file.resolve()))
    for prim in stage.Traverse():
        if prim.IsA(UsdVol.Volume):
            prim.ApplyAPI("UsdSmokeStyleAPI")
            images = Sdf.AssetPathArray([Sdf.AssetPath(str(style_file.resolve()))])
            prim.GetAttribute("usdSmoke:request:styleImages").Set(images)
            prim.GetAttribute("usdSmoke:request:iterations").Set(10)
            prim.GetAttribute("usdSmoke:request:imageSize").Set(48)
            strength = prim.GetAttribute("usdSmoke:request:strength")
            strength.Set(0.001, source.GetStartTimeCode())  # at 0 the grey source would show
            strength.Set(1.0, source.GetEndTimeCode())
    stage.Save()


def _metadata(source: Usd.Stage) -> Sdf.Layer:
    """A layer with the stage metadata of the source, such as its up axis and rates."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    names = ("upAxis", "metersPerUnit", "timeCodesPerSecond", "framesPerSecond")
    for name in (*names, "startTimeCode", "endTimeCode", "defaultPrim"):
        if source.HasAuthoredMetadata(name):
            layer.pseudoRoot.SetInfo(name, source.GetMetadata(name))
    return layer


def main() -> None:
    """Read the command line, author the request, stylize."""
    parser = argparse.ArgumentParser(description="Author a request on a Volume and stylize it.")
    parser.add_argument("--stage", type=Path, default=DEMO / "source/plume.usda")
    parser.add_argument("--style", type=Path, default=DEMO / "styles/petals.png")
    parser.add_argument("--output", type=Path, default=Path("out/request_on_stage"))
    options = parser.parse_args()
    request_file = options.output / "request.usda"
    author_request(options.stage, options.style, request_file)
    result = usdsmoke.stylize(request_file, style=None, output=options.output / "look")
    print(f"open {result.root_stage}")


if __name__ == "__main__":
    main()
