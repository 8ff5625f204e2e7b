"""Every setting: its default, limits, unit and meaning. One frozen model per section.

``None`` means that the run chooses, and the plan says what it chose. A setting with ``request`` can
also be requested by a Volume on the stage, one with ``control`` for each frame.
"""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdsmoke.base.setting_model import Section, setting

Weights = list[Annotated[float, Field(ge=0)]]
Iterations = list[Annotated[int, Field(ge=0)]]
OWN_NETWORK = "network"  # optimize.start of a run that trains one itself
MOST_STOPS = 40.0  # of optics.exposure, either way
_PER_VOXEL = "1/(voxel of the source grid) per unit of density"


# A table to read: a setting takes two or three lines.
# fmt: off
class StageConfig(Section):
    """What is read from the stage."""

    prims: list[str] = setting(
        [], "paths of Volumes, or of prims above Volumes; empty: every visible Volume",
        distinct=True)
    frames: str = setting(
        "", "timeCodes, such as 1-24, 1,5,9 or 1-24x2 (every second one); empty: all")
    allow_missing: bool = setting(
        False, "skip requested timeCodes without an authored density, and all timeCodes whose file "
        "is missing")
    density: str = setting("density", "relationship name of the density field")
    velocity: str = setting(
        "", "relationship or grid name of the velocity field; empty: the usual names")
    velocity_unit: Literal["second", "frame"] = setting(
        "second", "time unit of the velocity, which is in grid-world units: per second, or per "
        "timeCode (frame)")
    motion: Literal["velocity", "estimate"] = setting(
        "velocity", "what carries results from frame to frame: the velocity field (velocity), or "
        "one estimated from the densities of neighbouring frames (estimate)")
    mask: str = setting(
        "", "relationship or grid name of a scalar field in [0, 1] that scales the effect in "
        "space; empty: none")
    restylize: bool = setting(
        False, "start from smoke that is already stylized, not from the original")


class GridsConfig(Section):
    """How VDB files are read and written."""

    half: bool = setting(False, "write 16-bit floats")
    repair_nan: float | None = setting(
        None, "value that replaces NaN and infinity; unset: they are an error",
        ge=-3.4e38, le=3.4e38)
    refine: int = setting(
        1, "number of parts into which each voxel is divided, per axis", ge=1, le=16)
    prune: float = setting(0.0, "density at or below which a voxel becomes inactive", ge=0)
    memory_limit_gib: float = setting(
        8.0, "memory limit for reading a VDB file", gt=0, unit="GiB")
    time_limit_s: float = setting(
        120.0, "CPU time limit for reading a VDB file; the wall-clock limit is ten times as long",
        gt=0, unit="seconds")


class WindowsConfig(Section):
    """How a sequence is divided into frame windows."""

    size: int = setting(
        8, "frames in one window; inside a window each frame starts from its neighbour's result",
        ge=1, unit="frames", request="windowSize")
    overlap: int = setting(
        4, "frames that neighbouring windows share, at most size; their two results are blended",
        ge=0, unit="frames", request="windowOverlap")
    warm_iterations: float = setting(
        1.0, "share of the iterations for a frame that starts from its neighbour's result",
        gt=0, le=1)
    steadiness: float = setting(
        0.25, "weight of the difference in pixels between a frame's displacement and the one that "
        "it starts from: its neighbour's, carried along, or the coarse step's; higher is steadier, "
        "and farther from the style; colours have colour.warm_rate instead", ge=0)
    shared_octaves: int = setting(
        2, "number of coarsest octaves that are computed once for the whole shot", ge=0)
    pattern_speed: float = setting(
        1.0, "speed of the pattern, as a multiple of the smoke's velocity",
        ge=-8, le=8, request="patternSpeed", control="pattern_speed")


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
        "", "timeCodes that extinction and picture size are measured on, such as 1-2; empty: three "
        "of the stylized ones; a look that is made longer keeps its own")
    percentile: float = setting(
        90.0, "percentile of column depth that counts as thick", gt=0, le=100)
    albedo: float | None = setting(
        None, "share of the extinguished light that smoke and the look's material scatter; "
        "0: lights are ignored; unset: 0.5 if distant lights or domes light the smoke, 1 with "
        "colour.target=albedo",
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
    colour: float = setting(
        1.0, "amount of the style's colour; 0: grey, above 1: more than the style has", ge=0, le=2)
    lift: float = setting(
        0.0, "level to which the style's black is lifted; 0: black, which hides what is behind it; "
        "white stays", ge=0, le=0.9)
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
        "nearest", "content", "histogram", "laplacian", "photorealism", "total_variation")

    style: float = setting(
        1.0, "weight of the style; 0 returns the source, whatever the other weights are", ge=0)
    statistic: Literal["gram", "sliced_wasserstein"] = setting(
        "sliced_wasserstein", "how feature maps are compared: by their distributions "
        "(sliced_wasserstein) or, as in the paper, by their Gram matrices (gram)",
        request="statistic")
    histogram: float = setting(
        0.0, "weight of the feature histograms, relative to the style's weight", ge=0)
    nearest: float = setting(
        1.0, "weight of the distances from the features of the two deepest learned style layers to "
        "the nearest ones of the style, and from the style's to the nearest of theirs, in the "
        "colour step, relative to the style's weight; above 1, pieces of the style repeat", ge=0)
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
    learning_rate: float = setting(0.06, "Adam's step for display-encoded colour in [0, 1]", gt=0)
    iterations: Iterations = setting(
        [40, 40, 40], "iterations per octave, coarse to fine; 0 skips an octave",
        min_length=1, unit="iterations", request="colourIterations")
    warm_rate: float = setting(
        0.35, "share of the learning rate for a frame that starts from its neighbour's result or "
        "from the coarse step", gt=0, le=1)
    smoothing: float = setting(
        0.25, "share of the next frame's result that is mixed into each frame", ge=0, le=0.5)


