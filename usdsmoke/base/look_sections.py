"""The settings that decide the look, for ``usdsmoke.base.sections``: import them from there."""

from dataclasses import dataclass

from usdsmoke.base.setting_checks import setting

__all__ = [
    "ColourConfig",
    "FeaturesConfig",
    "LossesConfig",
    "OpticsConfig",
    "OptimizeConfig",
    "ShapeConfig",
    "StyleConfig",
    "ViewsConfig",
]


@dataclass(frozen=True)
class ViewsConfig:
    """From where the smoke is looked at while it is stylized."""

    count: int = setting(
        1, "views rendered in every iteration; the reference uses 9", low=1, high=64
    )
    pool: int = setting(16, "different views that a run draws from", low=1, high=512)
    sampling: str = setting(
        "poisson", "how the pool is spread over the ranges", choices=("fixed", "uniform", "poisson")
    )
    azimuth: float = setting(
        12.0, "half range around the up axis, or the camera's, degrees", low=0.0, high=180.0
    )
    elevation: float = setting(6.0, "half range above and below, degrees", low=0.0, high=90.0)
    centre_azimuth: float = setting(
        0.0,
        "middle of the azimuth range, degrees; 0 looks along -Z (Y-up), +Y (Z-up) or as the camera",
    )
    centre_elevation: float = setting(
        0.0, "middle of the elevation range, degrees", low=-90.0, high=90.0
    )
    image_size: int = setting(
        192, "pixels of the longer side of the images that are optimised", low=16, high=2048
    )
    camera: str = setting(
        "",
        "the shot's Camera prim: views lie around its direction, and only what it sees is "
        "stylized; empty goes around the up axis",
    )
    camera_width: int = setting(
        1920, "pixels of the shot's width; no finer detail is optimised", low=1, high=65536
    )
    camera_margin: float = setting(
        0.05,
        "share of the camera's picture width over which the effect ends beyond its edges",
        above=0.0,
        high=1.0,
    )


@dataclass(frozen=True)
class OpticsConfig:
    """How dense smoke is taken to be."""

    gamma: float | None = setting(
        None,
        "colour step's extinction per density and voxel; the paper shows 0.001, 0.1, 0.5, 1",
        above=0.0,
    )
    gamma_shape: float | None = setting(
        None, "the same for the grey pictures of the shape step", above=0.0
    )
    depth: float = setting(
        4.0, "optical depth of the thick columns that an unset gamma is chosen for", above=0.0
    )
    depth_shape: float = setting(1.3, "the same for gamma_shape", above=0.0)
    percentile: float = setting(
        90.0, "which columns count as the thick ones", above=0.0, high=100.0
    )


@dataclass(frozen=True)
class StyleConfig:
    """How the style image is prepared."""

    tiling: int = setting(
        1, "the style image is repeated this many times along each side", low=1, high=16
    )
    size: float = setting(
        1.0, "size of the style relative to the rendered image", above=0.0, high=8.0
    )
    weights: list[float] = setting(
        [], "one weight for each style image; their shares count; empty means equal ones", low=0.0
    )


@dataclass(frozen=True)
class FeaturesConfig:
    """What the pictures are compared by."""

    network: str = setting("embedded", "feature extractor", choices=("embedded", "vgg19"))
    layers: list[str] = setting([], "style layers; empty means the network's default")
    weights: list[float] = setting([], "one weight for each of them; empty means all 1", low=0.0)
    content_layers: list[str] = setting(
        [],
        "layers that losses.content compares; empty means the deepest style layer",
        distinct=True,
    )
    vgg19_file: str = setting("", "torchvision state dict or safetensors file; empty means search")


