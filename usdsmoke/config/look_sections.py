"""The settings of a look, by section: views, opacity, style, losses and the two steps.

``None`` means that the run chooses, and the plan says what it chose. A setting with ``request`` can
also be requested by a Volume on the stage, one with ``control`` for each frame.
"""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdsmoke.config.setting_model import Section, setting

Weights = list[Annotated[float, Field(ge=0)]]
Iterations = list[Annotated[int, Field(ge=0)]]
MOST_STOPS = 40.0  # of optics.exposure, either way
_PER_VOXEL = "1/(voxel of the source grid) per unit of density"


# A table to read: a setting takes two or three lines.
# fmt: off
class ViewsConfig(Section):
    """The directions that the smoke is rendered from while it is stylized."""

    count: int = setting(
        1, "views rendered in every iteration; the paper uses 9", ge=1, le=64, request="viewCount")
    pool: int = setting(
        16, "number of different views to draw from", ge=1, le=512, request="viewPool")
    sampling: Literal["fixed", "uniform", "poisson"] = setting(
        "poisson", "how the views are spread over the ranges of azimuth and elevation",
        request="viewSampling")
    azimuth: float | None = setting(
        None, "half the range of views around the up axis, or around the camera's direction; "
        "unset: 180, or 12 with a camera and some views of the other sides",
        ge=0, le=180, unit="degrees", request="azimuth")
    elevation: float | None = setting(
        None, "half the range above and below; unset: 20, or 6 with a camera (20 on other sides)",
        ge=0, le=90, unit="degrees", request="elevation")
    centre_azimuth: float = setting(
        0.0, "middle of the azimuth range; 0 looks along -Z (Y-up), +Y (Z-up) or as the camera "
        "does", unit="degrees", request="centreAzimuth")
    centre_elevation: float = setting(
        0.0, "middle of the elevation range",
        ge=-90, le=90, unit="degrees", request="centreElevation")
    image_size: int = setting(
        192, "longer side of the images that are optimised",
        ge=16, le=2048, unit="pixels", request="imageSize")
    camera: str = setting(
        "", "path of the shot's Camera. Views are taken around its direction, and only smoke in "
        "its frustum is stylized; default: views around the up axis")
    camera_width: int = setting(
        1920, "width of the shot's image; finer detail is not optimised",
        ge=1, le=65536, unit="pixels")
    camera_margin: float = setting(
        0.05, "width of the zone beyond the camera's image in which the effect fades out, as a "
        "share of the image width", gt=0, le=1)


