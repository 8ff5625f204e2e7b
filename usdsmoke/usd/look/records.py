"""What the look layer is made from, and where it goes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePath

from usdsmoke.base.naming import EMISSION, look_suffix
from usdsmoke.base.volume import LightSource, VolumeSource, WrittenFrame
from usdsmoke.config.run_sections import LayerConfig
from usdsmoke.usd.field_samples import held_time_code
from usdsmoke.usd.schema import EMISSION_ABSOLUTE


@dataclass(frozen=True)
class StylizedVolume:
    """One Volume's result, ready to be put on the stage.

    Where the source is shown there is no colour of ours. A blocked ``filePath`` says so in USD's
    own words, but Hydra Storm raises an error for every field without a file. With an
    ``empty_file`` the colours show that one instead, and Storm draws in silence. Where it stands at
    the first timeCode, a number in its name that fits the others' (``NAME.0001.vdb`` for timeCode
    1) keeps Blender's count of the sequence right.
    """

    source: VolumeSource
    frames: Sequence[WrittenFrame]
    extinction_per_density: float  # 1/(stage unit) per unit of density
    grids: Mapping[str, str] = field(
        default_factory=lambda: {"density": "density", EMISSION: EMISSION}
    )  # relationship name: name of its grid in the written files
    empty_file: str = ""  # absolute; a VDB whose colour grids have no voxel
    empty_hash: str = ""  # its content hash, see ``vdb.content_hash``; "" when it is not known
    emission_mode: str = EMISSION_ABSOLUTE  # token of usdSmoke:emissionMode
    styles: tuple[str, ...] | None = None  # "name sha256" of each image; None: those of the run
    seed: int | None = None  # None: the run's
    albedo: float = 0.0  # share of the light that is scattered; 0: no light
    anisotropy: float = 0.0
    bounces: bool = False  # whether it is made for light that is scattered more than once
    named_lights: tuple[LightSource, ...] = ()  # in place of the stage's own
    stops: float = 0.0  # exposure at which the look shows its style
    scatter_field: str = ""  # its colour is the albedo of each voxel; "": the albedo is even
    # By timeCode, where the extinction changes in time; empty where it does not.
    extinction_samples: Mapping[float, float] = field(default_factory=dict)

    def frame_at(self, time_code: float) -> WrittenFrame | None:
        """The result's frame at any time, held as USD holds it; None where the source is shown."""
        held = held_time_code(self.source.time_codes, time_code)
        return self._by_time_code.get(held)

    @cached_property
    def _by_time_code(self) -> dict[float, WrittenFrame]:
        return {frame.time_code: frame for frame in self.frames}

    @property
    def first_frame(self) -> WrittenFrame:
        """The earliest frame of the result: what is shown without a time."""
        return min(self.frames, key=lambda frame: frame.time_code)


@dataclass(frozen=True)
class LookFiles:
    """The USD files of a result, and the shader that they name."""

    look_layer: Path  # the override layer: everything usdsmoke has to say
    root_stage: Path | None  # the stage to open; None in the mode ``layer``
    shader: Path | None = None  # Storm's volume shader; None where no material needs it

    @property
    def written(self) -> tuple[Path, ...]:
        """All of them."""
        files = (self.look_layer, self.root_stage, self.shader)
        return tuple(path for path in files if path is not None)


def shader_name(config: LayerConfig) -> str:
    """The name of Storm's volume shader, which lies beside the look layer."""
    return f"look{look_suffix(config.look)}.glslfx"


def look_files(stage_file: str | PurePath, output_folder: Path, config: LayerConfig) -> LookFiles:
    """Where ``author_look`` will write, before anything is written.

    Args:
        stage_file: the source; only its name counts.
    """
    stem, suffix = PurePath(stage_file).stem, look_suffix(config.look)
    folder = Path(output_folder)
    roots = {
        "sublayer": folder / f"{stem}_look{suffix}.usda",
        "reference": folder / f"{stem}_asset.usda",
    }
    return LookFiles(folder / f"look{suffix}.{config.format}", roots.get(config.mode))
