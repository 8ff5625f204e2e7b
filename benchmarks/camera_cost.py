"""What a shot's camera saves and costs: half of the smoke out of the picture, and a near eye.

    python -m benchmarks.camera_cost [half] [near]

Prints two tables, see benchmarks/results/camera_cost.md; about two minutes on one core. The error
is the style loss
(of the run itself, one octave below the finest) of the camera's own perspective picture.
"""

import argparse
import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import torch

from benchmarks.control_scenes import paint_styles
from benchmarks.shape_cost import make_plume
from usdsmoke.base.volume import CameraSource, DenseField, VolumeFrame
from usdsmoke.config.look_sections import ViewsConfig
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.stylize import StylizedFrame, stylize_window
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.smoke.srgb import encode_srgb
from usdsmoke.core.steps import colour, shape
from usdsmoke.core.steps.targets import make_targets
from usdsmoke.core.views.cameras import View, camera_orbit, sample_angles, view_of_camera
from usdsmoke.core.views.project import colour_map
from usdsmoke.core.views.scene import PICTURE_MARGIN, Scene, frame_views, measure_scene
from usdsmoke.pictures import find_style_size

__all__ = ["camera_around", "half_out", "main", "near_eye", "picture_loss"]

CPU = torch.device("cpu")
FACTOR = 2  # the error is taken on pictures of half the resolution: no voxel leaves gaps there
THIN = 0.05  # see core.colour
SETTINGS = ["optimize.threads=1", "optimize.tolerance=0", "colour.iterations=[60, 60, 60]"]
NEAREST = 0.15  # of the eye's distance: nearer smoke does not set a perspective picture's size


@lru_cache(maxsize=1)
def painted_waves() -> np.ndarray:
    """The example style of waves, [256 256 3] float32 in [0, 1]."""
    return paint_styles(["waves"], 256)["waves"]


