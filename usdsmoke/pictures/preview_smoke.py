"""The smoke of a preview: which Volumes, which fields, how opaque, where."""

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from pxr import Usd

from usdsmoke.base.errors import (
    PlanError,
    UsdSmokeError,
)
from usdsmoke.base.machine import GIB, available_memory_gib
from usdsmoke.base.time_codes import format_time_code, name_time_codes, spread
from usdsmoke.base.volume import (
    DenseField,
    FieldSource,
    FrameSource,
    StageSource,
    VolumeFrame,
    VolumeSource,
)
from usdsmoke.config.settings import Config
from usdsmoke.core.rays.media import Medium, make_media
from usdsmoke.core.smoke.tasks import computing_threads, n_sharing
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.scene import Scene, measure_scene
from usdsmoke.pictures.drawing import GREY, box_corners
from usdsmoke.pictures.preview_grids import (
    field_box,
    grid_of,
    grid_request,
    is_filled,
    read_density,
    share_lattice,
)
from usdsmoke.usd.schema import EMISSION_PER_DENSITY
from usdsmoke.usd.stage import ComposedVolume, composed_volumes
from usdsmoke.vdb.colour_grids import absolute_emission
from usdsmoke.vdb.read import read_grids

_BASE_GIB = 0.5  # of a process that draws; measured
_BYTES = 60  # a voxel of the boxes, density and emission; measured


