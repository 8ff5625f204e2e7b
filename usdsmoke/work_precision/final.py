"""``usdsmoke report --final``: a look under its lights, scattered many times, by a path tracer.

The picture that was optimised has a glow that is not scattered, and light that is scattered once,
or more often if ``optics.bounces`` was on. A renderer with volume bounces scatters both. Four
pictures of each view are scored against the style. Two are by the model that was optimised: the
glow alone, and glow and light as they were painted. Two are by Mitsuba: light that is scattered
once, and all bounces of light and glow. So the difference of the renderers, which interpolate
between voxels differently, is told from what bounces do.
"""

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.errors import StageError
from usdsmoke.base.machine import check_packages, prepare_torch_environment
from usdsmoke.base.publish import make_folders, publish_file
from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.base.volume import DenseField, Scattering, VolumeFrame
from usdsmoke.config.resolve import FilePath, Settings, Styles, resolve_config, style_paths
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.config.settings import Config
from usdsmoke.pictures import compose_sheet, find_style_size, read_style_image, write_png
from usdsmoke.usd.stage import ComposedVolume, StageOrFile, open_stage
from usdsmoke.work_precision.path_tracer import MOST_BOUNCES, TracedSmoke

if TYPE_CHECKING:
    from torch import Tensor

    from usdsmoke.core.steps.pictures import ColourView
    from usdsmoke.core.steps.targets import StyleTargets
    from usdsmoke.pictures.preview_volumes import Smoke

SIZE = 96  # pixels of the longer side: the path tracer draws about 50 000 rays a second
_TIMES = 3  # as wide are the pixels of the page
VIEWS = (0.0, 120.0, 240.0)  # degrees around the up axis, from the front
PICTURE, DATA = "final.png", "final.json"
GLOW, MODEL, ONCE, FINAL = "glow alone", "as painted", "once, traced", "all bounces, traced"


@dataclass(frozen=True)
class FinalCheck:
    """Style losses of pictures of one frame, mean over the views; lower is nearer."""

    prim_path: str
    time_code: float
    loss: dict[str, float]  # by GLOW, MODEL, ONCE, FINAL
    light: dict[str, float]  # mean of the pictures, scene-linear, exposed; likewise
    bounces_add: float  # light of FINAL over that of ONCE, minus 1
    samples: int  # a pixel
    seconds: float


def check_final(
    stage: StageOrFile,
    style: Styles,
    output: FilePath,
    settings: Settings = None,
    samples: int = 64,
) -> tuple[FinalCheck, tuple[Path, ...]]:
    """Draw and score the middle frame of a look; write the files final.png and final.json.

    Args:
        stage: a look's root layer.
        style: the style images that it was made from.
        output: the folder; made if missing. Old files are replaced.
        settings: those of the look that matter to a picture's loss; of the frames that
            ``stage.frames`` selects the middle one with a look is drawn, of the Volumes the first.
        samples: a pixel.

    Raises:
        MissingPackage: Mitsuba is not installed; pip installs mitsuba.
        StageError: no Volume with a look is shown.
        UsdSmokeError: stage, files or style cannot be used.
    """
    check_packages("torch", "mitsuba")
    prepare_torch_environment()
    from usdsmoke.pictures.preview_volumes import find_smoke

    started = time.perf_counter()
    # the look's voxels are refined already
    drawn_as = {"views.image_size": SIZE, "grids.refine": 1}
    config = resolve_config(settings).with_values(drawn_as)
    ours = config.stage
    selected = StageConfig(prims=ours.prims, frames=ours.frames, density=ours.density)
    smoke = replace(find_smoke(open_stage(stage), selected), passed_over=())
    code, look = _middle_look(smoke)
    images = [read_style_image(image).pixels for image in style_paths(style)]
    drawn = list(
        _draw(
            look, images, config, smoke.whole.up_axis, samples,
        )
    )  # fmt: skip
    loss = {name: float(np.mean([one.loss[name] for one in drawn])) for name in drawn[0].loss}
    light = {name: float(np.mean([one.light[name] for one in drawn])) for name in drawn[0].light}
    found = FinalCheck(
        look.volume.prim_path, code, loss, light, light[FINAL] / max(light[ONCE], 1e-30) - 1,
        samples, time.perf_counter() - started,
    )  # fmt: skip
    return found, _write(found, drawn, images, Path(output).absolute())


@dataclass(frozen=True)
class _Look:
    """The fields of a Volume, in stage space."""

    volume: ComposedVolume
    density: DenseField
    emission: DenseField | None
    colour: DenseField | None
    gamma_w: float

    def placed(self, field: DenseField) -> DenseField:
        """With the stage as its grid world."""
        matrix = field.index_to_world @ self.volume.density.field_to_stage
        return replace(field, index_to_world=matrix)

    @property
    def scattering(self) -> Scattering:
        return self.volume.scattering or Scattering((), 0.0)


@dataclass(frozen=True)
class _Drawn:
    """One view."""

    angle: float
    pictures: dict[str, np.ndarray]  # display-encoded, [H W 3]
    loss: dict[str, float]
    light: dict[str, float]  # mean of the picture


