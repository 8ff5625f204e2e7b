"""Which Volumes of a stage, at which timeCodes, and what their fields show then."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TypeAlias

from pxr import Usd, UsdGeom

from usdsmoke.base.errors import (
    AssetNotResolved,
    ConfigError,
    FieldNotFound,
    StageError,
    others_advice,
)
from usdsmoke.base.naming import VARIANT_SET
from usdsmoke.base.time_codes import (
    FrameRange,
    describe_gaps,
    format_time_code,
    format_time_codes,
    name_time_codes,
    parse_frames,
    select_frames,
)
from usdsmoke.base.volume import (
    FieldSource,
    FrameControls,
    FrameSource,
    StageSource,
    StyleRequest,
    VolumeSource,
)
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.usd.diagnostics import readable_values
from usdsmoke.usd.field_samples import FieldSamples
from usdsmoke.usd.materials import find_materials
from usdsmoke.usd.stage.choice import choose_volumes
from usdsmoke.usd.stage.dropped import dropped_opinions
from usdsmoke.usd.stage.fields import (
    VolumeFields,
    check_assets,
    check_places,
    field_source,
    find_fields,
    late_velocity,
)
from usdsmoke.usd.stage.opening import check_units
from usdsmoke.usd.stage.places import find_instancers, is_never_seen, place_notes
from usdsmoke.usd.values import selected_variants, vdb_problem
from usdsmoke.usd.volume_requests import read_request, requested_mask

_OF_ONE_VOLUME = (FieldNotFound, AssetNotResolved, StageError)
# An error without its traceback, which would keep the stage's layers in memory for long.
_Refusal: TypeAlias = tuple[type[StageError], str]
_HIDDEN = "it is invisible at all of its timeCodes. Name the Volume with --prim to use it."
_STATIC_TIME_CODE = 1.0  # of what is not animated, on a stage without a startTimeCode


@dataclass(frozen=True)
class _Outline:
    """A Volume with its fields and timeCodes, before any are selected."""

    prim: Usd.Prim
    fields: VolumeFields
    time_codes: tuple[float, ...]  # gaps included
    existing: tuple[float, ...]  # gaps left out
    animated: bool

    @property
    def path(self) -> str:
        """The prim's."""
        return str(self.prim.GetPath())


@readable_values()
def find_volumes(
    stage: Usd.Stage,
    config: StageConfig,
    with_requests: bool = True,
    with_styles: bool = True,
    problems: list[str] | None = None,
    copied: Sequence[str] = (),
    with_instances: bool = False,
) -> StageSource:
    """The Volumes to stylize, with every selected timeCode of their density, velocity and mask.

    A Volume's timeCodes are those at which its density's file or grid changes; other fields are
    held in between, as USD holds them. What is not animated has one frame, at the stage's
    startTimeCode; beside an animated Volume it is taken whatever timeCodes are asked for.

    Args:
        with_styles: whether to look for the images that they request; not where others are given.
        problems: gets a sentence for each Volume, field or timeCode that cannot be used and is left
            out; None raises an error instead.
        copied: ``layer.copy_fields``.
        with_instances: take Volumes inside instances too; they can be drawn, not changed.

    Raises:
        ConfigError: ``frames`` cannot be read, or a Volume asks for what there is not.
        VolumeNotFound: a named prim is missing or no Volume, or the stage has no Volume at all.
        FieldNotFound: a relationship of the density or mask, or its field prim, is missing.
        AssetNotResolved: a selected file cannot be read from disk, or the mask has none.
        StageError: a rate or unit of the stage is not positive, a Volume is an instance proxy, or a
            timeCode is asked for that does not exist and ``allow_missing`` is off.
    """
    check_units(stage)
    ranges = parse_frames(config.frames)
    prims, omitted = choose_volumes(stage, config.prims, with_instances)
    own = [_own_config(prim, config) if with_requests else config for prim in prims]
    outlines, errors = _outline_volumes(list(zip(prims, own, strict=True)), copied)
    if not outlines:
        _tell(errors, problems, ())
        raise StageError("; ".join(problems or ()))
    selections, missing = _select_time_codes(outlines, ranges, config)
    volumes = []
    for outline, selected in zip(outlines, selections, strict=True):
        is_open = outline.animated and outline.path not in config.prims
        if is_open and is_never_seen(outline.prim, outline.existing):
            omitted[outline.path] = _HIDDEN
            continue
        selected, absent = _with_files(outline, selected, config, problems, missing)
        if selected:
            try:
                found = _read_volume(outline, selected, with_requests, with_styles, problems)
                volumes.append(found)
            except _OF_ONE_VOLUME as error:
                errors.append((type(error), str(error)))
        elif problems is None or not absent:
            omitted[outline.path] = absent[0] if absent else _why_not_selected(outline, config)
    _tell(errors, problems, (volume.prim_path for volume in volumes))
    if not volumes:
        reasons = [f"<{path}>: {reason}" for path, reason in omitted.items()]
        raise _nothing_left([*missing, *reasons], problems)
    return _describe_stage(stage, tuple(volumes), omitted, tuple(missing))