@dataclass
class Smoke:
    """The Volumes of a stage, ready to be drawn; keeps what it has measured, and notes."""

    stage: Usd.Stage
    selected: StageSource  # the requested frames
    whole: StageSource  # all frames, so that no result depends on which are requested
    config: Config = field(default_factory=Config)
    extinctions: dict[str, float] = field(default_factory=dict)  # used last, by Volume
    notes: dict[str, None] = field(default_factory=dict)  # in the order in which they came
    passed_over: tuple[type[UsdSmokeError], ...] = ()  # errors that leave a Volume out of a frame
    without_file: tuple[float, ...] = ()  # requested, and some Volume lacks its file
    # why, by Volume and time
    _unread: dict[str, dict[float, UsdSmokeError]] = field(default_factory=dict)
    _scenes: dict[str, Scene] = field(default_factory=dict)
    _drawn: dict[tuple[object, ...], DenseField] = field(default_factory=dict)  # read last

    @property
    def time_codes(self) -> list[float]:
        """All timeCodes that were selected, of any animated Volume; of a static stage its one."""
        if any(volume.animated for volume in self.selected.volumes) or not self.without_file:
            return sorted({*drawn_codes(self.selected), *self.without_file})
        return list(self.without_file)

    @property
    def left_out(self) -> list[str]:
        """A sentence for each Volume that could not be read in some frames."""
        sentences = []
        for path, reasons in self._unread.items():
            reasons = {code: why for code, why in reasons.items() if code not in self._told(path)}
            if not reasons:
                continue
            first = next(iter(reasons.values()))
            sentences.append(f"left out: <{path}> at {name_time_codes(sorted(reasons))}: {first}")
        return sentences

    def readable(self, time_codes: Sequence[float], needs_all: bool = False) -> list[float]:
        """The timeCodes without those at which every Volume in sight is left out.

        Args:
            needs_all: whether each of them has to be readable, instead of one of them.

        Raises:
            StageError, GridError: a field cannot be used and is not passed over; or none is left.
        """
        if not self.passed_over:
            return list(time_codes)
        found = [code for code in time_codes if self.shown(code) or not self._unread_at(code)]
        if not found or (needs_all and len(found) < len(time_codes)):
            self.passed_over = ()
            for code in time_codes:
                self.shown(code)  # raises
        return found

    def shown(self, time_code: float) -> list[ComposedVolume]:
        """What there is at a timeCode, from headers alone.

        Raises:
            StageError, GridError: a field cannot be used and is not passed over.
        """
        found = []
        for volume in self.selected.volumes:
            try:
                shown = compose_one(self.stage, self.selected, volume, time_code)
                found += [self._with_light(item) for item in shown]
            except self.passed_over as error:
                self._pass_over(volume.prim_path, time_code, error)
        return found

    def coloured(self, time_codes: Sequence[float]) -> list[float]:
        """The timeCodes at which a Volume has emission or colour; all of them where none has."""
        return [code for code in time_codes if self._has_colour(code)] or list(time_codes)

    def note_colourless(self, time_codes: Sequence[float]) -> None:
        """Note which of these are drawn grey, where emission or colour is authored."""
        grey = [code for code in time_codes if not self._has_colour(code)]
        fields = (
            f for code in grey for item in self.shown(code) for f in (item.emission, item.colour)
        )
        if any(field is not None for field in fields):
            codes = name_time_codes(grey)
            self.notes[f"grey at {codes}: the emission or colour there is empty"] = None

    def _has_colour(self, time_code: float) -> bool:
        sources = [
            field for item in self.shown(time_code) for field in (item.emission, item.colour)
        ]
        return any(field is not None and is_filled(field, None) for field in sources)

    def _pass_over(self, prim_path: str, time_code: float, error: UsdSmokeError) -> None:
        self._unread.setdefault(prim_path, {})[time_code] = error

    def refuse_blank(self, time_codes: Collection[float]) -> None:
        """Raise why a Volume was left out at these, if one was: nothing else was there to draw.

        Raises:
            StageError, GridError: the first reason.
        """
        reasons = (item for found in self._unread.values() for item in found.items())
        error = next((error for code, error in reasons if code in time_codes), None)
        if error is not None:
            raise error

    def _told(self, prim_path: str) -> set[float]:
        """The timeCodes whose density has no file: ``find_volumes`` names them."""
        volume = next(item for item in self.selected.volumes if item.prim_path == prim_path)
        return set(volume.time_codes) - {frame.time_code for frame in volume.frames}

    def _unread_at(self, time_code: float) -> bool:
        return any(time_code in reasons for reasons in self._unread.values())

    def check_memory(self, time_code: float) -> None:
        """Refuse a frame that does not fit the machine, from headers alone.

        Raises:
            PlanError: with what is needed and what there is.
        """
        shapes = [grid_of(volume.density, 1).box_shape for volume in self.shown(time_code)]
        n_voxels = sum(math.prod(shape) for shape in shapes if shape is not None)
        needed, there = _BASE_GIB + n_voxels * _BYTES / GIB, available_memory_gib()
        if needed > there:
            raise PlanError(
                f"drawing timeCode {format_time_code(time_code)} needs about {needed:.1f} GiB of "
                f"memory for {n_voxels:,} voxels; only {there:.1f} GiB is available. Draw "
                "fewer Volumes (--prim), or use a larger machine."
            )

    def points(self, time_codes: Iterable[float]) -> np.ndarray:
        """Corners of the boxes of smoke in all frames, selected or not, [N 3], stage space.

        Args:
            time_codes: those that will be drawn; a file whose header does not tell its box is
                opened for these alone.

        Raises:
            StageError, GridError: a field of these cannot be used; others are passed over then.
        """
        drawn = set(time_codes)
        corners = []
        times = sorted(drawn | set(drawn_codes(self.whole)))
        for time_code, volume in product(times, self.whole.volumes):
            try:
                corners += self._corners(volume, time_code, time_code in drawn)
            except UsdSmokeError as error:
                if time_code in drawn and not isinstance(error, self.passed_over):
                    raise
        return np.concatenate(corners) if corners else np.zeros((0, 3))

    def media(
        self, shown: Iterable[ComposedVolume], view: View, exposed: bool = False
    ) -> list[Medium]:
        """The smoke of some Volumes as media for ray marching.

        Args:
            shown: from ``shown``.
            view: matters where smoke scatters light unevenly (``is_uneven``).
            exposed: each look at the exposure that it was made for; else scene-linear.

        Raises:
            GridError, NonFiniteError: a grid cannot be used.
            ShapeError: a field is flattened on the stage.
        """
        media = []
        for volume in shown:
            try:
                density, light, colour = self.fields(volume)
            except self.passed_over as error:
                self._pass_over(volume.prim_path, volume.density.time_code, error)
                continue
            light = None if light is None else self._absolute(volume, density, light)
            if density.is_empty:
                continue
            if light is not None and volume.rescale != 1:
                light = replace(light, values=light.values * np.float32(volume.rescale))
            shines = any(f is not None and bool(f.values.any()) for f in (light, colour))
            gamma_w = self._extinction(volume, shines)
            if volume.scattering is not None and (light is not None or colour is not None):
                light = self._with_scattered(volume, density, (light, colour), gamma_w, view)
                shines = True
            if light is not None and exposed and volume.stops:
                light = replace(light, values=light.values * np.float32(2.0**volume.stops))
            source = volume.emission or volume.density
            place = source.field_to_stage
            media += make_media(
                density,
                light if shines else None,
                volume.density.field_to_stage,
                place if shines and light is not None else None,
                gamma_w,
                GREY,
            )
        return media

    def _with_light(self, volume: ComposedVolume) -> ComposedVolume:
        """Without an emission or a scattering colour that is none; density has to be usable."""
        grid_of(volume.density, 1)
        found: dict[str, Any] = {}
        for name in ("emission", "colour"):
            source: FieldSource | None = getattr(volume, name)
            if source is None or (grid := grid_of(source, None)).value_type == "vec3s":
                continue
            self.notes[
                f"the {name} of <{volume.prim_path}> holds {grid.value_type} values and no "
                "colours. It is left out."
            ] = None
            found[name] = None
        return replace(volume, **found)

    def fields(
        self, volume: ComposedVolume
    ) -> tuple[DenseField, DenseField | None, DenseField | None]:
        """Density, emission, and scattering colour; each file is read once."""
        sources = {"density": volume.density, "emission": volume.emission, "colour": volume.colour}
        found: dict[str, DenseField] = {}
        for file_path in {source.file_path for source in sources.values() if source is not None}:
            wanted = {
                name: grid_request(source, 1 if name == "density" else 3)
                for name, source in sources.items()
                if source is not None and source.file_path == file_path
            }
            fields = read_grids(file_path, list(wanted.values()), self.config.grids)
            found |= dict(zip(wanted, fields, strict=True))
        self._drawn = {_grid_key(volume.density): found["density"]}
        return found["density"], found.get("emission"), found.get("colour")

    def _absolute(
        self, volume: ComposedVolume, density: DenseField, light: DenseField
    ) -> DenseField | None:
        """Absolute emission; the file may store it divided by the density."""
        if volume.emission is None or volume.emission_mode != EMISSION_PER_DENSITY:
            return light
        if share_lattice(volume, density, light, volume.emission):
            return absolute_emission(density, light, volume.emission_mode)
        self.notes[
            f"the emission of <{volume.prim_path}> is stored per density and has other voxels than "
            "the density. It is left out."
        ] = None
        return None

    def _with_scattered(
        self,
        volume: ComposedVolume,
        density: DenseField,
        fields: tuple[DenseField | None, DenseField | None],
        gamma_w: float,
        view: View,
    ) -> DenseField | None:
        """The emission, and the light of lamps that a look's smoke scatters."""
        from usdsmoke.core.views.lighting import lit_emission

        if volume.scattering is None:
            return fields[0]
        sources = (volume.emission, volume.colour)
        for item, source in zip(fields, sources, strict=True):
            if item is not None and not share_lattice(volume, density, item, source):
                self.notes[
                    f"{item.name} of <{volume.prim_path}> has other voxels than the density. "
                    "Light that the smoke scatters is left out."
                ] = None
                return fields[0]
        place = volume.density.field_to_stage
        with computing_threads(n_sharing()):  # of torch, which is loaded by now
            return lit_emission(density, fields, place, gamma_w, volume.scattering, view)

    def _extinction(self, volume: ComposedVolume, lit: bool) -> float:
        """From the look, or else as a run would choose it for the shot."""
        gamma_w = volume.extinction
        if gamma_w is None:
            scene = self._scene(volume.prim_path)
            gamma_w = scene.gamma_w if lit else scene.gamma_w_shape
        self.extinctions[volume.prim_path] = gamma_w
        return gamma_w

    def _scene(self, prim_path: str) -> Scene:
        if prim_path not in self._scenes:
            volume = next(item for item in self.whole.volumes if item.prim_path == prim_path)
            filled = [f for f in volume.frames if is_filled(f.fields[volume.density], 1)]
            self._scenes[prim_path] = measure_scene(
                [self._frame(volume, frame) for frame in spread(filled)],
                self.config.views,
                self.config.optics.replace(thicken=1.0),
                self.whole.up_axis,
                self.config.grids.parts,
            )
        return self._scenes[prim_path]

    def _frame(self, volume: VolumeSource, frame: FrameSource) -> VolumeFrame:
        """The density of a frame, which is not read again if it is the one that is drawn."""
        source = frame.fields[volume.density]
        key = _grid_key(source)
        if key not in self._drawn:
            return read_density(frame.time_code, source, self.config)
        return VolumeFrame(frame.time_code, self._drawn[key], source.field_to_stage)

    def _corners(self, volume: VolumeSource, time_code: float, may_read: bool) -> list[np.ndarray]:
        """Of a Volume's box at one timeCode, [8 3]."""
        shown = compose_one(self.stage, self.whole, volume, time_code)
        boxes = [field_box(item.density, self.config if may_read else None) for item in shown]
        return [box_corners(*box) for box in boxes if box is not None]


def is_uneven(shown: Iterable[ComposedVolume]) -> bool:
    """Whether some smoke looks different from another side, apart from what hides what."""
    return any(volume.scattering is not None and volume.scattering.is_uneven for volume in shown)


def _grid_key(source: FieldSource) -> tuple[object, ...]:
    return source.file_path, source.grid_name, source.grid_index


def compose_one(
    stage: Usd.Stage, source: StageSource, volume: VolumeSource, time_code: float
) -> list[ComposedVolume]:
    """What one Volume shows: the faults of the others are not met."""
    return composed_volumes(stage, replace(source, volumes=(volume,)), time_code)


def drawn_codes(source: StageSource) -> list[float]:
    """Those of the animated Volumes; of a static stage its one."""
    animated = [volume for volume in source.volumes if volume.animated]
    return sorted(
        {frame.time_code for volume in animated or source.volumes for frame in volume.frames}
    )
