"""Files of a generator's parameters: safetensors, which hold no code; without torch."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from usdsmoke.base.errors import FeatureError
from usdsmoke.core.features.safetensors import read_safetensors, safetensors_bytes
from usdsmoke.core.generator.definition import (
    FORMAT,
    LEAST_OCTAVES,
    count_octaves,
    parameter_shapes,
)

_FORMAT, _DIGEST = "usdsmoke_generator", "sha256"  # of the format, and of the numbers
_ADVICE = "Train one with 'usdsmoke train', or leave optimize.start (--start) out."


def weights_bytes(arrays: Mapping[str, np.ndarray], notes: Mapping[str, str]) -> bytes:
    """The file of parameters by name; equal arguments give equal bytes.

    Args:
        notes: what they were trained on and what they reach.
    """
    return safetensors_bytes(arrays, {**notes, _FORMAT: FORMAT, _DIGEST: _digest(arrays)})


def read_weights(file_path: Path) -> dict[str, np.ndarray]:
    """The parameters in a generator's file, by name.

    Raises:
        FeatureError: it is missing, damaged, or no generator of this version.
    """
    return _read(file_path)[0]


def read_notes(file_path: Path) -> dict[str, str]:
    """The notes in a generator's file; raises as ``read_weights`` does."""
    return _read(file_path)[1]


def _read(file_path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    try:
        arrays, notes = read_safetensors(file_path)
    except OSError as error:
        reason = error.strerror or "the system refused"
        raise FeatureError(f"cannot read the network {file_path}: {reason}. {_ADVICE}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise FeatureError(
            f"cannot read the network {file_path}: it is not a complete safetensors file. {_ADVICE}"
        ) from None
    found = notes.get(_FORMAT)
    if found != FORMAT:
        what = "no network of usdsmoke" if found is None else f"a network of format {found}"
        raise FeatureError(f"{file_path} is {what}; this version reads format {FORMAT}. {_ADVICE}")
    shapes = {name: values.shape for name, values in arrays.items()}
    expected = parameter_shapes(max(LEAST_OCTAVES, count_octaves(arrays)))
    if shapes != expected or notes.get(_DIGEST) != _digest(arrays):
        raise FeatureError(
            f"the network {file_path} is damaged: its numbers are not those that were written. "
            f"{_ADVICE}"
        )
    return {name: arrays[name] for name in expected}, notes


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of the numbers in the order of the parameters' names."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(np.ascontiguousarray(arrays[name], "<f4").tobytes())
    return digest.hexdigest()
