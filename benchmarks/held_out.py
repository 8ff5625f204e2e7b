"""Pictures of a finished result from views that the optimiser never had, their scores and loss."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from pxr import Usd, UsdGeom, UsdVol

from benchmarks.display import composite, encode_display, mean_colour
from benchmarks.measures import outlier_share, score_views
from benchmarks.raymarch import march_rays
from benchmarks.splats import render_fields
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.schedule import view_ranges
from usdsmoke.core.steps.targets import make_targets
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.scene import measure_scene
from usdsmoke.pictures import find_style_size
from usdsmoke.usd.schema import EMISSION_ABSOLUTE, EMISSION_MODE
from usdsmoke.vdb.colour_grids import absolute_emission
from usdsmoke.vdb.read import GridRequest, read_grids

__all__ = [
    "RENDERERS",
    "Result",
    "cover_box",
    "draw_march",
    "draw_splats",
    "fit_view",
    "held_out_angles",
    "read_result",
    "read_style",
    "score_result",
    "unseen_loss",
]

EXTINCTION = "usdSmoke:extinctionPerDensity"  # attribute of a Volume with a look: gamma_w
MARGIN = 2  # pixels around the smoke


@dataclass(frozen=True)
class Result:
    """A stylized frame as it stands in its files; both grids over one box."""

    density: DenseField
    emission: DenseField
    to_stage: np.ndarray  # [4 4] grid world to stage space
    gamma_w: float  # extinction per density, 1/stage unit
    up_axis: str = "Y"


def read_result(stage: Usd.Stage, volume_path: str = "", time_code: float = 1.0) -> Result:
    """The result that a stage composes at a timeCode: files, xforms and extinction as USD has them.

    Args:
        stage: with the look over the source.
        volume_path: prim path of a Volume; empty takes the first one.

    Raises:
        ValueError: no such Volume, or one without a look.
        UsdSmokeError: its file cannot be read.
    """
    volumes = [prim for prim in stage.Traverse() if prim.IsA(UsdVol.Volume)]
    chosen = [prim for prim in volumes if volume_path in ("", str(prim.GetPath()))]
    extinction = chosen[0].GetAttribute(EXTINCTION) if chosen else None
    if not extinction:
        raise ValueError(
            f"no Volume {volume_path} with {EXTINCTION} on {stage.GetRootLayer().identifier}; "
            f"it has {[str(p.GetPath()) for p in volumes]}; name the stage that usdsmoke wrote"
        )
    time = Usd.TimeCode(time_code)
    fields = []
    for name, components in (("density", 1), ("emission", 3)):
        asset = UsdVol.OpenVDBAsset.Get(stage, UsdVol.Volume(chosen[0]).GetFieldPath(name))
        request = GridRequest(asset.GetFieldNameAttr().Get(time), components=components)
        file_path = asset.GetFilePathAttr().Get(time).resolvedPath
        fields += read_grids(file_path, [request], GridsConfig())
    density, emission = fields
    mode = chosen[0].GetAttribute(EMISSION_MODE).Get() or EMISSION_ABSOLUTE
    emission = absolute_emission(density, emission, mode)
    to_stage = np.array(UsdGeom.Imageable(asset).ComputeLocalToWorldTransform(time))
    up_axis = str(UsdGeom.GetStageUpAxis(stage))
    return Result(
        density, cover_box(emission, density), to_stage, float(extinction.Get(time)), up_axis
    )


def cover_box(field: DenseField, box: DenseField) -> DenseField:
    """The field over exactly the box of another one of the same transform; zero outside its own."""
    values = np.zeros((*box.values.shape[:3], *field.values.shape[3:]), np.float32)
    offset = np.subtract(field.ijk_min, box.ijk_min)
    low = np.maximum(offset, 0)
    high = np.minimum(offset + field.values.shape[:3], box.values.shape[:3])
    target = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    source = tuple(slice(a, b) for a, b in zip(low - offset, high - offset, strict=True))
    values[target] = field.values[source]
    return replace(field, values=values, ijk_min=box.ijk_min)


def read_style(
    image_file: Path, longer_side: int, size: float = 1.0, tiling: int = 1
) -> np.ndarray:
    """The style at the scale at which a stylization with these settings was asked to show it.

    Returns:
        Display-encoded [h w 3]; ``longer_side`` * ``size`` pixels along its longer side.
    """
    with Image.open(image_file) as image:
        picture = image.convert("RGB")
    scale = longer_side * size / tiling / max(picture.size)
    extent = [max(1, round(side * scale)) for side in picture.size]
    pixels = np.asarray(picture.resize(extent, Image.Resampling.BILINEAR), np.float32) / 255.0
    return np.tile(pixels, (tiling, tiling, 1))


def held_out_angles(n: int, azimuth: float, elevation: float, seed: int = 2020) -> np.ndarray:
    """``n`` pairs of azimuth and elevation in degrees [n 2], one at random per cell of a lattice.

    The optimiser draws its views from another generator; with real-valued angles none coincides.
    """
    rng = np.random.default_rng(seed)
    rows = max(1, round(np.sqrt(n * elevation / max(azimuth, 1e-9))))
    rows = max(divisor for divisor in range(1, rows + 1) if n % divisor == 0)
    row, column = np.divmod(np.arange(n), n // rows)
    unit = np.stack([column + rng.random(n), row + rng.random(n)], axis=1) / [n // rows, rows]
    return (2.0 * unit - 1.0) * [azimuth, elevation]


def draw_march(result: Result, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied linear picture and opacity, by rays through trilinear grids."""
    density = result.density
    to_stage = density.index_to_world.copy()
    to_stage[3] = np.array([*density.ijk_min, 1.0]) @ density.index_to_world
    return march_rays(
        np.maximum(density.values, 0.0), result.emission.values, to_stage @ result.to_stage,
        result.gamma_w, view,
    )  # fmt: skip


