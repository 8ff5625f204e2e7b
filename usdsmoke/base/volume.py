"""Plain records that all packages share: stage sources, dense fields and results.

Matrices are 4x4 float64 in the row-vector convention that USD and OpenVDB share: a point is a row,
``[x y z 1] @ a_to_b``, and the translation is in the last row. Arrays are in index order
``[i j k]``, as in OpenVDB.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from usdsmoke.base.errors import ShapeError

# What relationships and grids of velocity are called: by Houdini, Arnold and MoonRay, Blender.
VELOCITY_NAMES = ("vel", "v", "velocity")
# What is between such a name and the x, y or z of a component. USD names have no dots.
GRID_SEPARATORS = (".", "_")  # vel.x in Houdini, velocity_x in Blender
FIELD_SEPARATORS = ("_", ":", "")  # of a Volume's relationships: field:vel_x, field:vel:x

_ROUNDING = 1e-9  # of elements of a matrix, relative to the largest of their kind


def is_same_transform(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two matrices [4 4] are the same, apart from rounding.

    A turn by 90 degrees has elements of 1e-16 where another program writes 0.
    """
    difference = np.abs(one - other)
    linear, whole = np.abs(one[:3, :3]).max(), np.abs(one).max()
    is_turned_alike = difference[:3, :3].max() <= _ROUNDING * linear
    return bool(is_turned_alike and difference.max() <= _ROUNDING * whole)


@dataclass(frozen=True)
class FieldSource:
    """The source of a field's values at one timeCode; only USD is read from disk."""

    relationship: str  # its name in the Volume: "density" for field:density
    prim_path: str  # the field prim's path
    time_code: float
    file_path: str  # resolved, absolute
    authored_path: str  # as authored in the layer
    grid_name: str  # fieldName; "" when not authored
    grid_index: int | None  # fieldIndex; None when not authored
    field_to_stage: np.ndarray  # [4 4] the field prim's local-to-world at time_code
    data_type: str = ""  # fieldDataType token as authored, "" when missing
    field_class: str = ""  # fieldClass token as authored, "" when missing
    # How layer offsets slow down what the layer of the file path holds: by timeCodes, and by
    # seconds, which differ where the layer has another number of timeCodes per second.
    code_stretch: float = 1.0
    time_stretch: float = 1.0


@dataclass(frozen=True)
class CameraSource:
    """A UsdGeomCamera at one timeCode; film and lens are measured in one unit of their own."""

    prim_path: str
    camera_to_stage: np.ndarray  # [4 4] local-to-world; the camera looks along its -Z, +Y is up
    focal_length: float
    horizontal_aperture: float
    vertical_aperture: float
    horizontal_offset: float  # of the aperture's centre
    vertical_offset: float
    clipping_range: tuple[float, float]  # near and far, stage units
    is_orthographic: bool = False  # apertures are then in tenths of a stage unit


@dataclass(frozen=True)
class LightSource:
    """A light of the stage at one timeCode, far away or all around."""

    prim_path: str
    # Scene-linear Rec.709. Of a distant light the irradiance of a surface that faces it, of a dome
    # its radiance.
    colour: tuple[float, float, float]
    towards: tuple[float, float, float] | None = None  # unit vector to it, stage; None: a dome


@dataclass(frozen=True)
class Scattering:
    """What smoke scatters, and how."""

    lights: tuple[LightSource, ...]
    albedo: float  # share of the light that it takes away and scatters, in [0, 1]
    anisotropy: float = 0.0  # mean cosine of the angle, in (-1, 1); 0: to all sides
    bounces: bool = False  # whether light is scattered more than once

    @property
    def is_uneven(self) -> bool:
        """Whether it looks brighter from some sides."""
        return bool(self.lights) and self.albedo > 0 and self.anisotropy != 0

    def exposed(self, stops: float) -> "Scattering":
        """The same in lights that are 2^stops times as bright."""
        if stops == 0:
            return self
        lights = (
            replace(light, colour=tuple(2.0**stops * channel for channel in light.colour))
            for light in self.lights
        )
        return replace(self, lights=tuple(lights))


