"""What was run, left where programs look for it: on the Volume and in the layer.

The look's API schema carries what a renderer has to know, as attributes that survive flattening.
UsdMedia's authorship record says who made what from what in common words. ``customLayerData`` holds
the whole record of the run.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from pxr import Sdf, Vt

from usdsmoke.base.naming import relative_asset_path
from usdsmoke.base.record_format import SOFTWARE_PACKAGE, authorship_inputs, short_run_id
from usdsmoke.usd import schema
from usdsmoke.usd.look.records import StylizedVolume

__all__ = ["author_attributes", "custom_layer_data", "result_hashes"]

_TYPES = Sdf.ValueTypeNames
_DIGITAL_SOURCE = "http://cv.iptc.org/newscodes/digitalsourcetype/"


def author_attributes(
    volume_spec: Sdf.PrimSpec,
    volume: StylizedVolume,
    digital_source_type: str,
    provenance: Mapping[str, Any],
) -> None:
    """Apply UsdSmokeLookAPI and one authorship record, every value authored.

    The extinction has time samples besides its default where it changes in time.

    The record's instance name is new with every run: records add up down the namespace, and two of
    one name in different layers hide one another.

    Args:
        volume_spec: the Volume in the look.
        volume: the result.
        digital_source_type: IPTC's term.
        provenance: from ``build_provenance``.
    """
    instance = f"usdsmoke_{short_run_id(str(provenance['run']))}"
    volume_spec.SetInfo(
        "apiSchemas",
        Sdf.TokenListOp.Create(prependedItems=[schema.LOOK_API, f"AuthorshipAPI:{instance}"]),
    )
    styles = volume.styles
    if styles is None:
        styles = tuple(_name_and_hash(text) for text in provenance.get("styles", []))
    seed = provenance.get("seed", 0) if volume.seed is None else volume.seed
    look = {
        schema.EXTINCTION_PER_DENSITY: (_TYPES.Float, volume.extinction_per_density),
        schema.EMISSION_MODE: (_TYPES.Token, volume.emission_mode),
        schema.COLOR_SPACE: (_TYPES.Token, schema.LIN_REC709),
        schema.RUN: (_TYPES.String, str(provenance["run"])),
        schema.STYLE: (_TYPES.StringArray, Vt.StringArray(styles)),
        schema.SEED: (_TYPES.Int64, int(seed)),
    }
    for name, (type_name, value) in look.items():
        Sdf.AttributeSpec(volume_spec, name, type_name).default = value
    extinction = volume_spec.attributes[schema.EXTINCTION_PER_DENSITY].path
    for time_code, value in sorted(volume.extinction_samples.items()):
        volume_spec.layer.SetTimeSample(extinction, time_code, value)
    for name, text in _authorship(digital_source_type, provenance).items():
        is_list = isinstance(text, list)
        Sdf.AttributeSpec(
            volume_spec,
            f"authorship:{instance}:{name}",
            _TYPES.StringArray if is_list else _TYPES.String,
            Sdf.VariabilityUniform,
        ).default = Vt.StringArray(text) if is_list else text


def result_hashes(volumes: Sequence[StylizedVolume], folder: Any) -> list[str]:
    """``path=content hash`` of every written file, paths relative to the look's folder."""
    hashes = {frame.file_path: frame.content_hash for volume in volumes for frame in volume.frames}
    hashes |= {volume.empty_file: volume.empty_hash for volume in volumes if volume.empty_hash}
    return [f"{relative_asset_path(path, folder)}={digest}" for path, digest in hashes.items()]


def custom_layer_data(provenance: Mapping[str, Any], results: Sequence[str]) -> dict[str, Any]:
    """The layer's ``customLayerData``: the creator's name and the flat record of the run."""
    record = {**provenance, "results": list(results)}
    return {
        "creator": f"{provenance.get('tool', 'usdsmoke')} {provenance.get('version', '')}".strip(),
        "usdsmoke": {
            key: Vt.StringArray([str(item) for item in value])
            if isinstance(value, (list, tuple))
            else value
            for key, value in record.items()
        },
    }


def _authorship(digital_source_type: str, provenance: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "softwarePackage": SOFTWARE_PACKAGE,
        "softwareVersion": str(provenance.get("version", "")),
        "digitalSourceType": _DIGITAL_SOURCE + digital_source_type,
        "description": "Smoke stylized from an example image: density and emission.",
        "inputs": authorship_inputs(provenance),
        "created": str(provenance.get("created", "")),
        "instanceID": str(provenance["run"]),
    }


def _name_and_hash(text: str) -> str:
    """``name=hash`` as the schema spells it: name, a space, hash."""
    name, _, digest = text.rpartition("=")
    return f"{name} {digest}"
