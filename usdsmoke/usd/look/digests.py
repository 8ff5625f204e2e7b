"""Digests by which a look layer tells that it was edited after it was written.

They protect from accidents, not from malice: whoever edits a layer can write new digests too.
"""

import hashlib
import json
from typing import Any

from pxr import Sdf

__all__ = [
    "LAYER_HASH",
    "RECORD_HASH",
    "RECORD_KEY",
    "add_digests",
    "layer_digest",
    "record_digest",
]

RECORD_KEY = "usdsmoke"  # in customLayerData
LAYER_HASH = "layerHash"
RECORD_HASH = "recordHash"


def layer_digest(layer: Sdf.Layer) -> str:
    """SHA-256 of what a layer has authored, 64 hexadecimal digits; the same as .usda and .usdc.

    ``customLayerData``, which holds the record and what other programs leave behind, and
    ``comment`` do not count: neither changes what is seen. The text is that of the USD release at
    hand; should another one export the same layer in other words, the digest differs.
    """
    bare = Sdf.Layer.CreateAnonymous(".usda")
    bare.TransferContent(layer)
    for key in ("customLayerData", "comment"):
        bare.pseudoRoot.ClearInfo(key)
    return hashlib.sha256(bare.ExportToString().encode()).hexdigest()


def record_digest(layer: Sdf.Layer) -> str:
    """SHA-256 of a layer's record without its two digests, 64 hexadecimal digits."""
    record = layer.customLayerData.get(RECORD_KEY, {})
    kept = {
        key: _plain(value) for key, value in record.items() if key not in (LAYER_HASH, RECORD_HASH)
    }
    text = json.dumps(kept, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def add_digests(layer: Sdf.Layer) -> None:
    """Add both digests to the record of a layer; the last thing that is authored in it.

    Args:
        layer: with a record in ``customLayerData``.
    """
    data = dict(layer.customLayerData)
    digests = {LAYER_HASH: layer_digest(layer), RECORD_HASH: record_digest(layer)}
    data[RECORD_KEY] = {**data[RECORD_KEY], **digests}
    layer.customLayerData = data


def _plain(value: Any) -> Any:
    if isinstance(value, (str, int, float)):
        return value
    return [str(item) for item in value]