@dataclass(frozen=True)
class FrameControls:
    """Settings that have a value of their own at one timeCode; None leaves the run's."""

    strength: float | None = None  # optimize.strength
    pattern_speed: float | None = None  # windows.pattern_speed, from this frame to the next
    gamma: float | None = None  # optics.gamma
    style_weights: tuple[float, ...] | None = None  # style.weights


@dataclass(frozen=True)
class StyleRequest:
    """Settings authored on a Volume prim; empty if there are none."""

    styles: tuple[str, ...] = ()  # image files, absolute
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # by section and key
    ignored: tuple[str, ...] = ()  # attributes without effect: UsdSmokeStyleAPI is not applied


@dataclass(frozen=True)
class BoundMaterial:
    """A material that a Volume is bound to."""

    prim_path: str
    # The colour grids of looks that its volume shaders name, by render context; "" is for all
    # others. Empty: it has no volume shader, and renderers take their fallback.
    readers: Mapping[str, tuple[str, ...]]
    can_replace: bool  # False: a binding of an ancestor or a collection wins over the Volume's own
    multiplies: tuple[str, ...] = ()  # contexts that multiply a look's emission by the density
    # The number by which a shader that shows a look multiplies the density, by context; without
    # those that a network drives.
    densities: Mapping[str, float] = field(default_factory=dict)
    is_of_look: bool = False  # an earlier look brought it

    def hidden_in(self, colours: Collection[str]) -> tuple[str, ...]:
        """The contexts in which a look with these colour grids is not seen; ("",) without shaders.

        >>> BoundMaterial("/m", {"ri": (), "arnold": ("emission",)}, True).hidden_in(["emission"])
        ('ri',)
        """
        readers = self.readers or {"": ()}
        return tuple(name for name, read in readers.items() if not set(read) & set(colours))


@dataclass(frozen=True)
class FrameSource:
    """One timeCode of one Volume: its fields by relationship name."""

    time_code: float
    fields: Mapping[str, FieldSource]
    controls: FrameControls = FrameControls()
    camera: CameraSource | None = None  # None: no shot camera is configured
    lights: tuple[LightSource, ...] = ()  # that light the smoke; none where it scatters none


@dataclass(frozen=True)
class VolumeSource:
    """One Volume prim and every timeCode at which any of its field files is authored."""

    prim_path: str
    frames: tuple[FrameSource, ...]  # ascending time_code; one frame when nothing is animated
    animated: bool  # False: the files come from a default, not from time samples
    time_codes: tuple[float, ...] = ()  # all of the density, selected or not, gaps included
    density: str = "density"  # relationship name of the density field
    velocity: tuple[str, ...] = ()  # relationship names of the velocity: one vector or x, y, z
    mask: str = ""  # relationship name of the mask; "" when it has none, or none is configured
    other_fields: tuple[str, ...] = ()  # relationship names that are not used
    copied: tuple[str, ...] = ()  # relationship names of others, to be copied (layer.copy_fields)
    request: StyleRequest = StyleRequest()
    materials: tuple[BoundMaterial, ...] = ()  # bound to it, one for each purpose
    variants: Mapping[str, str] = field(default_factory=dict)  # selected here and above, by set
    notes: tuple[str, ...] = ()  # what programs disagree on, a sentence each without a full stop


@dataclass(frozen=True)
class StageSource:
    """What usdsmoke reads from a stage, as plain values."""

    file_path: str  # resolved root layer path
    up_axis: str  # "Y" or "Z"
    meters_per_unit: float
    time_codes_per_second: float
    frames_per_second: float
    start_time_code: float | None  # None when not authored
    end_time_code: float | None
    default_prim: str  # "" when there is none
    volumes: tuple[VolumeSource, ...] = ()
    omitted: Mapping[str, str] = field(default_factory=dict)  # Volume path: why it is left out
    missing: tuple[str, ...] = ()  # requested timeCodes that are left out, a sentence each
    # Layers, prims and offsets that composition drops; a sentence each without a full stop.
    dropped: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()  # prim paths; empty if every Volume has one of its own
    lights: tuple[str, ...] = ()  # prim paths, used or not
    # Lights that would light smoke and cannot be used: why, by path.
    unused_lights: Mapping[str, str] = field(default_factory=dict)

    @property
    def grid_files(self) -> list[str]:
        """The VDB files of all selected frames, each once, in order."""
        fields = (
            field
            for volume in self.volumes
            for frame in volume.frames
            for field in frame.fields.values()
        )
        return list(dict.fromkeys(field.file_path for field in fields))

    @property
    def frame_length(self) -> float:
        """TimeCodes per frame; 1 if the stage's rates are invalid."""
        rates = (self.time_codes_per_second, self.frames_per_second)
        return rates[0] / rates[1] if min(rates) > 0 else 1.0


