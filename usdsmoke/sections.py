"""Every setting, its default, its limits and its meaning, in one place.

One frozen dataclass per step; a section is named like the module that uses it. ``None`` means "let
the scene decide", and the plan says what was decided. ``usdsmoke.config`` reads these from YAML and
from the command line; import them from there.
"""

from dataclasses import dataclass, field
from typing import Any

__all__ = [
    "ColourConfig",
    "Config",
    "FeaturesConfig",
    "GridsConfig",
    "LayerConfig",
    "LossesConfig",
    "OpticsConfig",
    "OptimizeConfig",
    "ShapeConfig",
    "StageConfig",
    "StyleConfig",
    "ViewsConfig",
    "WindowsConfig",
]


def _setting(default: Any, doc: str, **limits: Any) -> Any:
    """A dataclass field with its help text and its limits.

    ``low``, ``high`` (inclusive) and ``above`` (exclusive) bound a number or every element of a
    list, ``choices`` names the words there are, ``pattern`` is what a text must match as a whole,
    ``least`` is the smallest length of a list, and ``distinct`` refuses a list that names something
    twice.
    """
    metadata = {"doc": doc, **limits}
    if isinstance(default, (list, dict)):
        return field(default_factory=lambda: type(default)(default), metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class StageConfig:
    """What is read from the stage."""

    prims: list[str] = _setting(
        [], "Volume prim paths; empty means every Volume on the stage", distinct=True
    )
    frames: str = _setting("", "timeCodes such as 1-24, 1,5,9 or 1-24x2; empty means all")
    density: str = _setting("density", "relationship name of the density field")
    velocity: str = _setting(
        "", "relationship or grid name of the velocity; empty means the usual names"
    )
    velocity_unit: str = _setting(
        "second", "grid-world units per second or per frame", choices=("second", "frame")
    )
    mask: str = _setting(
        "",
        "relationship or grid name of a scalar field in [0, 1] that scales the effect in space; "
        "empty means none",
    )


@dataclass(frozen=True)
class GridsConfig:
    """How VDB files are read and written."""

    half: bool = _setting(False, "write 16-bit floats")
    repair_nan: float | None = _setting(
        None, "value that replaces NaN and infinity; unset refuses them"
    )
    refine: int = _setting(
        1, "subdivide every voxel this many times along each axis", low=1, high=16
    )
    prune: float = _setting(0.0, "density at or below which a voxel is left inactive", low=0.0)
    memory_limit_gib: float = _setting(
        8.0, "address space of the process that opens a VDB file", above=0.0
    )
    time_limit_s: float = _setting(
        120.0, "seconds after which opening a VDB file is given up", above=0.0
    )


@dataclass(frozen=True)
class WindowsConfig:
    """How a sequence is cut into frame windows."""

    size: int = _setting(
        8, "frames in one window; within it a frame starts from its neighbour's result", low=1
    )
    warm_iterations: float = _setting(
        0.4,
        "share of the iterations that a frame needs that starts from its neighbour",
        above=0.0,
        high=1.0,
    )


@dataclass(frozen=True)
class ViewsConfig:
    """From where the smoke is looked at while it is stylized."""

    count: int = _setting(
        1, "views rendered in every iteration; the reference uses 9", low=1, high=64
    )
    pool: int = _setting(16, "different views that a run draws from", low=1, high=512)
    sampling: str = _setting(
        "poisson", "how the pool is spread over the ranges", choices=("fixed", "uniform", "poisson")
    )
    azimuth: float = _setting(12.0, "half range around the up axis, degrees", low=0.0, high=180.0)
    elevation: float = _setting(6.0, "half range above and below, degrees", low=0.0, high=90.0)
    centre_azimuth: float = _setting(
        0.0,
        "middle of the azimuth range, degrees; 0 looks along -Z (Y-up) or +Y (Z-up)",
    )
    centre_elevation: float = _setting(
        0.0, "middle of the elevation range, degrees", low=-90.0, high=90.0
    )
    image_size: int = _setting(
        192, "pixels of the longer side of the images that are optimised", low=16, high=2048
    )


@dataclass(frozen=True)
class OpticsConfig:
    """How dense smoke is taken to be."""

    gamma: float | None = _setting(
        None,
        "colour step's extinction per density and voxel; the paper shows 0.001, 0.1, 0.5, 1",
        above=0.0,
    )
    gamma_shape: float | None = _setting(
        None, "the same for the grey pictures of the shape step", above=0.0
    )
    depth: float = _setting(
        4.0, "optical depth of the thick columns that an unset gamma is chosen for", above=0.0
    )
    depth_shape: float = _setting(1.3, "the same for gamma_shape", above=0.0)
    percentile: float = _setting(
        90.0, "which columns count as the thick ones", above=0.0, high=100.0
    )


@dataclass(frozen=True)
class StyleConfig:
    """How the style image is prepared."""

    tiling: int = _setting(
        1, "the style image is repeated this many times along each side", low=1, high=16
    )
    size: float = _setting(
        1.0, "size of the style relative to the rendered image", above=0.0, high=8.0
    )
    weights: list[float] = _setting(
        [], "one weight for each style image; their shares count; empty means equal ones", low=0.0
    )


@dataclass(frozen=True)
class FeaturesConfig:
    """What the pictures are compared by."""

    network: str = _setting("embedded", "feature extractor", choices=("embedded", "vgg19"))
    layers: list[str] = _setting([], "style layers; empty means the network's default")
    weights: list[float] = _setting([], "one weight for each of them; empty means all 1", low=0.0)
    content_layers: list[str] = _setting(
        [],
        "layers that losses.content compares; empty means the deepest style layer",
        distinct=True,
    )
    vgg19_file: str = _setting("", "torchvision state dict or safetensors file; empty means search")


@dataclass(frozen=True)
class LossesConfig:
    """What is minimised."""

    style: float = _setting(
        1.0, "weight of the style; 0 gives the source back, whatever else is weighted", low=0.0
    )
    statistic: str = _setting(
        "gram",
        "how feature maps are compared: their Gram matrices, or their distributions",
        choices=("gram", "sliced_wasserstein"),
    )
    histogram: float = _setting(
        0.0, "weight of the feature histograms, as a share of the style's", low=0.0
    )
    content: float = _setting(
        0.0, "weight that keeps the features of the smoke's own grey picture", low=0.0
    )
    laplacian: float = _setting(
        0.0, "weight that keeps the edges of the smoke's own grey picture", low=0.0
    )
    photorealism: float = _setting(
        0.0,
        "weight that keeps the picture locally affine in the smoke's own grey picture",
        low=0.0,
    )
    total_variation: float = _setting(
        0.0, "weight of the rendered image's total variation", low=0.0
    )
    keep: float = _setting(
        20.0, "weight that keeps the shape step's smoke inside its silhouette", low=0.0
    )


@dataclass(frozen=True)
class ShapeConfig:
    """The shape step: moves density."""

    displacement: str = _setting(
        "stream", "divergence-free, irrotational, or both", choices=("stream", "potential", "mixed")
    )
    reach: float = _setting(
        0.04, "largest displacement, as a share of the smoke's longest side", above=0.0, high=0.5
    )
    interpolation: str = _setting(
        "cubic", "scheme of the final transport", choices=("linear", "maccormack", "cubic")
    )
    mass_correction: bool = _setting(True, "scale the moved density back to the source's mass")
    learning_rate: float = _setting(0.04, "Adam's step for the displacement potential", above=0.0)
    iterations: list[int] = _setting(
        [60, 50, 40], "iterations per octave, coarse to fine; 0 leaves one out", low=0, least=1
    )


@dataclass(frozen=True)
class ColourConfig:
    """The colour step: finds RGB on fixed density."""

    init: str = _setting(
        "noise", "density times white noise, or plain density", choices=("noise", "density")
    )
    learning_rate: float = _setting(
        0.05, "Adam's step for display-encoded colour in [0, 1]", above=0.0
    )
    iterations: list[int] = _setting(
        [120, 120, 120], "iterations per octave, coarse to fine; 0 leaves one out", low=0, least=1
    )


@dataclass(frozen=True)
class OptimizeConfig:
    """The run as a whole."""

    steps: list[str] = _setting(
        ["shape", "colour"],
        "which steps to run",
        choices=("shape", "colour"),
        least=1,
        distinct=True,
    )
    iterations: int | None = _setting(
        None, "total iterations of each step; scales its octaves' lists", low=1
    )
    tolerance: float = _setting(
        2e-3,
        "stop an octave when its loss fell by less than this share; 0 never stops early",
        low=0.0,
    )
    strength: float = _setting(
        1.0, "share of the effect that is kept: 0 gives the source back", low=0.0, high=1.0
    )
    seed: int = _setting(0, "seed of every random draw", low=0, high=2**63 - 1)
    device: str = _setting("auto", "auto, cpu or cuda")
    threads: int = _setting(0, "CPU threads; 0 means all", low=0)
    memory_limit_gib: float | None = _setting(
        None, "refuse plans that need more; unset means the machine's", above=0.0
    )


@dataclass(frozen=True)
class LayerConfig:
    """What is written."""

    name: str = _setting(
        "",
        "stem of the VDB files (letters, digits, _ - .); empty means the Volume prim's name",
        pattern=r"(?!\.)[\w.-]*",
    )
    format: str = _setting("usda", "file format of the look layer", choices=("usda", "usdc"))
    copy_velocity: bool | None = _setting(
        None,
        "write the velocity into the result's files; unset: when the Volume has a field for it",
    )
    digital_source_type: str = _setting(
        "algorithmicallyEnhanced",
        "IPTC term of the authorship record",
        choices=(
            "algorithmicallyEnhanced",
            "compositeWithTrainedAlgorithmicMedia",
            "trainedAlgorithmicMedia",
        ),
    )


@dataclass(frozen=True)
class Config:
    """All sections."""

    stage: StageConfig = field(default_factory=StageConfig)
    grids: GridsConfig = field(default_factory=GridsConfig)
    windows: WindowsConfig = field(default_factory=WindowsConfig)
    views: ViewsConfig = field(default_factory=ViewsConfig)
    optics: OpticsConfig = field(default_factory=OpticsConfig)
    style: StyleConfig = field(default_factory=StyleConfig)
    features: FeaturesConfig = field(default_factory=FeaturesConfig)
    losses: LossesConfig = field(default_factory=LossesConfig)
    shape: ShapeConfig = field(default_factory=ShapeConfig)
    colour: ColourConfig = field(default_factory=ColourConfig)
    optimize: OptimizeConfig = field(default_factory=OptimizeConfig)
    layer: LayerConfig = field(default_factory=LayerConfig)
