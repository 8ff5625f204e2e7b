"""The record of a run: which tool made what, from what, with which settings.

It is one JSON document. The look layer holds it as a text in ``customLayerData["usdsmoke"]``, and
the run's folder as ``provenance.json``. It names files relative to the folder of the look layer,
and nothing of the person or the machine. docs/provenance.md explains the fields.
"""

import hashlib
import json
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, BinaryIO

from usdsmoke.base.errors import FileUnreadable, LayerError
from usdsmoke.base.json_records import JsonRecord, read_json

RECORD_FORMAT = 1  # rises when a field changes its meaning
RECORD_FILE = "provenance.json"  # in the folder of a run
SHOWN_DIGITS = 12  # of a hash, for people to compare
SOFTWARE_PACKAGE = "org.usdsmoke.usdsmoke"  # reverse-domain, as UsdMedia's authorship asks for


@dataclass(frozen=True)
class SourceGrid:
    """A field of a frame's source, with the grids that were read."""

    field: str  # density, velocity, mask, or the name of one that is copied as it is
    file: str
    grid: str  # names of the grids in the file
    hash: str = ""  # content hash; "" in records of versions that had none


@dataclass(frozen=True)
class FrameRecord:
    """A frame of the result."""

    file: str
    prim: str  # path of the Volume
    time_code: float
    sources: tuple[SourceGrid, ...] = ()


@dataclass(frozen=True)
class StyleRecord:
    """A style image."""

    file: str
    sha256: str

    @property
    def name(self) -> str:
        """The file's name."""
        return self.file.rpartition("/")[2]


@dataclass(frozen=True)
class NetworkRecord:
    """A network that the run has trained for the colours of a Volume."""

    prim: str  # path of the Volume
    file: str
    sha256: str


@dataclass(frozen=True)
class MachineRecord:
    """What the run was begun with."""

    platform: str = ""  # system and processor family
    device: str = ""
    processor: str = ""  # kind, with the instructions that torch uses
    others: Mapping[str, str] = field(default_factory=dict)  # other kinds, by window or coarse step


@dataclass(frozen=True)
class Extinction:
    """Extinction per density, 1/stage unit, as it was fitted or set, and the curve of density."""

    colour: float
    shape: float
    thicken: float = 1.0  # times that the thinnest smoke is as dense as in the source
    knee: float = 0.0  # density, of that curve; 0: the density is the source's, moved


@dataclass(frozen=True)
class Figure:
    """One figure over the frames that have it."""

    mean: float
    largest: float
    n_frames: int


@dataclass(frozen=True)
class RunRecord(JsonRecord):
    """How a result was made. Files are relative to the folder of the look layer."""

    format: int
    run: str  # UUID
    version: str  # of usdsmoke
    tool: str = "usdsmoke"
    created: str = ""  # when the run was begun, UTC, ISO 8601
    finished: str = ""  # when the record was made
    grown_from: tuple[str, ...] = ()  # UUIDs of the runs that it went on from
    look: str = ""  # name of the look
    stage: str = ""  # the source; "" where it is not known
    packages: Mapping[str, str] = field(default_factory=dict)  # versions by name
    machine: MachineRecord = field(default_factory=MachineRecord)
    seed: int = 0
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # all, by section
    explicit: tuple[str, ...] = ()  # names of those that are stronger than a Volume's own
    requests: Mapping[str, Any] = field(default_factory=dict)  # what prims ask for, by path
    style_request: tuple[str, ...] = ()  # images given for the run; none: Volumes have their own
    styles: tuple[StyleRecord, ...] = ()  # all images
    features: str = ""  # the feature networks
    features_hash: str = ""
    start_hash: str = ""  # SHA-256 of the network in optimize.start; "": frames start without one
    networks: tuple[NetworkRecord, ...] = ()  # that the run trained (optimize.start=network)
    stage_values: Mapping[str, str] = field(default_factory=dict)  # see ``stage_values``
    variants: Mapping[str, str] = field(default_factory=dict)  # selected ones, by </prim>{set}
    source_files: Mapping[str, str] = field(default_factory=dict)  # SHA-256, by path from the stage
    frames: tuple[FrameRecord, ...] = ()
    results: Mapping[str, str] = field(default_factory=dict)  # content hash by VDB file written
    shaders: Mapping[str, str] = field(default_factory=dict)  # SHA-256 of the material's shaders
    extinction: Mapping[str, Extinction] = field(default_factory=dict)  # by Volume
    style_sizes: Mapping[str, float] = field(default_factory=dict)  # ``style.size``, by Volume
    refinements: Mapping[str, int] = field(default_factory=dict)  # ``grids.refine``, by Volume
    # What was measured of each Volume's shot, where files that it was measured on have been written
    # again since; none: a rerun measures it.
    scenes: tuple[Mapping[str, Any], ...] = ()
    omitted: tuple[str, ...] = ()  # what was left out and why
    seconds: Mapping[str, float] = field(default_factory=dict)  # all work, coarse step, steps
    figures: Mapping[str, Figure] = field(default_factory=dict)  # over the frames
    error_budget: Mapping[str, Any] = field(default_factory=dict)  # see ``runs.budget``

    @property
    def start_file(self) -> str:
        """The network that frames start from, as in the settings; "" without one."""
        return str(self.settings.get("optimize", {}).get("start", "")) if self.start_hash else ""

    @property
    def request(self) -> dict[str, Any]:
        """What it takes to make the run's job again, as JSON values."""
        return {
            "stage": self.stage,
            "styles": list(self.style_request),
            "config": self.settings,
            "explicit": list(self.explicit),
        }

    def to_text(self) -> str:
        """As JSON text. Equal records have equal texts."""
        return json.dumps(self.to_json(), sort_keys=True, ensure_ascii=False)

    @classmethod
    def from_text(cls, text: str, where: str) -> "RunRecord":
        """The record that ``to_text`` gave.

        Raises:
            LayerError: the text is no record, or one of another format.
        """
        try:
            values = read_json(text)
            found = values["format"]
            if found == RECORD_FORMAT:
                return cls.from_json(values)
        except (ValueError, TypeError, KeyError) as error:
            reason = " ".join(str(error).split())[:120]
            raise LayerError(
                f"cannot read the usdsmoke record in {where} ({type(error).__name__}: "
                f"{reason}). Restore the file as usdsmoke wrote it."
            ) from None
        raise LayerError(
            f"the usdsmoke record in {where} has format {found!r}; this version reads format "
            f"{RECORD_FORMAT}. Use the version of usdsmoke that wrote it: "
            f"{values.get('version', 'unknown')}."
        )


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

    Two VDB files of the same grids differ, because each holds a random identifier. Content hashes
    compare those.

    Raises:
        FileUnreadable: the file cannot be read.
    """
    try:
        with open(file_path, "rb") as stream:
            return hash_stream(stream)
    except OSError as error:
        raise FileUnreadable(
            f"cannot read {file_path} to take its hash: {error.strerror or error}. "
            "Check the path and its permissions."
        ) from None


def hash_values(values: Any) -> str:
    """SHA-256 of JSON values as 64 hexadecimal digits; the order of keys does not count."""
    text = json.dumps(values, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def hash_stream(stream: BinaryIO) -> str:
    """SHA-256 of the rest of an open file as 64 hexadecimal digits."""
    digest = hashlib.sha256()
    while block := stream.read(1 << 20):
        digest.update(block)
    return digest.hexdigest()