def draw_splats(result: Result, view: View) -> tuple[np.ndarray, np.ndarray]:
    """The same by the optimiser's own projection."""
    drawn = render_fields(result.density, result.emission, result.to_stage, result.gamma_w, view)
    return drawn[..., :3], drawn[..., 3]


RENDERERS: dict[str, Callable[[Result, View], tuple[np.ndarray, np.ndarray]]] = {
    "rays": draw_march,
    "splats": draw_splats,
}


def score_result(
    result: Result,
    style: np.ndarray,
    angles: Sequence[Sequence[float]] | np.ndarray,
    image_size: int,
    renderer: str = "rays",
) -> tuple[dict[str, dict[str, Any]], list[np.ndarray]]:
    """Scores of the result's held-out views (see `measures.score_views`) and their pictures.

    Beside the measures there is ``outliers``, a share of pixels and no closure: ``value`` by view,
    ``mean`` and ``max``.

    Args:
        result: as read from its file.
        style: display-encoded, at the scale of the pictures (see `read_style`).
        angles: azimuth and elevation in degrees, [n 2].
        image_size: pixels of the smoke's longer side in the middle view; not finer than the voxels.
        renderer: a key of RENDERERS.
    """
    fill = mean_colour(style)
    images, masks, outliers = [], [], []
    for azimuth, elevation in angles:
        view = fit_view(result, float(azimuth), float(elevation), image_size)
        premultiplied, alpha = RENDERERS[renderer](result, view)
        images.append(composite(premultiplied, alpha, fill))
        masks.append(alpha)
        own = encode_display(premultiplied / np.maximum(alpha, 1e-6)[..., None])
        outliers.append(outlier_share(style, own, alpha))
    scores = score_views(style, images, masks)
    spread = {"value": outliers, "mean": float(np.mean(outliers)), "max": max(outliers)}
    return {**scores, "outliers": spread}, images


def unseen_loss(
    result: Result,
    style: np.ndarray,
    ranges: tuple[float, float] | None = None,
    n_views: int = 6,
) -> float:
    """The mean style loss of a result's colour pictures from held-out views.

    Args:
        result: as read from its file.
        style: [H W 3], display-encoded.
        ranges: of azimuth and elevation, degrees to either side; None takes the default settings'.
        n_views: how many.
    """
    config = Config()
    frame = VolumeFrame(0.0, result.density, result.to_stage)
    optics = config.optics.replace(thicken=1.0)  # the smoke as it is
    scene = measure_scene([frame], config.views, optics, result.up_axis, 1)
    scene = replace(scene, style_size=find_style_size([style], scene.voxels, config))
    loss = make_targets([style], scene, config, torch.device("cpu")).at(1)
    found = []
    for angles in held_out_angles(n_views, *(ranges or view_ranges(config.views))):
        view = fit_view(result, *map(float, angles), config.views.image_size)
        premultiplied, alpha = draw_march(result, view)
        picture = composite(premultiplied, alpha, mean_colour(style))
        image, mask = (torch.from_numpy(np.float32(item)) for item in (picture, alpha))
        found.append(float(loss(image, mask, None, 0)))
    return float(np.mean(found))


def fit_view(result: Result, azimuth: float, elevation: float, image_size: int) -> View:
    """An orthographic view that just holds the density's box, at the middle view's pixel size."""
    corners = _corners(result)
    middle = orbit_view(0.0, 0.0, result.up_axis, np.zeros(3), 1, 1, 1.0)
    longest = max(np.ptp(corners @ middle.right), np.ptp(corners @ middle.up))
    matrix = result.density.index_to_world @ result.to_stage
    voxel = abs(np.linalg.det(matrix[:3, :3])) ** (1 / 3)
    pixel_size = max(float(longest) / image_size, voxel)
    view = orbit_view(azimuth, elevation, result.up_axis, np.zeros(3), 1, 1, pixel_size)
    width, height = (
        int(np.ceil(np.ptp(corners @ axis) / pixel_size)) + 2 * MARGIN
        for axis in (view.right, view.up)
    )
    return replace(view, centre=corners.mean(axis=0), width=width, height=height)


def _corners(result: Result) -> np.ndarray:
    """Corners of the density's box [8 3], voxels taken whole, stage space."""
    low = np.array(result.density.ijk_min) - 0.5
    high = low + result.density.values.shape
    ijk = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    matrix = result.density.index_to_world @ result.to_stage
    return ijk @ matrix[:3, :3] + matrix[3, :3]
