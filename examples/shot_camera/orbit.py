"""Put an animated camera on a stage and stylize what it sees.

    python examples/shot_camera/orbit.py

The camera turns around the smoke by 40 degrees. Views of the optimiser follow it frame by frame.
"""

import argparse
from pathlib import Path

from pxr import Gf, Usd, UsdGeom

import usdsmoke

DEMO = Path("out/demo")
CAMERA = "/cameras/orbit"
DEGREES = 40.0
SETTINGS = {
    "views": {"camera": CAMERA, "camera_width": 480, "image_size": 48},
    "optimize": {"iterations": 10},
}


def author_shot(stage_file: Path, shot_file: Path) -> None:
    """Write a stage over ``stage_file`` with a camera that turns around its smoke."""
    shot_file.parent.mkdir(parents=True, exist_ok=True)
    stage = Usd.Stage.CreateInMemory()
    layer = stage.GetRootLayer()
    source = Usd.Stage.Open(str(stage_file))
    layer.subLayerPaths.append(str(stage_file.resolve()))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(source))
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(source))
    stage.SetTimeCodesPerSecond(source.GetTimeCodesPerSecond())
    first, last = source.GetStartTimeCode(), source.GetEndTimeCode()
    stage.SetStartTimeCode(first)
    stage.SetEndTimeCode(last)

    box = UsdGeom.BBoxCache(first, [UsdGeom.Tokens.default_]).ComputeWorldBound(
        source.GetPseudoRoot()
    )
    middle, size = box.ComputeCentroid(), box.ComputeAlignedRange().GetSize()
    distance = 4.0 * max(size)
    camera = UsdGeom.Camera.Define(stage, CAMERA)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.01 * distance, 10.0 * distance))
    transform = camera.AddTransformOp()
    n_frames = max(1, round(last - first))
    for frame in range(n_frames + 1):
        turn = Gf.Rotation(Gf.Vec3d.YAxis(), DEGREES * frame / n_frames)
        eye = middle + turn.TransformDir(Gf.Vec3d(0.0, 0.0, distance))
        view = Gf.Matrix4d().SetLookAt(eye, middle, Gf.Vec3d.YAxis())
        transform.Set(view.GetInverse(), first + frame)
    layer.Export(str(shot_file))


def main() -> None:
    """Read the command line, author the shot, stylize and preview it through the camera."""
    parser = argparse.ArgumentParser(description="Stylize a shot for its camera.")
    parser.add_argument("--stage", type=Path, default=DEMO / "source/plume.usda", help="Y-up")
    parser.add_argument("--style", type=Path, default=DEMO / "styles/waves.png")
    parser.add_argument("--output", type=Path, default=Path("out/shot_camera"))
    options = parser.parse_args()
    shot_file = options.output / "shot.usda"
    author_shot(options.stage, shot_file)
    result = usdsmoke.stylize(
        shot_file, style=options.style, output=options.output / "look", settings=SETTINGS
    )
    usdsmoke.preview(result.root_stage, options.output / "shot.png", camera=CAMERA, width=160)
    print(f"open {result.root_stage}, or look at {options.output / 'shot.png'}")


if __name__ == "__main__":
    main()