class OpticsConfig(Section):
    """How opaque the smoke is, and the light that it scatters."""

    gamma: float | None = setting(
        None, "extinction of the colour step; higher is more opaque; unset: chosen from "
        "optics.depth; the paper shows 0.001, 0.1, 0.5, 1", gt=0, le=1e30, unit=_PER_VOXEL,
        request="gamma", control="gamma")
    gamma_shape: float | None = setting(
        None, "extinction of the shape step's grey images; unset: chosen from optics.depth_shape",
        gt=0, le=1e30, unit=_PER_VOXEL, request="gammaShape")
    depth: float = setting(
        30.0, "optical depth that the thick columns should have; used to choose gamma if it is "
        "unset", gt=0, le=1e6)
    depth_shape: float = setting(1.3, "the same for gamma_shape", gt=0, le=1e6)
    thicken: float | None = setting(
        None, "times as dense as in the source that the thinnest smoke becomes, so that it shows "
        "the style; smoke between it and the thick columns becomes denser too, and they keep their "
        "opacity; 1: as in the source; unset: what the thin quarter of the columns needs, at most "
        "10", ge=1, le=1000)
    knee: float | None = setting(
        None, "density at which the curve of optics.thicken bends; unset: chosen so that thick "
        "columns keep their optical depth", gt=0, le=1e27)
    frames: str = setting(
        "", "timeCodes that extinction and picture size are measured on, and the largest of which "
        "decides whether voxels or blocks move, such as 1-2; empty: three of the stylized ones, "
        "and the largest of all; a look that is made longer keeps its own")
    percentile: float = setting(
        90.0, "percentile of column depth that counts as thick", gt=0, le=100)
    albedo: float | None = setting(
        None, "share of the extinguished light that smoke and the look's material scatter; "
        "0: lights are ignored; unset: 0.1 if distant lights or domes light the smoke, 0.5 with "
        "colour.target=both, 1 with albedo",
        ge=0, le=1)
    anisotropy: float = setting(
        0.0, "mean cosine of scattering: above 0 forward, below 0 back, 0 to all sides",
        ge=-0.99, le=0.99)
    bounces: bool = setting(
        False, "paint for renderers that scatter light more than once")
    exposure: float | None = setting(
        None, "exposure at which the lit smoke shows the style; the emission is divided by it; "
        "unset: 0, or, with colour.target=albedo, chosen so that white smoke in the light is white",
        ge=-MOST_STOPS, le=MOST_STOPS, unit="stops")
    sun: list[float] = setting(
        [], "direction from the smoke to a distant light, as x y z of the stage; replaces the "
        "stage's lights; empty: the stage's lights")
    sun_colour: Weights = setting(
        [3.14159, 3.14159, 3.14159], "irradiance of optics.sun, as red green blue; under 3.14159 a "
        "white matte surface that faces the sun is white")
    sky: Weights = setting(
        [], "light from all sides, as red green blue; replaces the stage's lights; empty: the "
        "stage's lights")

    @property
    def names_lights(self) -> bool:
        """Whether settings take the place of the stage's lights, be they black."""
        return bool(self.sun or self.sky)


class StyleConfig(Section):
    """How the style images are prepared."""

    tiling: int = setting(
        1, "repetitions of the style image along each side", ge=1, le=16, request="styleTiling")
    size: float | None = setting(
        None, "size of the style relative to the rendered image; unset: 1, or up to 4 if marks "
        "of the style are finer than voxels can hold", gt=0, le=8, request="styleSize")
    areas: Literal["marked", "all"] = setting(
        "marked", "of the style image; marked: without large areas that are dark or have no "
        "marks, which would look like holes or haze; all: the whole image")
    colour: float = setting(
        1.0, "amount of the style's colour; 0: grey, above 1: more than the style has", ge=0, le=2)
    weights: Weights = setting(
        [], "one weight for each style image; only their ratios matter; empty: equal weights",
        request="styleWeights", control="style_weights")

    @property
    def is_size_open(self) -> bool:
        """Whether ``size`` is chosen for the smoke: not if it is set, nor for a tiled image."""
        return self.size is None and self.tiling == 1


class FeaturesConfig(Section):
    """The network whose features are compared."""

    network: Literal["embedded", "vgg19"] = setting(
        "embedded", "feature network", request="network")
    layers: list[str] = setting(
        [], "style layers of the network; empty: its default layers", request="featureLayers")
    weights: Weights = setting(
        [], "one weight for each style layer; empty: all 1", request="featureWeights")
    content_layers: list[str] = setting(
        [], "layers that losses.content compares; empty: the deepest style layer", distinct=True)
    vgg19_file: str = setting(
        "", "parameters of VGG-19, a torchvision state dict or safetensors file; empty: the file "
        "that USDSMOKE_VGG19 names, then torch's hub cache")