class OptimizeConfig(Section):
    """The run as a whole."""

    steps: list[Literal["shape", "colour"]] = setting(
        ["shape", "colour"], "steps to run: shape moves the density, colour computes its RGB",
        min_length=1, distinct=True, request="steps")
    iterations: int | None = setting(
        None, "total iterations of each step; the lists per octave are scaled to it; unset: the "
        "lists as they are; 0 with optimize.start: the result is what the network paints", ge=0,
        unit="iterations", request="iterations")
    start: str = setting(
        "", "network that frames without a neighbour start from: a file that 'usdsmoke train' "
        "wrote, or network for one that the run trains first; they have two fifths of the finest "
        "octave's iterations, or all of them where other octaves have none; default: such frames "
        "start from noise")
    tolerance: float = setting(
        2e-3, "stopping threshold of the optimiser. A loss that falls by less than this share over "
        "a quarter of an octave is a plateau; the learning rate then falls early, and the octave "
        "ends after that. 0: never", ge=0)
    strength: float = setting(
        1.0, "share of the effect that is kept; 0 returns the source",
        ge=0, le=1, request="strength", control="strength")
    error_budget: bool = setting(
        True, "estimate the remaining errors from a few images of every finished frame")
    seed: int = setting(0, "seed for all random numbers", ge=0, le=2**63 - 1, request="seed")
    device: str = setting(
        "auto", "where to compute", pattern=r"auto|cpu|cuda(:\d+)?", form="auto, cpu or cuda")
    threads: int = setting(
        0, "CPU threads of a process; results do not depend on it; 0: those that are available, "
        "divided among the processes of --jobs, at most 4", ge=0)
    memory_limit_gib: float | None = setting(
        None, "memory that a run may need; unset: the machine's memory", gt=0, unit="GiB")

    @property
    def paints(self) -> bool:
        """Whether a network gives the colours that frames without a neighbour start from."""
        return bool(self.start) and "colour" in self.steps

    @property
    def trains(self) -> bool:
        """Whether the run trains the network that its frames start from."""
        return self.start == OWN_NETWORK and self.paints

    @property
    def start_file(self) -> str:
        """The file of a network that is trained already; "" without one."""
        return "" if self.start == OWN_NETWORK else self.start


class LayerConfig(Section):
    """What is written."""

    mode: Literal["sublayer", "reference", "layer"] = setting(
        "sublayer", "form of the result: a root layer with the look over the source (sublayer), an "
        "asset with a variant for each look that references the source (reference), or the look "
        "layer alone (layer)")
    look: str = setting(
        "stylized", "name of the look and of its variant; a folder can hold several looks",
        pattern="(?!original$)[A-Za-z_][A-Za-z0-9_]*",
        form="letters, digits and _, not starting with a digit, not 'original'")
    name: str = setting(
        "", "stem of the VDB files; empty: the Volume prim's name",
        pattern=r"(?!\.)[\w.-]*", form="letters, digits, _ - . only, not starting with a dot")
    files: str = setting(
        "", "path of each frame's VDB file in the output folder, such as "
        "{prim}/{look}/{name}.{frame:04d}.vdb; empty: vdb/KEY/NAME.####.vdb, where KEY is the "
        "run's")
    format: Literal["usda", "usdc"] = setting("usda", "file format of the look layer")
    copy_velocity: bool | None = setting(
        None, "write the velocity into the result's files; unset: only if the Volume has a "
        "velocity field")
    compact_velocity: bool = setting(
        False, "write the copied velocity only where the result has smoke, and in 16-bit floats")
    copy_fields: list[str] = setting(
        [], "other fields of the Volume, and grids in its density's file, to write into the "
        "result's files: their names, or all; empty: none", distinct=True)
    move_fields: bool = setting(
        True, "copied fields move with the density; false: they stay where they are. The copied "
        "velocity always stays")
    emission_mode: Literal["absolute", "perDensity"] = setting(
        "absolute", "meaning of the emission field: radiance per stage unit (absolute), or the "
        "same divided by density (perDensity), for renderers that multiply emission by density")
    scatter_colour: list[Literal["Cd", "color"]] = setting(
        [], "names under which the colour is also written as a scattering colour", distinct=True)
    split_rgb: bool = setting(
        False, "also write the red, green and blue of each colour as separate float grids")
    contact_sheet: int = setting(
        512, "height of the contact sheet's pictures, at most four pixels a voxel; 0: no contact "
        "sheet", ge=0, le=2048, unit="pixels")
    material: Literal["auto", "replace", "none"] = setting(
        "auto", "material of the Volume: one that shows the look, unless a volume material is "
        "bound (auto); one that shows the look in place of a bound one (replace); no change (none)")
    material_targets: list[Literal["glslfx", "mtlx", "arnold", "karma", "renderman"]] = setting(
        ["glslfx", "mtlx"], "what the material has a volume shader for: Hydra Storm (glslfx), "
        "MaterialX (mtlx), Arnold (arnold), Karma (karma), RenderMan (renderman); all but Storm's "
        "have not been rendered",
        min_length=1, distinct=True)
    digital_source_type: Literal[
        "algorithmicallyEnhanced",
        "compositeWithTrainedAlgorithmicMedia",
        "trainedAlgorithmicMedia",
    ] = setting("algorithmicallyEnhanced", "IPTC term of the authorship record")
