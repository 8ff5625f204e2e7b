"""What a run was: which tool, on what, with which settings, and what came of it.

The record is one flat dictionary of whole numbers, texts and lists of texts, because it is stored
in a layer's ``customLayerData``, where nested values do not survive every exporter: what is nested
stands there as JSON text. Keys are only ever added; ``schemaVersion`` rises when the meaning of one
changes. It names files without their folders, except relative to the layer where that is what it
takes to find them again, and nothing of the person or the machine. docs/provenance.md explains
every key.
"""

import hashlib
import json
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path, PurePath
from typing import Any, BinaryIO

from usdsmoke.base.errors import FileUnreadable

__all__ = [
    "SCHEMA_VERSION",
    "SOFTWARE_PACKAGE",
    "Provenance",
    "RunFacts",
    "authorship_inputs",
    "build_provenance",
    "hash_file",
    "hash_stream",
    "new_run_id",
    "short_run_id",
    "utc_now",
]

SCHEMA_VERSION = 1
SOFTWARE_PACKAGE = "org.usdsmoke.usdsmoke"  # reverse-domain, as UsdMedia's authorship asks for

Provenance = dict[str, int | str | list[str]]


@dataclass(frozen=True)
class RunFacts:
    """The plain values that a provenance record is built from."""

    version: str  # of usdsmoke
    seed: int
    config: Mapping[str, Any]  # the resolved settings, all sections
    inputs: Mapping[str, str] = field(default_factory=dict)  # file: content hash
    styles: Mapping[str, str] = field(default_factory=dict)  # image file: SHA-256
    features: str = ""  # name of the feature network
    features_hash: str = ""
    packages: Mapping[str, str] = field(default_factory=dict)  # usd, torch, ...: version
    timings: Mapping[str, float] = field(default_factory=dict)  # step: seconds
    extinction: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # Volume: see below
    temporal_error: Mapping[str, float] = field(default_factory=dict)  # by kind, mean of all frames
    overlap_difference: Mapping[str, float] = field(default_factory=dict)  # by grid, likewise
    omissions: Sequence[str] = ()  # what was left out and why, a sentence each
    run_id: str = ""  # a UUID; empty makes a new one
    created: str = ""  # ISO 8601 in UTC; empty takes the time of the call
    finished: str = ""  # likewise, when the layer was made; empty takes the time of the call
    platform: str = ""  # system and processor family
    machine: Sequence[str] = ()  # texts name=value: threads, device, processor; see docs
    figures: Mapping[str, Any] = field(default_factory=dict)  # by name; their texts are recorded
    error_budget: Sequence[str] = ()  # texts name=figures, see ``error_budget``
    stage_values: Mapping[str, str] = field(default_factory=dict)  # what the stage said, by name
    # What it takes to run again; files relative to the layer.
    request: Mapping[str, Any] = field(default_factory=dict)
    input_state: Mapping[str, Any] = field(default_factory=dict)  # digests of what was read
    style_files: Mapping[str, str] = field(default_factory=dict)  # image file: SHA-256
    frames: Sequence[Mapping[str, Any]] = ()  # of the result: file, Volume, timeCode, sources


def new_run_id() -> str:
    """A random UUID that no other run has."""
    return str(uuid.uuid4())


def short_run_id(run_id: str) -> str:
    """Eight letters and digits of a run's UUID, fit for a USD name.

    >>> short_run_id("3f2b8c1e-0a4d-4c57-9d0e-5b7a1f6c2d34")
    '3f2b8c1e'
    """
    return "".join(letter for letter in run_id if letter.isalnum())[:8]


