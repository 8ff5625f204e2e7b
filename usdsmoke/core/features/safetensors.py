"""Arrays of numbers in safetensors files, which hold no code; without torch.

A file is a length of 8 bytes, a JSON table of so many bytes, and raw little-endian numbers. The
table has dtype, shape and place of each array by name, and texts under ``__metadata__``.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from usdsmoke.base.json_records import read_json

_KINDS = {"F32": np.float32, "F16": np.float16, "F64": np.float64}
_NOTES = "__metadata__"


def read_safetensors(file_path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The arrays as float32, by name, and the texts.

    Raises:
        OSError: the file cannot be read.
        ValueError, KeyError, TypeError, AttributeError: it is not a safetensors file of floats.
    """
    data = file_path.read_bytes()
    length = int.from_bytes(data[:8], "little")
    if not 2 <= length <= len(data) - 8:
        raise ValueError(f"the table claims {length} bytes of {len(data)}")
    table = read_json(data[8 : 8 + length])
    notes = {str(name): str(text) for name, text in table.pop(_NOTES, {}).items()}
    found = {}
    for name, entry in table.items():
        begin, end = entry["data_offsets"]
        raw = np.frombuffer(data[8 + length + begin : 8 + length + end], _KINDS[entry["dtype"]])
        found[name] = raw.reshape(entry["shape"]).astype(np.float32)
    return found, notes


def safetensors_bytes(arrays: Mapping[str, np.ndarray], notes: Mapping[str, str]) -> bytes:
    """A file of float32 arrays and texts; equal arguments give equal bytes."""
    table: dict[str, object] = {_NOTES: dict(notes)}
    parts, place = [], 0
    for name, values in arrays.items():
        part = np.ascontiguousarray(values, "<f4").tobytes()
        table[name] = {
            "dtype": "F32",
            "shape": list(values.shape),
            "data_offsets": [place, place + len(part)],
        }
        parts.append(part)
        place += len(part)
    head = json.dumps(table, separators=(",", ":")).encode()
    head += b" " * (-len(head) % 8)  # numbers begin at a multiple of their size
    return len(head).to_bytes(8, "little") + head + b"".join(parts)