@dataclass(frozen=True)
class EarlierLooks:
    """Existing looks of a stage, which are left out when it is read."""

    notes: tuple[str, ...] = ()  # notes for the user, a sentence each
    layers: tuple[str, ...] = ()  # files of the look layers that are left out; absolute
    variants: tuple[str, ...] = ()  # prims whose variant without a look is selected
    # Volume path: names of field relationships that only an earlier look gives it.
    fields: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class DenseField:
    """A VDB grid's active bounding box as a dense array, with its position in space.

    ``values`` is float32, [i j k] or [i j k 3], C order; an empty grid has shape (0, 0, 0). A voxel
    is taken as active when it differs from ``background``. ``index_to_world`` maps *grid* index
    coordinates (``ijk_min`` is the index of ``values[0, 0, 0]``) to the grid's world space, which
    is the field prim's local space.
    """

    name: str
    values: np.ndarray
    ijk_min: tuple[int, int, int]
    index_to_world: np.ndarray  # [4 4] float64, row vectors
    background: float | tuple[float, float, float] = 0.0
    grid_class: str = "fog volume"  # "fog volume", "staggered", "unknown"
    half: bool = False  # stored as half float
    metadata: Mapping[str, Any] = field(default_factory=dict)  # the grid's own, without file_* keys
    beside: float = 0.0  # largest value of inactive voxels near the box; 0 for vectors
    repaired: int = 0  # voxels whose NaN or infinity was replaced when they were read

    def __post_init__(self) -> None:
        if self.values.ndim not in (3, 4) or (self.values.ndim == 4 and self.values.shape[3] != 3):
            raise ShapeError(
                f'grid "{self.name}" has values of shape {list(self.values.shape)}. '
                "Pass [i j k] or [i j k 3]."
            )
        if np.shape(self.index_to_world) != (4, 4):
            raise ShapeError(
                f'grid "{self.name}" has a transform of shape '
                f"{list(np.shape(self.index_to_world))}. Pass [4 4]."
            )

    @property
    def is_empty(self) -> bool:
        """True when the grid has no active voxel box at all."""
        return self.values.size == 0

    def at(self, ijk: np.ndarray) -> np.ndarray:
        """Values [N] or [N C] at indices [N 3]; 0 outside the box."""
        index = ijk - np.asarray(self.ijk_min)
        inside = ((index >= 0) & (index < self.values.shape[:3])).all(axis=1)
        found = np.zeros((len(index), *self.values.shape[3:]), np.float32)
        found[inside] = self.values[tuple(index[inside].T)]
        return found


@dataclass(frozen=True)
class VolumeFrame:
    """The dense fields of one timeCode, ready for the core."""

    time_code: float
    density: DenseField
    density_to_stage: np.ndarray  # [4 4] density's *grid world* to stage space
    velocity: DenseField | None = None  # [i j k 3], stage-independent: grid-world units per second
    velocity_to_stage: np.ndarray | None = None
    # [i j k] as in the file: values are not clamped; outside the box it has its background.
    mask: DenseField | None = None
    mask_to_stage: np.ndarray | None = None  # [4 4] mask's grid world to stage space
    controls: FrameControls = FrameControls()
    camera: CameraSource | None = None
    lights: tuple[LightSource, ...] = ()


@dataclass(frozen=True)
class WrittenFrame:
    """One finished VDB file of the result."""

    time_code: float
    file_path: str  # absolute
    content_hash: str  # of all its grids, see ``vdb.content_hash``
    # Corners in the field prim's local space; None when empty.
    extent_min: tuple[float, float, float] | None
    extent_max: tuple[float, float, float] | None