def make_frame(n: int) -> VolumeFrame:
    """A plume of n x 3n/2 x n voxels of size 1, a third of them with smoke."""
    values = make_plume((n, n * 3 // 2, n), 0.3)
    return VolumeFrame(1.0, DenseField("density", values, (0, 0, 0), np.eye(4)), np.eye(4))


def camera_around(
    frame: VolumeFrame, distance: float, azimuth: float = 0.0, wide: float = 1.15
) -> CameraSource:
    """A camera that looks at the middle of the smoke, all of which fits its film.

    Args:
        distance: of the eye from the middle, in longest sides of the smoke.
        azimuth: degrees; 0 looks along -Z.
        wide: film over smoke where that is nearest.
    """
    low, high = activate(frame.density, frame.density_to_stage, CPU).box
    middle, size = (low + high) / 2, float((high - low).max())
    a = math.radians(azimuth)
    back = np.array([math.sin(a), 0.0, math.cos(a)])
    place = np.eye(4)
    place[:3, :3] = [[math.cos(a), 0.0, -math.sin(a)], [0.0, 1.0, 0.0], back]
    place[3, :3] = middle + distance * size * back
    film = wide * size / (distance * size - float((high - low)[2]) / 2)
    return CameraSource("/camera", place, 1.0, film, film, 0.0, 0.0, (1e-3, 1e6))


def picture_loss(
    result: StylizedFrame, scene: Scene, camera: CameraSource, config: Config
) -> float:
    """The style loss of what the camera shows of a result."""
    smoke = activate(result.density, np.eye(4), CPU)
    assert result.emission is not None
    index = (smoke.ijk - torch.tensor(result.density.ijk_min)).T
    emission = torch.from_numpy(result.emission.values)[tuple(index)]
    colours = emission / (scene.gamma_w * smoke.density)[:, None]
    depth = (smoke.positions.numpy().mean(0) - camera.camera_to_stage[3, :3]) @ -(
        camera.camera_to_stage[2, :3]
    )
    side = round(camera.horizontal_aperture * depth / (FACTOR * scene.pixel_size))
    image, alpha = colour_map(
        smoke.positions,
        smoke.density,
        np.eye(3),
        scene.gamma_w,
        view_of_camera(camera, side, side),
        1.0,
    )
    targets, thin = make_targets([painted_waves()], scene, config, CPU), THIN / scene.exposure
    light = image.apply(colours) + thin * targets.background
    picture = encode_srgb(light / (alpha[..., None] + thin))
    return float(targets.at(FACTOR)(picture, alpha / (alpha + thin), None, 0))


def perspective_views(
    smoke: ActiveSmoke,
    config: ViewsConfig,
    scene: Scene,
    seed: int,
    factor: int = 1,
    n_aside: int = 0,
) -> list[View]:
    """What ``scene.frame_views`` would be with perspective pictures, of the scene's pixel size at
    the smoke's middle.
    """
    assert scene.camera is not None
    positions = smoke.positions.numpy()
    target = positions.mean(0)
    distance = float(np.linalg.norm(target - scene.camera.camera_to_stage[3, :3]))
    focal = distance / (scene.pixel_size * factor)
    views = []
    for azimuth, elevation in sample_angles(config, config.pool, seed, n_aside):
        view = camera_orbit(scene.camera, float(azimuth), float(elevation), target, 1.0)
        eye = target - distance * view.forward
        away = positions - eye
        scale = focal / np.maximum(away @ view.forward, NEAREST * distance)
        x, y = scale * (away @ view.right), -scale * (away @ view.up)
        width, height = (math.ceil(float(np.ptp(side))) + 2 * PICTURE_MARGIN for side in (x, y))
        shift = (-float(x.max() + x.min()) / 2, -float(y.max() + y.min()) / 2)
        views.append(
            dataclasses.replace(
                view, centre=eye, focal=focal, width=width, height=height, shift=shift
            )
        )
    return views


def run(
    frame: VolumeFrame,
    scene: Scene,
    config: Config,
    views: Callable[..., list[View]] = frame_views,
) -> tuple[StylizedFrame, float]:
    """The stylized frame and the seconds of processor time that it took; a frame's camera has its
    views.
    """
    if frame.camera is not None:
        config = config.with_values({"views.camera": frame.camera.prim_path})
    shape.frame_views = colour.frame_views = views  # type: ignore[attr-defined]
    try:
        started = time.process_time()
        (result,) = stylize_window([frame], [painted_waves()], scene, config)
        return result, time.process_time() - started
    finally:
        shape.frame_views = colour.frame_views = frame_views  # type: ignore[attr-defined]


def _measured(frame: VolumeFrame, config: Config) -> Scene:
    scene = measure_scene([frame], config.views, config.optics, "Y", config.grids.parts)
    size = find_style_size([painted_waves()], scene.voxels, config)
    return dataclasses.replace(scene, style_size=size)


def without_half(camera: CameraSource, frame: VolumeFrame, margin: float) -> CameraSource:
    """The camera with its film moved to the right until half of the voxels lie outside."""
    smoke = activate(frame.density, frame.density_to_stage, CPU)
    place = camera.camera_to_stage
    away = (smoke.positions.numpy() - place[3, :3]) @ place[:3, :3].T
    middle = float(np.median(away[:, 0] / -away[:, 2]))
    return dataclasses.replace(
        camera, horizontal_offset=middle + (0.5 + margin) * camera.horizontal_aperture
    )


def half_out(
    n: int = 64, more: Sequence[str] = (), n_runs: int = 2
) -> dict[str, tuple[float, int, float]]:
    """Seconds, voxels that are worked on, and the error in the picture that shows one half.

    Returns:
        By case: no camera; a camera from the side that sees all; the same with its film moved so
        that half of the smoke lies outside. The quickest of the runs counts.
    """
    config = resolve_config([*SETTINGS, "shape.iterations=[30, 25, 20]", *more])
    frame = make_frame(n)
    whole = camera_around(frame, 3.0, azimuth=60.0)
    half = without_half(whole, frame, config.views.camera_margin)
    scene = _measured(dataclasses.replace(frame, camera=whole), config)
    found = {}
    for name, camera in (("no camera", None), ("whole", whole), ("half", half)):
        seen = dataclasses.replace(frame, camera=camera)
        runs = [run(seen, scene, config) for _ in range(n_runs)]
        result, seconds = runs[0][0], min(item[1] for item in runs)
        outside = result.report.voxels_outside_camera or 0
        error = picture_loss(result, scene, half, config)
        found[name] = (seconds, result.report.voxels - outside, error)
    return found


def near_eye(
    n: int = 48, distances: Sequence[float] = (0.6, 0.8, 1.5, 3.0), more: Sequence[str] = ()
) -> dict[float, dict[str, tuple[float, float]]]:
    """Seconds and error of parallel and of perspective views, by the eye's distance."""
    config = resolve_config([*SETTINGS, "shape.iterations=[20, 15, 10]", "views.pool=8", *more])
    frame = make_frame(n)
    found: dict[float, dict[str, tuple[float, float]]] = {}
    for distance in distances:
        camera = camera_around(frame, distance)
        scene = _measured(frame, config)
        seen = dataclasses.replace(frame, camera=camera)
        found[distance] = {}
        for name, views in (("parallel", frame_views), ("perspective", perspective_views)):
            result, seconds = run(seen, scene, config, views)
            found[distance][name] = seconds, picture_loss(result, scene, camera, config)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("tables", nargs="*", default=["half", "near"])
    tables = parser.parse_args(arguments).tables
    if "half" in tables:
        print("| camera | CPU s | voxels | style loss in the picture |\n| --- | --- | --- | --- |")
        for name, (seconds, voxels, error) in half_out().items():
            print(f"| {name} | {seconds:.1f} | {voxels:,} | {error:.2f} |", flush=True)
    if "near" in tables:
        print("| distance | views | CPU s | style loss in the picture |\n| --- | --- | --- | --- |")
        for distance, cases in near_eye().items():
            for name, (seconds, error) in cases.items():
                print(f"| {distance:g} | {name} | {seconds:.1f} | {error:.2f} |", flush=True)


if __name__ == "__main__":
    main()