def _with_files(
    outline: _Outline,
    selected: tuple[float, ...],
    config: StageConfig,
    problems: list[str] | None,
    missing: list[str],
) -> tuple[tuple[float, ...], list[str]]:
    """The timeCodes whose files are there, and sentences on others, which the lists get too."""
    absent = list[str]()
    if config.allow_missing or problems is not None:
        selected, absent = _split_by_file(outline, selected)
    if problems is not None and not (config.allow_missing and selected):
        problems += [f"{sentence}." for sentence in absent]
    elif selected:
        missing += absent
    return selected, absent


def _why_not_selected(outline: _Outline, config: StageConfig) -> str:
    """Why none of a Volume's timeCodes is taken; raises where the Volume was named."""
    codes = format_time_codes(outline.existing)
    if outline.path in config.prims:
        raise StageError(
            f"Volume <{outline.path}> (--prim) has timeCodes {codes}, none of them in "
            f"{config.frames!r}. Choose other frames, or drop it from --prim."
        )
    return f"none of its timeCodes {codes} is in {config.frames!r}"


def _nothing_left(missing: Sequence[str], problems: Sequence[str] | None) -> StageError:
    reasons = "; ".join(text.rstrip(".") for text in [*missing, *(problems or ())])
    if problems is not None:  # of a stage that is only looked at; they say what to do
        return StageError(f"no smoke can be read: {reasons}.")
    return StageError(f"nothing is left to do: {reasons}. Choose other frames or Volumes.")


def _outline_volumes(
    pairs: Sequence[tuple[Usd.Prim, StageConfig]], copied: Sequence[str]
) -> tuple[list[_Outline], list[_Refusal]]:
    """The Volumes that have a density, and the errors of the others."""
    outlines, errors = list[_Outline](), list[_Refusal]()
    for prim, config in pairs:
        try:
            outlines.append(_outline_volume(prim, config, copied))
        except _OF_ONE_VOLUME as error:
            errors.append((type(error), str(error)))
    return outlines, errors


def _tell(errors: Sequence[_Refusal], problems: list[str] | None, good: Iterable[str]) -> None:
    """Note the errors of some Volumes; or raise the first, with the way to leave these out.

    Args:
        good: paths of the Volumes that can be used.
    """
    if problems is not None:
        problems += [text for _, text in errors]
    elif errors:
        kind, text = errors[0]
        raise kind(f"{text}{others_advice(list(good))}")


def _describe_stage(
    stage: Usd.Stage,
    volumes: tuple[VolumeSource, ...],
    omitted: dict[str, str],
    missing: tuple[str, ...],
) -> StageSource:
    root = stage.GetRootLayer()
    return StageSource(
        file_path=root.realPath or root.identifier,
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        meters_per_unit=UsdGeom.GetStageMetersPerUnit(stage),
        time_codes_per_second=stage.GetTimeCodesPerSecond(),
        frames_per_second=stage.GetFramesPerSecond(),
        start_time_code=_authored_time(stage, "startTimeCode"),
        end_time_code=_authored_time(stage, "endTimeCode"),
        default_prim=root.defaultPrim,
        volumes=volumes,
        omitted=omitted,
        missing=missing,
        dropped=dropped_opinions(stage),
    )


def _authored_time(stage: Usd.Stage, key: str) -> float | None:
    if not stage.HasAuthoredMetadata(key):
        return None
    value = stage.GetMetadata(key)  # of any type: a text file may say startTimeCode = </A>
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise StageError(
            f"{key} of {stage.GetRootLayer().identifier} is {value!r}. Author a number in the "
            "layer's metadata."
        )
    return float(value)


def _own_config(prim: Usd.Prim, config: StageConfig) -> StageConfig:
    """The section ``stage`` with what a Volume asks for itself; of this section only the mask."""
    mask = "" if "mask" in config.model_fields_set else requested_mask(prim)
    return config.replace(mask=mask) if mask else config


def _outline_volume(prim: Usd.Prim, config: StageConfig, copied: Sequence[str]) -> _Outline:
    fields = find_fields(prim, config.density, config.velocity, config.mask, copied)
    density = fields.prims[fields.density]
    samples = FieldSamples(density)
    codes = samples.changes()
    animated = bool(codes)
    if not animated:
        start = _authored_time(prim.GetStage(), "startTimeCode")
        codes = [_STATIC_TIME_CODE if start is None else start]
    existing = tuple(code for code in codes if samples.at(code).has_path)
    if not existing:
        raise AssetNotResolved(
            f"the field <{density.GetPath()}> of Volume <{prim.GetPath()}> has no filePath at any "
            "timeCode. Author a default or time samples that name .vdb files."
        )
    return _Outline(prim, fields, tuple(codes), existing, animated)


