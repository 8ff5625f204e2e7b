"""The settings of a run, by section: what is read, windows, the optimiser, what is written.

``None`` means that the run chooses, and the plan says what it chose. A setting with ``request`` can
also be requested by a Volume on the stage, one with ``control`` for each frame.
"""

from typing import Literal

from usdsmoke.config.setting_model import Section, setting

OWN_NETWORK = "network"  # optimize.start of a run that trains one itself
EVERYTHING = "all"  # in layer.copy_fields


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
    refine: int | None = setting(
        None, "number of parts into which each voxel is divided, per axis; unset: chosen in the "
        "plan, 1 or, for small smoke, up to 4", ge=1, le=16)
    prune: float = setting(0.0, "density at or below which a voxel becomes inactive", ge=0)
    memory_limit_gib: float = setting(
        8.0, "memory limit for reading a VDB file", gt=0, unit="GiB")
    time_limit_s: float = setting(
        120.0, "CPU time limit for reading a VDB file; the wall-clock limit is ten times as long",
        gt=0, unit="seconds")

    @property
    def parts(self) -> int:
        """``refine``; 1 where it is open. A plan sets an open one for each Volume."""
        return self.refine or 1


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
        1.0, "share of the displacement and of the brightness of colours that is kept; 0 returns "
        "the source's density without colours",
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