def _middle_look(smoke: "Smoke") -> tuple[float, "_Look"]:
    """The frame with a look that is nearest to the middle one, and its first Volume with a look.

    Frames that were not stylized show an empty emission.
    """
    codes = smoke.time_codes
    middle = len(codes) // 2
    for number in sorted(range(len(codes)), key=lambda number: abs(number - middle)):
        for volume in smoke.shown(codes[number]):
            density, emission, colour = smoke.fields(volume)
            painted = (emission, colour)
            if not any(field is not None and field.values.any() for field in painted):
                continue
            if volume.extinction is None:
                raise StageError(
                    f"<{volume.prim_path}> has no usdSmoke:extinctionPerDensity. Pass the root "
                    "layer of a result."
                )
            return codes[number], _Look(volume, density, emission, colour, volume.extinction)
    raise StageError(
        f"no Volume has a look at {name_time_codes(codes)}. Pass the root layer of a result, such "
        "as shot_look.usda, and --frames that were stylized."
    )


def _draw(
    look: _Look, images: Sequence[np.ndarray], config: Config, up_axis: str, samples: int
) -> Iterator[_Drawn]:
    """View by view."""
    import torch

    from usdsmoke.core.smoke.active import activate
    from usdsmoke.core.steps.pictures import prepare_views
    from usdsmoke.core.steps.targets import make_targets
    from usdsmoke.core.views.cameras import orbit_view
    from usdsmoke.core.views.lighting import light_smoke
    from usdsmoke.core.views.scene import fit_view, measure_scene

    device, place = torch.device("cpu"), look.volume.density.field_to_stage
    frame = VolumeFrame(0.0, look.density, place)
    scene = replace(
        measure_scene([frame], config.views, config.optics.replace(thicken=1.0), up_axis),
        gamma_w=look.gamma_w,
    )
    smoke = activate(look.density, place, device)
    scene = replace(scene, style_size=find_style_size(images, scene.voxels, config))
    targets = make_targets(images, scene, config, device)
    lighting = light_smoke(smoke, look.gamma_w, look.scattering)
    emitted = _per_extinction(look, smoke.ijk.numpy())
    albedo = torch.ones(len(smoke.ijk), 3)
    if look.colour is not None:
        albedo = torch.from_numpy(look.colour.at(smoke.ijk.numpy()))
    traced = TracedSmoke(
        look.placed(look.density), look.gamma_w, look.scattering,
        None if look.colour is None else look.placed(look.colour),
    )  # fmt: skip
    colours = _filled(look, smoke.ijk.numpy(), emitted.numpy())
    for angle in VIEWS:
        turned = orbit_view(angle, 0.0, up_axis, np.zeros(3), 1, 1, scene.pixel_size)
        view = fit_view(turned, smoke)
        (made,) = prepare_views(smoke, [view], look.gamma_w, scene.exposure)
        with torch.no_grad():
            light = {GLOW: made.image.apply(emitted)}
            light[MODEL] = light[GLOW]
            if lighting is not None:
                lit = lighting.on(smoke.positions).scattered(view.forward)
                light[MODEL] = light[GLOW] + made.image.apply(lit * albedo)
        for name, of_light, of_glow in ((ONCE, 1, 0), (FINAL, MOST_BOUNCES, MOST_BOUNCES)):
            picture = traced.glow(colours, view, samples, 0, of_glow)
            if look.scattering.lights:
                picture = picture + traced.lit(view, samples, 0, of_light)
            light[name] = torch.from_numpy(picture).to(made.alpha)
        exposed = {name: picture * 2.0**look.volume.stops for name, picture in light.items()}
        yield _scored(angle, made, exposed, targets)


def _scored(
    angle: float, view: "ColourView", light: dict[str, "Tensor"], targets: "StyleTargets"
) -> _Drawn:
    from usdsmoke.core.smoke.srgb import encode_srgb

    loss, losses, pictures = targets.at(1), {}, {}
    for name, picture in light.items():
        losses[name] = float(loss(view.over(picture, targets.background), view.guide))
        pictures[name] = encode_srgb(picture.clamp(0, 1)).numpy()
    means = {name: float(picture.mean()) for name, picture in light.items()}
    return _Drawn(angle, pictures, losses, means)


def _per_extinction(look: _Look, ijk: np.ndarray) -> "Tensor":
    """Emission over extinction at voxels [N 3], [N 3]."""
    import torch

    from usdsmoke.vdb.colour_grids import absolute_emission

    if look.emission is None:
        return torch.zeros(len(ijk), 3)
    emission = absolute_emission(look.density, look.emission, look.volume.emission_mode)
    values = emission.at(ijk) * look.volume.rescale
    sigma = look.gamma_w * look.density.at(ijk)
    return torch.from_numpy(values / np.maximum(sigma, np.finfo(np.float32).tiny)[:, None])


def _filled(look: _Look, ijk: np.ndarray, values: np.ndarray) -> DenseField:
    """Values of voxels on the density's lattice, in stage space."""
    field = np.zeros((*look.density.values.shape, 3), np.float32)
    field[tuple((ijk - look.density.ijk_min).T)] = values
    return look.placed(replace(look.density, values=field, background=(0.0, 0.0, 0.0)))


def _enlarged(picture: np.ndarray) -> np.ndarray:
    return picture.repeat(_TIMES, 0).repeat(_TIMES, 1)


def _write(
    found: FinalCheck, drawn: Sequence[_Drawn], images: Sequence[np.ndarray], folder: Path
) -> tuple[Path, ...]:
    make_folders(folder)
    rows = [
        [
            (f"{name}, {one.angle:g} degrees: {one.loss[name]:.3g}", _enlarged(picture))
            for name, picture in one.pictures.items()
        ]
        for one in drawn
    ]
    write_png(folder / PICTURE, compose_sheet(found.prim_path, rows, images))
    publish_file(folder / DATA, json.dumps(asdict(found), indent=2) + "\n")
    return folder / PICTURE, folder / DATA
