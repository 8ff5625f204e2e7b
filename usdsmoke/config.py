"""Every setting, its default and its meaning, in one place; strict reading from YAML and the shell.

One frozen dataclass per step; a section is named like the module that uses it. ``None`` means "let
the scene decide", and the plan says what was decided.
"""

import dataclasses
import difflib
import math
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Mapping

import yaml

from usdsmoke.errors import ConfigError

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
    "config_to_dict",
    "read_config",
    "resolve_config",
]


def _setting(default: Any, doc: str, **limits: Any) -> Any:
    """A dataclass field with its help text and limits: low, high, above, choices."""
    metadata = {"doc": doc, **limits}
    if isinstance(default, (list, dict)):
        return field(default_factory=lambda: type(default)(default), metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class StageConfig:
    """What is read from the stage."""

    prims: list[str] = _setting([], "Volume prim paths; empty means every Volume on the stage")
    frames: str = _setting("", "timeCodes such as 1-24, 1,5,9 or 1-24x2; empty means all")
    density: str = _setting("density", "relationship name of the density field")
    velocity: str = _setting("", "relationship or grid name of the velocity; empty means the usual names")
    velocity_unit: str = _setting(
        "second", "grid-world units per second or per frame", choices=("second", "frame")
    )


@dataclass(frozen=True)
class GridsConfig:
    """How VDB files are read and written."""

    half: bool = _setting(False, "write 16-bit floats")
    repair_nan: float | None = _setting(None, "value that replaces NaN and infinity; unset refuses them")
    refine: int = _setting(1, "subdivide every voxel this many times along each axis", low=1, high=16)
    prune: float = _setting(0.0, "density at or below which a voxel is left inactive", low=0.0)
    memory_limit_gib: float = _setting(8.0, "address space of the process that opens a VDB file", above=0.0)
    time_limit_s: float = _setting(120.0, "seconds after which opening a VDB file is given up", above=0.0)


@dataclass(frozen=True)
class WindowsConfig:
    """How a sequence is cut into frame windows."""

    size: int = _setting(8, "frames in one window; within it a frame starts from its neighbour's result", low=1)
    warm_iterations: float = _setting(
        0.4, "share of the iterations that a frame needs that starts from its neighbour", above=0.0, high=1.0
    )


@dataclass(frozen=True)
class ViewsConfig:
    """From where the smoke is looked at while it is stylized."""

    count: int = _setting(1, "views rendered in every iteration; the reference uses 9", low=1, high=64)
    pool: int = _setting(24, "different views that a run draws from", low=1, high=512)
    sampling: str = _setting(
        "poisson", "how the pool is spread over the ranges", choices=("fixed", "uniform", "poisson")
    )
    azimuth: float = _setting(12.0, "half range around the up axis, degrees", low=0.0, high=180.0)
    elevation: float = _setting(6.0, "half range above and below, degrees", low=0.0, high=90.0)
    centre_azimuth: float = _setting(
        0.0, "middle of the azimuth range; 0 looks down the axis after up's own: -Z for Y-up, +Y for Z-up"
    )
    centre_elevation: float = _setting(0.0, "middle of the elevation range, degrees", low=-90.0, high=90.0)
    image_size: int = _setting(192, "pixels of the longer side of the images that are optimised", low=16, high=2048)


@dataclass(frozen=True)
class OpticsConfig:
    """How dense smoke is taken to be."""

    gamma: float | None = _setting(
        None, "colour step's extinction per density and voxel; the paper shows 0.001, 0.1, 0.5, 1", low=0.0
    )
    gamma_shape: float | None = _setting(None, "the same for the grey pictures of the shape step", low=0.0)
    depth: float = _setting(
        4.0, "optical depth of the thick columns that an unset gamma is chosen for", above=0.0
    )
    depth_shape: float = _setting(1.3, "the same for gamma_shape", above=0.0)
    percentile: float = _setting(90.0, "which columns count as the thick ones", above=0.0, high=100.0)


@dataclass(frozen=True)
class StyleConfig:
    """How the style image is prepared."""

    tiling: int = _setting(1, "the style image is repeated this many times along each side", low=1, high=16)
    size: float = _setting(1.0, "size of the style relative to the rendered image", above=0.0, high=8.0)


@dataclass(frozen=True)
class FeaturesConfig:
    """What the pictures are compared by."""

    network: str = _setting("embedded", "feature extractor", choices=("embedded", "vgg19"))
    layers: list[str] = _setting([], "style layers; empty means the network's default")
    weights: list[float] = _setting([], "one weight for each of them; empty means all 1")
    vgg19_file: str = _setting("", "torchvision state dict or safetensors file; empty means search")


@dataclass(frozen=True)
class LossesConfig:
    """What is minimised."""

    style: float = _setting(1.0, "weight of the style (Gram) loss", low=0.0)
    keep: float = _setting(20.0, "weight that keeps the shape step's smoke inside its silhouette", low=0.0)
    total_variation: float = _setting(0.0, "weight of the rendered image's total variation", low=0.0)


@dataclass(frozen=True)
class ShapeConfig:
    """The shape step: moves density."""

    displacement: str = _setting(
        "stream", "divergence-free, irrotational, or both", choices=("stream", "potential", "mixed")
    )
    reach: float = _setting(0.07, "largest displacement, as a share of the smoke's longest side", above=0.0, high=0.5)
    interpolation: str = _setting(
        "maccormack", "scheme of the final transport", choices=("linear", "maccormack", "cubic")
    )
    mass_correction: bool = _setting(True, "scale the moved density back to the source's mass")
    learning_rate: float = _setting(0.06, "Adam's step for the displacement potential", above=0.0)
    iterations: list[int] = _setting([60, 50, 40], "iterations per octave, coarse to fine")


@dataclass(frozen=True)
class ColourConfig:
    """The colour step: finds RGB on fixed density."""

    init: str = _setting("noise", "density times white noise, or plain density", choices=("noise", "density"))
    learning_rate: float = _setting(0.05, "Adam's step for display-encoded colour in [0, 1]", above=0.0)
    iterations: list[int] = _setting([120, 120, 120], "iterations per octave, coarse to fine")


@dataclass(frozen=True)
class OptimizeConfig:
    """The run as a whole."""

    steps: list[str] = _setting(["shape", "colour"], "which steps to run", choices=("shape", "colour"))
    iterations: int | None = _setting(None, "total iterations of each step; scales its octaves' lists", low=1)
    octave_scale: float = _setting(2.0, "resolution ratio of neighbouring octaves; the reference uses 1.8", low=1.2, high=4.0)
    strength: float = _setting(1.0, "share of the effect that is kept: 0 gives the source back", low=0.0, high=1.0)
    seed: int = _setting(0, "seed of every random draw", low=0)
    device: str = _setting("auto", "auto, cpu or cuda")
    threads: int = _setting(0, "CPU threads; 0 means all", low=0)
    memory_limit_gib: float | None = _setting(None, "refuse plans that need more; unset means the machine's", above=0.0)


@dataclass(frozen=True)
class LayerConfig:
    """What is written."""

    name: str = _setting("", "stem of the VDB files; empty means the Volume prim's name")
    format: str = _setting("usda", "file format of the look layer", choices=("usda", "usdc"))
    copy_velocity: bool = _setting(False, "write the velocity into the result's files as well")
    digital_source_type: str = _setting(
        "algorithmicallyEnhanced",
        "IPTC term of the authorship record",
        choices=("algorithmicallyEnhanced", "compositeWithTrainedAlgorithmicMedia", "trainedAlgorithmicMedia"),
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


def read_config(file_path: str | Path) -> dict[str, dict[str, Any]]:
    """The sections of a YAML file as plain dictionaries, unchecked.

    Raises:
        ConfigError: the file is missing, is no YAML, or is not a mapping of sections.
    """
    try:
        sections = yaml.safe_load(Path(file_path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read the configuration {file_path}: {error}") from None
    if sections is None:
        return {}
    if not isinstance(sections, dict):
        raise ConfigError(
            f"the configuration {file_path} holds a {type(sections).__name__}; "
            "wanted sections such as 'optimize:' with settings below them"
        )
    return sections


def resolve_config(*sources: Mapping[str, Any], assignments: typing.Sequence[str] = ()) -> Config:
    """The defaults, overridden by each source in turn and then by ``section.key=value`` strings.

    Args:
        sources: mappings of section name to mapping of settings, weakest first.
        assignments: texts such as ``windows.size=3``; the value is read as YAML.

    Raises:
        ConfigError: an unknown section or key (names the nearest), a wrong type or range.
    """
    values: dict[str, dict[str, Any]] = {}
    for source in sources:
        for section, settings in source.items():
            _section_class(section)
            if settings is None:
                continue
            if not isinstance(settings, Mapping):
                raise ConfigError(f"section {section} holds {settings!r}; wanted settings below it")
            values.setdefault(section, {}).update(settings)
    for assignment in assignments:
        section, key, value = _split_assignment(assignment)
        values.setdefault(section, {})[key] = value
    sections = {
        name: _build_section(name, _section_class(name), values.get(name, {}))
        for name in _names(Config)
    }
    return Config(**sections)


def config_to_dict(config: Config) -> dict[str, dict[str, Any]]:
    """The configuration as plain nested dictionaries; ``resolve_config`` takes it back unchanged."""
    return dataclasses.asdict(config)


def _names(section_class: type) -> list[str]:
    return [item.name for item in dataclasses.fields(section_class)]


def _section_class(name: str) -> type:
    hints = typing.get_type_hints(Config)
    if name not in hints:
        raise ConfigError(f"unknown section {name!r}{_nearest(name, list(hints))}")
    return hints[name]


def _nearest(word: str, known: list[str]) -> str:
    close = difflib.get_close_matches(str(word), known, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else f"; there are: {', '.join(known)}"


def _split_assignment(text: str) -> tuple[str, str, Any]:
    name, equals, value = text.partition("=")
    section, dot, key = name.strip().partition(".")
    if not equals or not dot:
        raise ConfigError(f"cannot read the setting {text!r}; wanted section.key=value, as in windows.size=3")
    _section_class(section)
    try:
        return section, key, yaml.safe_load(value)
    except yaml.YAMLError as error:
        raise ConfigError(f"cannot read the value of {name.strip()}: {error}") from None


def _build_section(section: str, section_class: type, settings: Mapping[str, Any]) -> Any:
    hints = typing.get_type_hints(section_class)
    fields = {item.name: item for item in dataclasses.fields(section_class)}
    checked = {}
    for key, value in settings.items():
        if key not in fields:
            raise ConfigError(f"unknown setting {section}.{key}{_nearest(key, list(fields))}")
        checked[key] = _check_value(f"{section}.{key}", value, hints[key], fields[key].metadata)
    return section_class(**checked)


def _check_value(where: str, value: Any, wanted: Any, limits: Mapping[str, Any]) -> Any:
    """``value`` as the type that is wanted, within its limits."""
    if isinstance(wanted, types.UnionType):
        if value is None:
            return None
        wanted = next(kind for kind in typing.get_args(wanted) if kind is not type(None))
    if typing.get_origin(wanted) is list:
        (element,) = typing.get_args(wanted)
        if not isinstance(value, (list, tuple)):
            value = [value]
        return [_check_value(f"{where}[{n}]", item, element, limits) for n, item in enumerate(value)]
    if wanted is float and isinstance(value, str):
        try:  # YAML 1.1 reads 1e-3 as a text
            value = float(value)
        except ValueError:
            pass
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if wanted is str and value is None:
        value = ""
    if wanted is str and isinstance(value, (int, float)) and not isinstance(value, bool):
        value = str(value)
    if not isinstance(value, wanted) or (isinstance(value, bool) and wanted is not bool):
        raise ConfigError(f"{where} is {value!r}, a {type(value).__name__}; wanted a {wanted.__name__}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{where} is {value!r}; wanted a finite number")
    if "choices" in limits and value not in limits["choices"]:
        raise ConfigError(
            f"{where} is {value!r}; wanted one of {', '.join(limits['choices'])}"
            if isinstance(value, str)
            else f"{where} is {value!r}"
        )
    for key, holds, sign in (
        ("low", lambda a, b: a >= b, ">="),
        ("above", lambda a, b: a > b, ">"),
        ("high", lambda a, b: a <= b, "<="),
    ):
        if key in limits and not holds(value, limits[key]):
            raise ConfigError(f"{where} is {value!r}; wanted {sign} {limits[key]}")
    return value