@dataclass(frozen=True)
class LossesConfig:
    """What is minimised."""

    style: float = setting(
        1.0, "weight of the style; 0 gives the source back, whatever else is weighted", low=0.0
    )
    statistic: str = setting(
        "gram",
        "how feature maps are compared: their Gram matrices, or their distributions",
        choices=("gram", "sliced_wasserstein"),
    )
    histogram: float = setting(
        0.0, "weight of the feature histograms, as a share of the style's", low=0.0
    )
    content: float = setting(
        0.0, "weight that keeps the features of the smoke's own grey picture", low=0.0
    )
    laplacian: float = setting(
        0.0, "weight that keeps the edges of the smoke's own grey picture", low=0.0
    )
    photorealism: float = setting(
        0.0,
        "weight that keeps the picture locally affine in the smoke's own grey picture",
        low=0.0,
    )
    total_variation: float = setting(0.0, "weight of the rendered image's total variation", low=0.0)
    keep: float = setting(
        20.0, "weight that keeps the shape step's smoke inside its silhouette", low=0.0
    )


@dataclass(frozen=True)
class ShapeConfig:
    """The shape step: moves density."""

    displacement: str = setting(
        "stream", "divergence-free, irrotational, or both", choices=("stream", "potential", "mixed")
    )
    reach: float = setting(
        0.04, "largest displacement, as a share of the smoke's longest side", above=0.0, high=0.5
    )
    interpolation: str = setting(
        "cubic", "scheme of the final transport", choices=("linear", "cubic")
    )
    mass_correction: bool = setting(True, "scale the moved density back to the source's mass")
    learning_rate: float = setting(0.06, "Adam's step for the displacement potential", above=0.0)
    iterations: list[int] = setting(
        [60, 50, 40], "iterations per octave, coarse to fine; 0 leaves one out", low=0, least=1
    )
    warm_rate: float = setting(
        0.12,
        "share of the learning rate for a frame that starts from its neighbour's result",
        above=0.0,
        high=1.0,
    )
    smoothing: float = setting(
        0.5,
        "share of the following frame's result, carried back, in every frame's",
        low=0.0,
        high=0.5,
    )


@dataclass(frozen=True)
class ColourConfig:
    """The colour step: finds RGB on fixed density."""

    init: str = setting(
        "noise", "density times white noise, or plain density", choices=("noise", "density")
    )
    learning_rate: float = setting(
        0.05, "Adam's step for display-encoded colour in [0, 1]", above=0.0
    )
    iterations: list[int] = setting(
        [120, 120, 120], "iterations per octave, coarse to fine; 0 leaves one out", low=0, least=1
    )
    warm_rate: float = setting(
        0.35,
        "share of the learning rate for a frame that starts from its neighbour's result",
        above=0.0,
        high=1.0,
    )
    smoothing: float = setting(
        0.25,
        "share of the following frame's result, carried back, in every frame's",
        low=0.0,
        high=0.5,
    )


@dataclass(frozen=True)
class OptimizeConfig:
    """The run as a whole."""

    steps: list[str] = setting(
        ["shape", "colour"],
        "which steps to run",
        choices=("shape", "colour"),
        least=1,
        distinct=True,
    )
    iterations: int | None = setting(
        None, "total iterations of each step; scales its octaves' lists", low=1
    )
    tolerance: float = setting(
        2e-3,
        "stop an octave when its loss fell by less than this share; 0 never stops early",
        low=0.0,
    )
    target_error: float | None = setting(
        None,
        "tolerance that picture size, views, iterations, transport and storage are chosen for, "
        "unless they are set; unset chooses nothing",
        above=0.0,
        high=1.0,
    )
    strength: float = setting(
        1.0, "share of the effect that is kept: 0 gives the source back", low=0.0, high=1.0
    )
    error_budget: bool = setting(
        True, "estimate what is left of each error, from a few pictures of every finished frame"
    )
    seed: int = setting(0, "seed of every random draw", low=0, high=2**63 - 1)
    device: str = setting("auto", "auto, cpu or cuda")
    threads: int = setting(
        0,
        "CPU threads, the same for the whole run; 0 takes all there are when it is begun",
        low=0,
    )
    memory_limit_gib: float | None = setting(
        None, "refuse plans that need more; unset means the machine's", above=0.0
    )