def _select_time_codes(
    outlines: Sequence[_Outline], ranges: Sequence[FrameRange], config: StageConfig
) -> tuple[list[tuple[float, ...]], list[str]]:
    """The selected timeCodes of each Volume, and sentences on requested ones that are not there.

    A requested timeCode must exist on one Volume at least.
    """
    found = [select_frames(ranges, outline.existing) for outline in outlines]
    animated = [pair for pair, outline in zip(found, outlines, strict=True) if outline.animated]
    missing = set.intersection(*(set(codes) for _, codes in animated or found))
    selections = [
        selected if outline.animated else outline.existing
        for (selected, _), outline in zip(found, outlines, strict=True)
    ]
    any_selected = any(selected for selected, _ in animated or found)
    notes = _gaps(outlines, selections, ranges)
    if any_selected and not missing:
        return selections, notes
    there = "; ".join(
        f"<{outline.prim.GetPath()}> has {format_time_codes(outline.existing)}"
        + ("" if outline.animated else " and is not animated")
        for outline in outlines
    )
    nothing = len(missing) > 1 and not any_selected
    which = f"any timeCode in {config.frames!r}" if nothing else name_time_codes(missing)
    sentence = f"no density is authored at {which} ({there})"
    if any_selected and config.allow_missing:
        return selections, [
            f"some of {config.frames} do not exist ({there})",
            *notes,
        ]
    otherwise = ", or pass --allow-missing" if any_selected else ""
    raise StageError(f"{sentence}. Choose frames among these{otherwise}.")


def _gaps(
    outlines: Sequence[_Outline], selections: Sequence[Sequence[float]], parts: Sequence[FrameRange]
) -> list[str]:
    """A sentence for each range in which timeCodes seem to be missing."""
    return [
        f"<{outline.prim.GetPath()}> has {gaps}"
        for (outline, selected), part in product(zip(outlines, selections, strict=True), parts)
        if (gaps := describe_gaps(part, selected, outline.existing))
    ]


def _split_by_file(
    outline: _Outline, selected: Sequence[float]
) -> tuple[tuple[float, ...], list[str]]:
    """The timeCodes whose density file exists, and a sentence about the others."""
    density = outline.fields.prims[outline.fields.density]
    samples = FieldSamples(density)
    absent = [code for code in selected if not Path(samples.at(code).file_path or "/").is_file()]
    sentence = f"files of <{outline.prim.GetPath()}> are missing at {name_time_codes(absent)}"
    if absent:
        sample = samples.at(absent[0])
        path = density.GetAttribute("filePath")
        reason = vdb_problem(sample.authored_path, sample.file_path, path).rstrip(".")
        which = ", such as" if len(absent) > 1 else ":"
        sentence += f"{which} @{sample.authored_path}@: {reason}"
    return tuple(code for code in selected if code not in absent), [sentence] if absent else []


def _read_volume(
    outline: _Outline,
    selected: Sequence[float],
    with_requests: bool,
    with_styles: bool,
    problems: list[str] | None,
) -> VolumeSource:
    frames = []
    request, controls = StyleRequest(), (FrameControls(),) * len(selected)
    if with_requests:
        try:
            request, controls = read_request(outline.prim, selected, with_styles)
        except (ConfigError, StageError) as error:
            if problems is None:
                raise
            problems.append(str(error))  # the Volume itself can be used
    for time_code, control in zip(selected, controls, strict=True):
        xforms = UsdGeom.XformCache(time_code)
        found = {
            name: field_source(name, prim, time_code, xforms)
            for name, prim in outline.fields.prims.items()
        }
        fields = {name: source for name, source in found.items() if source is not None}
        _check_mask(outline, fields, time_code)
        frames.append(FrameSource(time_code, fields, control))
    for name, prim in outline.fields.prims.items():
        shown = [frame.fields[name] for frame in frames if name in frame.fields]
        check_assets(prim, shown)
        check_places(shown)
    every = [field for frame in frames for field in frame.fields.values()]
    return VolumeSource(
        prim_path=str(outline.prim.GetPath()),
        frames=tuple(frames),
        animated=outline.animated,
        time_codes=outline.time_codes,
        density=outline.fields.density,
        velocity=outline.fields.velocity,
        mask=outline.fields.mask,
        other_fields=outline.fields.others,
        copied=outline.fields.copied,
        request=request,
        materials=find_materials(outline.prim),
        variants=selected_variants(outline.prim, VARIANT_SET),
        notes=(
            *place_notes(outline.prim, every, find_instancers(outline.prim.GetStage())),
            *(late_velocity(outline.fields, selected) if outline.animated else ()),
        ),
    )


def _check_mask(outline: _Outline, fields: Mapping[str, FieldSource], time_code: float) -> None:
    """A requested mask must have a file wherever the density has one."""
    mask = outline.fields.mask
    if mask and mask not in fields:
        raise AssetNotResolved(
            f"the mask <{outline.fields.prims[mask].GetPath()}> of Volume "
            f"<{outline.prim.GetPath()}> has no filePath at timeCode "
            f"{format_time_code(time_code)}. Author a .vdb file wherever the density has one, "
            "or select other frames."
        )
