"""What a look says on the Volume about the run: attributes that survive flattening.

The look's API schema has what a renderer needs to know. UsdMedia's authorship says who made what
from what. The whole record is in the layer, see ``usd.layer_record``.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd, Vt

from usdsmoke.base.naming import relative_asset_path
from usdsmoke.base.record_format import SOFTWARE_PACKAGE, RunRecord, short_run_id
from usdsmoke.usd import schema
from usdsmoke.usd.look.records import StylizedVolume
from usdsmoke.usd.units import stage_units_over_time

_TYPES = Sdf.ValueTypeNames
_DIGITAL_SOURCE = "http://cv.iptc.org/newscodes/digitalsourcetype/"


def author_attributes(
    volume_spec: Sdf.PrimSpec,
    prim: Usd.Prim,
    volume: StylizedVolume,
    digital_source_type: str,
    record: RunRecord,
) -> None:
    """Apply UsdSmokeLookAPI and one authorship record, every value authored.

    Extinction and scale have time samples besides their defaults where they change over time. The
    instance name of the authorship is new with every run: authorships add up down the namespace,
    and two of one name in different layers hide one another.
    """
    instance = f"usdsmoke_{short_run_id(record.run)}"
    volume_spec.SetInfo(
        "apiSchemas",
        Sdf.TokenListOp.Create(prependedItems=[schema.LOOK_API, f"AuthorshipAPI:{instance}"]),
    )
    styles = volume.styles
    if styles is None:
        styles = tuple(f"{style.name} {style.sha256}" for style in record.styles)
    codes = volume.source.time_codes if volume.source.animated else ()
    units, unit_samples = stage_units_over_time(prim, volume.first_frame.time_code, codes)
    look = {
        schema.EXTINCTION_PER_DENSITY: (_TYPES.Float, volume.extinction_per_density),
        schema.STAGE_UNITS: (_TYPES.Float, units),
        schema.EMISSION_MODE: (_TYPES.Token, volume.emission_mode),
        schema.COLOR_SPACE: (_TYPES.Token, schema.LIN_REC709),
        schema.RUN: (_TYPES.String, record.run),
        schema.STYLE: (_TYPES.StringArray, Vt.StringArray(styles)),
        schema.SEED: (_TYPES.Int64, record.seed if volume.seed is None else volume.seed),
    }
    look |= _light_attributes(volume)
    for name, (type_name, value) in look.items():
        Sdf.AttributeSpec(volume_spec, name, type_name).default = value
    for name, samples in (
        (schema.EXTINCTION_PER_DENSITY, volume.extinction_samples),
        (schema.STAGE_UNITS, unit_samples),
    ):
        path = volume_spec.attributes[name].path
        for time_code, value in sorted(samples.items()):
            volume_spec.layer.SetTimeSample(path, time_code, value)
    for name, text in _authorship(digital_source_type, record).items():
        is_list = isinstance(text, list)
        Sdf.AttributeSpec(
            volume_spec,
            f"authorship:{instance}:{name}",
            _TYPES.StringArray if is_list else _TYPES.String,
            Sdf.VariabilityUniform,
        ).default = Vt.StringArray(text) if is_list else text


def _light_attributes(volume: StylizedVolume) -> dict[str, Any]:
    """What a look for lights says; empty for one that scatters none."""
    look: dict[str, Any] = {}
    if volume.albedo:
        look[schema.ALBEDO] = (_TYPES.Float, volume.albedo)
        look[schema.ANISOTROPY] = (_TYPES.Float, volume.anisotropy)
    if volume.bounces:
        look[schema.BOUNCES] = (_TYPES.Bool, True)
    if volume.named_lights:
        triples = [
            part
            for light in volume.named_lights
            for part in (light.towards or (0.0, 0.0, 0.0), light.colour)
        ]
        look[schema.LIGHTS] = (_TYPES.Float3Array, Vt.Vec3fArray(triples))
    if volume.scatter_field:
        look[schema.SCATTER_FIELD] = (_TYPES.Token, volume.scatter_field)
    if volume.stops:
        look[schema.EXPOSURE] = (_TYPES.Float, volume.stops)
    return look


def result_hashes(volumes: Sequence[StylizedVolume], folder: Path) -> dict[str, str]:
    """Content hash of every written file, by its path relative to the look's folder."""
    hashes = {frame.file_path: frame.content_hash for volume in volumes for frame in volume.frames}
    hashes |= {volume.empty_file: volume.empty_hash for volume in volumes if volume.empty_hash}
    return {relative_asset_path(path, folder): digest for path, digest in hashes.items()}


def _authorship(digital_source_type: str, record: RunRecord) -> Mapping[str, Any]:
    return {
        "softwarePackage": SOFTWARE_PACKAGE,
        "softwareVersion": record.version,
        "digitalSourceType": _DIGITAL_SOURCE + digital_source_type,
        "description": "Smoke stylized from an example image: density and emission.",
        "inputs": _authorship_inputs(record),
        "created": record.created,
        "instanceID": record.run,
    }


def _authorship_inputs(record: RunRecord) -> list[str]:
    """Name, value, name, value, ...; the source grids as their number and one digest."""
    grids = {(g.file, g.grid): g.hash for frame in record.frames for g in frame.sources}
    listed = "\n".join(f"{file} {grid}={grids[file, grid]}" for file, grid in sorted(grids))
    digest = hashlib.sha256(listed.encode()).hexdigest()
    pairs = [("style", f"{style.name} {style.sha256}") for style in record.styles]
    pairs += [
        ("sources", f"{len(grids)} grids, sha256 of their list {digest}"),
        ("features", f"{record.features} {record.features_hash}".strip()),
        ("seed", str(record.seed)),
    ]
    return [text for pair in pairs for text in pair]