def utc_now() -> str:
    """The time in UTC to the second, ISO 8601: 2026-01-31T12:00:00Z."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def hash_file(file_path: str | Path) -> str:
    """SHA-256 of a file's bytes as 64 hexadecimal digits.

    It tells whether a file is still the one that was read or written. Two VDB files of the same
    grids differ, because each holds a random identifier; ``grids.content_hash`` compares those.

    Raises:
        FileUnreadable: the file cannot be read.
    """
    try:
        with open(file_path, "rb") as stream:
            return hash_stream(stream)
    except OSError as error:
        raise FileUnreadable(
            f"cannot read {file_path} to take its hash: {error.strerror or error}; "
            "check the path and its permissions"
        ) from None


def hash_stream(stream: BinaryIO) -> str:
    """SHA-256 of the rest of an open file as 64 hexadecimal digits."""
    digest = hashlib.sha256()
    while block := stream.read(1 << 20):
        digest.update(block)
    return digest.hexdigest()


def build_provenance(facts: RunFacts) -> Provenance:
    """The flat record of a run; equal facts with a run id and a time give equal records.

    Extinction is that of the two steps, per density, in 1/stage unit, as it was fitted or set.
    The temporal error is the difference of a frame from its neighbour carried along, relative to
    the frame; the overlap's that between two windows' versions of a frame before they are blended.
    Pairs such as a file and its hash are texts ``name=value``, sorted by name where their order
    means nothing.
    """
    return {
        "schemaVersion": SCHEMA_VERSION,
        "tool": "usdsmoke",
        "version": facts.version,
        "run": facts.run_id or new_run_id(),
        "created": facts.created or utc_now(),
        "seed": facts.seed,
        "config": _as_json(facts.config),
        "inputs": sorted(_file_pairs(facts.inputs)),
        "styles": _file_pairs(facts.styles),
        "features": facts.features,
        "featuresHash": facts.features_hash,
        "packages": [f"{name}={facts.packages[name]}" for name in sorted(facts.packages)],
        "timings": [f"{step}={seconds:.3f}" for step, seconds in facts.timings.items()],
        "extinction": [
            f"{path}=colour {colour:.9g}, shape {shape:.9g}"
            for path, (colour, shape) in facts.extinction.items()
        ],
        "temporalError": [f"{kind}={value:.6g}" for kind, value in facts.temporal_error.items()],
        "overlapDifference": [
            f"{grid}={value:.6g}" for grid, value in facts.overlap_difference.items()
        ],
        "omitted": list(facts.omissions),
        "finished": facts.finished or utc_now(),
        "platform": facts.platform,
        "machine": list(facts.machine),
        "figures": [f"{name}={figure}" for name, figure in facts.figures.items()],
        "errorBudget": list(facts.error_budget),
        "stageValues": [f"{name}={value}" for name, value in facts.stage_values.items()],
        "request": _as_json(facts.request),
        "inputState": _as_json(facts.input_state),
        "styleFiles": [f"{file_path}={digest}" for file_path, digest in facts.style_files.items()],
        "frames": [_as_json(frame) for frame in facts.frames],
    }


def authorship_inputs(provenance: Mapping[str, Any]) -> list[str]:
    """The ``inputs`` of a UsdMedia authorship record: name, value, name, value, ...

    Long lists of source files become their number and one digest over all of them.
    """
    sources = list(provenance.get("inputs", []))
    digest = hashlib.sha256("\n".join(sources).encode()).hexdigest()
    pairs = [("style", text) for text in provenance.get("styles", [])]
    pairs += [
        ("sources", f"{len(sources)} files, sha256 of their list {digest}"),
        ("features", f"{provenance.get('features', '')} {provenance.get('featuresHash', '')}"),
        ("seed", str(provenance.get("seed", ""))),
        ("config", str(provenance.get("config", ""))),
    ]
    pairs += [("package", text) for text in provenance.get("packages", [])]
    pairs += [("seconds", text) for text in provenance.get("timings", [])]
    pairs += [("figure", text) for text in provenance.get("figures", [])]
    return [text.strip() for pair in pairs for text in pair]


def _as_json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, ensure_ascii=False)


def _file_pairs(files: Mapping[str, str]) -> list[str]:
    return [f"{PurePath(file_path).name}={digest}" for file_path, digest in files.items()]
