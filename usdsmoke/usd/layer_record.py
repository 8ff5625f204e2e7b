"""The record of a run in a look layer: written, read, and its digests.

``customLayerData["usdsmoke"]`` holds plain texts: ``tool``, ``version``, ``run``, ``look`` and
``stage`` for other programs, the whole record as JSON in ``record``, and two digests. The digests
detect accidents, not fraud: an edit can include new digests.
"""

import hashlib
import json
from typing import Any

from pxr import Sdf

from usdsmoke.base.errors import LayerError
from usdsmoke.base.record_format import RunRecord

RECORD_KEY = "usdsmoke"  # in customLayerData
LAYER_HASH = "layerHash"
RECORD_HASH = "recordHash"
_PLAIN = ("tool", "version", "run", "look", "stage")
_TEXT = "record"


def put_record(layer: Sdf.Layer, record: RunRecord) -> None:
    """Put the creator's name and a record into ``customLayerData``."""
    values = {name: getattr(record, name) for name in _PLAIN}
    layer.customLayerData = {
        "creator": f"{record.tool} {record.version}",
        RECORD_KEY: {**values, _TEXT: record.to_text()},
    }


def record_values(layer: Sdf.Layer) -> dict[str, str]:
    """The texts by name; empty for a layer without a record. The record itself is not read."""
    found = layer.customLayerData.get(RECORD_KEY)
    if not isinstance(found, dict) or "run" not in found:
        return {}
    return {name: str(value) for name, value in found.items()}


def read_record(layer: Sdf.Layer) -> RunRecord:
    """The record of a layer.

    Raises:
        LayerError: it has none, or one that cannot be read.
    """
    name = layer.realPath or layer.identifier
    values = record_values(layer)
    if not values:
        raise LayerError(f"{name} has no record of usdsmoke. Give a look layer.")
    return RunRecord.from_text(values.get(_TEXT, ""), name)


def layer_digest(layer: Sdf.Layer) -> str:
    """SHA-256 of what a layer has authored, 64 hexadecimal digits; the same as .usda and .usdc.

    ``customLayerData``, which holds the record and the data of other programs, and ``comment`` are
    left out: neither changes what is seen. The text is that of the USD release at hand. If another
    release exports the same layer as other text, the digest differs.
    """
    bare = Sdf.Layer.CreateAnonymous(".usda")
    bare.TransferContent(layer)
    for key in ("customLayerData", "comment"):
        bare.pseudoRoot.ClearInfo(key)
    return hashlib.sha256(bare.ExportToString().encode()).hexdigest()


def record_digest(layer: Sdf.Layer) -> str:
    """SHA-256 of a layer's record without its two digests, 64 hexadecimal digits."""
    values: dict[str, Any] = dict(layer.customLayerData.get(RECORD_KEY, {}))
    for key in (LAYER_HASH, RECORD_HASH):
        values.pop(key, None)
    text = json.dumps(values, sort_keys=True, ensure_ascii=False, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def add_digests(layer: Sdf.Layer) -> None:
    """Add both digests to the record of a layer; the last thing that is authored in it."""
    data = dict(layer.customLayerData)
    digests = {LAYER_HASH: layer_digest(layer), RECORD_HASH: record_digest(layer)}
    data[RECORD_KEY] = {**data[RECORD_KEY], **digests}
    layer.customLayerData = data