class LossesConfig(Section):
    """What is minimised."""

    # In the colour step beside the style; too large a weight keeps the step from it.
    BESIDE_STYLE: ClassVar[tuple[str, ...]] = (
        "nearest", "local_contrast", "content", "histogram", "laplacian", "photorealism",
        "total_variation")

    style: float = setting(
        1.0, "weight of the style; 0 returns the source, whatever the other weights are", ge=0)
    statistic: Literal["gram", "sliced_wasserstein"] = setting(
        "sliced_wasserstein", "how feature maps are compared: by their distributions "
        "(sliced_wasserstein) or, as in the paper, by their Gram matrices (gram)",
        request="statistic")
    histogram: float = setting(
        0.0, "weight of the feature histograms, relative to the style's weight", ge=0)
    nearest: float = setting(
        1.0, "weight of the distances from patches of the pictures to the nearest ones of the "
        "style, and from the style's to the nearest of theirs, in the colour step, relative to "
        "the style's weight; much above 1, pictures are softer", ge=0)
    local_contrast: float = setting(
        10.0, "weight of the contrast and brightness that areas of the pictures lack beside most "
        "areas of the style, in the colour step, relative to the style's weight: so that all of "
        "the smoke shows marks", ge=0)
    content: float = setting(
        0.0, "weight of the loss that preserves the features of the smoke's own grey image", ge=0)
    laplacian: float = setting(
        0.0, "weight of the loss that preserves the edges of the smoke's own grey image", ge=0)
    photorealism: float = setting(
        0.0, "weight of the photorealism loss, which keeps the image a locally linear function of "
        "the source's grey image", ge=0)
    total_variation: float = setting(0.0, "weight of the rendered image's total variation", ge=0)
    keep: float = setting(
        20.0, "weight of the loss that preserves the silhouette in the shape step", ge=0)


class ShapeConfig(Section):
    """The shape step, which moves density."""

    displacement: Literal["stream", "potential", "mixed"] = setting(
        "stream", "how density moves: rotational, nearly without compression (stream), "
        "irrotational (potential), or both (mixed)",
        request="displacement")
    reach: float = setting(
        0.04, "largest displacement; it is less for lumps far apart, and for smoke over ten times "
        "as long as it is wide",
        gt=0, le=0.5, unit="share of the smoke's longest side", request="reach")
    interpolation: Literal["linear", "cubic"] = setting(
        "cubic", "scheme of the final transport")
    mass_correction: bool = setting(True, "scale the moved density to the source's mass")
    learning_rate: float = setting(0.085, "Adam's step for the potential", gt=0)
    iterations: Iterations = setting(
        [30, 15, 30], "iterations per octave, coarse to fine; 0 skips an octave",
        min_length=1, unit="iterations", request="shapeIterations")
    warm_rate: float = setting(
        0.35, "share of the learning rate for a frame that starts from its neighbour's result "
        "or from the coarse step", gt=0, le=1)
    smoothing: float = setting(
        0.5, "share of the next frame's result that is mixed into each frame", ge=0, le=0.5)


class ColourConfig(Section):
    """The colour step, which finds RGB on fixed density."""

    target: Literal["emission", "albedo", "both"] = setting(
        "emission", "what is painted: light that the smoke emits (emission), the share of light "
        "that it scatters (albedo), or that share plus an emission where scattering is not enough "
        "(both)")
    init: Literal["noise", "density"] = setting(
        "noise", "first colours: density times white noise (noise), or plain density (density)",
        request="colourInit")
    occlusion: float = setting(
        0.5, "amount of ambient occlusion in the emission: smoke in the grooves between lumps is "
        "darker, and lumps are brighter on top; 0: none", ge=0, le=1)
    lift: float = setting(
        0.45, "brightest channel that dark areas are lifted towards, with the marks in them, so "
        "that they do not look like holes, but not above nine tenths of the style's "
        "median; dark marks in bright areas stay; 0: none", ge=0, le=0.9)
    grazing: float = setting(
        0.0, "how much marks are smoothed where no side shows them face on, such as on the walls "
        "of grooves: at grazing angles, they look like hairlines; 0: not at all", ge=0, le=1)
    learning_rate: float = setting(0.06, "Adam's step for display-encoded colour in [0, 1]", gt=0)
    iterations: Iterations = setting(
        [40, 40, 40], "iterations per octave, coarse to fine; 0 skips an octave",
        min_length=1, unit="iterations", request="colourIterations")
    warm_rate: float = setting(
        0.35, "share of the learning rate for a frame that starts from its neighbour's result or "
        "from the coarse step", gt=0, le=1)
    smoothing: float = setting(
        0.25, "share of the next frame's result that is mixed into each frame", ge=0, le=0.5)
