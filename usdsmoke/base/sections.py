"""Every setting, its default, its limits and its meaning, in one place.

One frozen dataclass per step; a section is named like the module that uses it. ``None`` means "let
the scene decide", and the plan says what was decided. Those that decide the look stand in
``look_sections``. ``usdsmoke.base.config`` reads all of them from YAML and from the command
line; import them from there.
"""

from dataclasses import dataclass, field

from usdsmoke.base.look_sections import (
    ColourConfig,
    FeaturesConfig,
    LossesConfig,
    OpticsConfig,
    OptimizeConfig,
    ShapeConfig,
    StyleConfig,
    ViewsConfig,
)
from usdsmoke.base.setting_checks import setting

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


@dataclass(frozen=True)
class StageConfig:
    """What is read from the stage."""

    prims: list[str] = setting(
        [], "Volume prim paths; empty means every Volume on the stage", distinct=True
    )
    frames: str = setting("", "timeCodes such as 1-24, 1,5,9 or 1-24x2; empty means all")
    density: str = setting("density", "relationship name of the density field")
    velocity: str = setting(
        "", "relationship or grid name of the velocity; empty means the usual names"
    )
    velocity_unit: str = setting(
        "second",
        "grid-world units per second, or per frame of the simulation, which is one timeCode "
        "whatever framesPerSecond says",
        choices=("second", "frame"),
    )
    motion: str = setting(
        "velocity",
        "what results are carried along by: the velocity that is there, or one estimated from the "
        "densities of neighbouring frames",
        choices=("velocity", "estimate"),
    )
    mask: str = setting(
        "",
        "relationship or grid name of a scalar field in [0, 1] that scales the effect in space; "
        "empty means none",
    )
    restylize: bool = setting(
        False,
        "take smoke that usdsmoke has stylized before as the source; otherwise a result starts "
        "from the original",
    )


@dataclass(frozen=True)
class GridsConfig:
    """How VDB files are read and written."""

    half: bool = setting(False, "write 16-bit floats")
    repair_nan: float | None = setting(
        None, "value that replaces NaN and infinity; unset refuses them"
    )
    refine: int = setting(
        1, "subdivide every voxel this many times along each axis", low=1, high=16
    )
    prune: float = setting(0.0, "density at or below which a voxel is left inactive", low=0.0)
    memory_limit_gib: float = setting(
        8.0, "address space of the process that opens a VDB file", above=0.0
    )
    time_limit_s: float = setting(
        120.0,
        "seconds of the processor, or ten times as many by the clock, after which opening a VDB "
        "file is given up",
        above=0.0,
    )


@dataclass(frozen=True)
class WindowsConfig:
    """How a sequence is cut into frame windows."""

    size: int = setting(
        8, "frames in one window; within it a frame starts from its neighbour's result", low=1
    )
    overlap: int = setting(
        4, "frames that a window goes on into the next one, where both are blended; 0: none", low=0
    )
    warm_iterations: float = setting(
        0.4,
        "share of the iterations that a frame needs that starts from its neighbour",
        above=0.0,
        high=1.0,
    )
    shared_octaves: int = setting(
        2, "octaves, the coarsest ones, that are done once for the whole shot", low=0
    )
    pattern_speed: float = setting(
        1.0, "how fast the pattern moves, as a multiple of the smoke's velocity", low=-8.0, high=8.0
    )


@dataclass(frozen=True)
class LayerConfig:
    """What is written."""

    mode: str = setting(
        "sublayer",
        "how the result is put on the stage: a root stage with the look over the source, an asset "
        "that references the source and has a variant for each look, or the look layer alone",
        choices=("sublayer", "reference", "layer"),
    )
    look: str = setting(
        "stylized",
        "name of the look, and of its variant; different looks stand side by side in one folder",
        pattern=r"(?!original$)[A-Za-z_][A-Za-z0-9_]*",
        wanted="letters, digits and _, no digit first, and not original",
    )
    name: str = setting(
        "",
        "stem of the VDB files (letters, digits, _ - .); empty means the Volume prim's name",
        pattern=r"(?!\.)[\w.-]*",
        wanted="letters, digits, _ - . only, not starting with a dot",
    )
    format: str = setting("usda", "file format of the look layer", choices=("usda", "usdc"))
    copy_velocity: bool | None = setting(
        None,
        "write the velocity into the result's files; unset: when the Volume has a field for it",
    )
    emission_mode: str = setting(
        "absolute",
        "what the emission holds: radiance per stage unit, or that divided by density",
        choices=("absolute", "perDensity"),
    )
    scatter_colour: list[str] = setting(
        [],
        "names under which the painted colour is written as a scattering colour too",
        choices=("Cd", "color"),
        distinct=True,
    )
    split_rgb: bool = setting(
        False, "write red, green and blue of every colour as grids of floats too"
    )
    digital_source_type: str = setting(
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
