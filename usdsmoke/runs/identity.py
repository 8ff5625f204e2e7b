"""What decides a run's result, as JSON values: equal descriptions give equal results.

What a job leaves to the machine (the device) is as the run has settled it: see
``run_machine``.
"""

import copy
import json
import os
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from usdsmoke import __version__
from usdsmoke.base.errors import GridError, NonFiniteError
from usdsmoke.base.naming import relative_asset_path
from usdsmoke.base.record_format import hash_file
from usdsmoke.base.time_codes import format_time_code, format_time_codes
from usdsmoke.config.run_sections import OWN_NETWORK, OptimizeConfig
from usdsmoke.pictures import StyleImage
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import FileDigest, Job, selected_variants
from usdsmoke.planning.networks import features_hashes
from usdsmoke.planning.plan import Plan, VolumePlan
from usdsmoke.planning.stage_values import stage_pieces
from usdsmoke.runs.changes import Changes, find_changes
from usdsmoke.runs.run import Run
from usdsmoke.runs.run_machine import machine_of
from usdsmoke.usd.request_values import REQUEST_ATTRIBUTES

# Values that leave a choice to the machine on which a run begins, or to the run that a look grew
# from; by section.
_OPEN: dict[str, dict[str, Any]] = {
    "optimize": {"device": "auto"},
    "optics": {"frames": ""},
}

# Settings that change when or whether a result comes about, but not the result.
_NEUTRAL = {
    "features": ("vgg19_file",),  # what it holds counts: features_hash
    "grids": ("memory_limit_gib", "time_limit_s"),
    # what the network of ``start`` holds counts: start_hash
    "optimize": ("threads", "memory_limit_gib", "error_budget", "start"),
    "layer": ("mode", "contact_sheet"),
    "stage": ("allow_missing",),  # which frames are read counts
}

_RECENT_NS = 2 * 10**9  # file systems tell times to two seconds at worst

# What follows from which frames are selected, of a description's ``stage``.
_FOLLOW_FRAMES = ("leftOut",)


class Identity:
    """What a job asks for, as it compares with runs.

    What the job leaves to the machine is as the run has it, once there is one.

    Args:
        reads: the input files that are read, as the plan names them, given a run that has begun;
            None: all. Digests of other files are taken from the run.
    """

    def __init__(
        self, job: Job, reads: Callable[[Run], Collection[str] | None] = lambda run: None
    ) -> None:
        self._job, self._reads = job, reads
        self._features = features_hashes(volume.config.features for volume in job.plan.volumes)

    def alone(self) -> dict[str, Any]:
        """The description of a new run, with what is left to the machine as it is here.

        Raises:
            ConfigError: the device is not there.
        """
        machine = machine_of(self._job)
        here = {"settings": {"optimize": {"device": machine.device}}}
        return _as_stored(_settled(describe_run(self._job, self._features), here))

    @property
    def stamps(self) -> dict[str, tuple[int, int]]:
        """Of the files that the description names, as far as these have been read."""
        folder, digests = Path(self._job.plan.source.file_path).parent, self._job.digests
        return {
            os.path.relpath(file_path, folder): digest.stamp
            for file_path, digest in digests.items()
            if digest.stamp is not None
        }

    def beside(self, run: Run) -> dict[str, Any]:
        """The description as it compares with a run's."""
        requested = self._reads(run)
        described = describe_run(self._job, self._features, run, requested)
        return _as_stored(_settled(described, run.description))

    def is_of(self, run: Run) -> bool:
        """Whether a run is the one that is asked for."""
        return self.beside(run) == run.description

    def changes(self, run: Run, whatever_frames: bool = False) -> Changes:
        """What differs from a run; false where nothing does.

        Args:
            whatever_frames: the selections may differ: the job's frames are those of the run.
        """
        earlier, later = run.description, self.beside(run)
        if whatever_frames:
            earlier, later = _without_selection(earlier), _without_selection(later)
        source = self._job.plan.source
        variants = (run.request.get("variants", {}), selected_variants(source))
        now = relative_asset_path(source.file_path, self._job.output)
        stages = (run.request.get("stage", now), now)
        return find_changes(earlier, later, Path(source.file_path).parent, variants, stages)


def describe_run(
    job: Job,
    features_hash: str,
    earlier: Run | None = None,
    requested: Collection[str] | None = None,
) -> dict[str, Any]:
    """Everything that decides a result, as JSON values: equal descriptions give equal results.

    Files are named relative to the stage, so that a moved shot is still the same run. One that was
    written again counts as it was where its grids are those that a result was made from. Threads
    and device stand there as asked for; they may be left to the machine.

    Args:
        earlier: has the digests of files that are not read again: those that are as large and as
            old as it found them, and those that are not requested.
        requested: the files that are compared, named as in the plan; None: all.
    """
    source = job.plan.source
    folder = Path(source.file_path).parent
    requests = requested_values(job.plan, job.styles)
    optimize = job.config.optimize
    known = {} if earlier is None else earlier.description.get("files", {})
    stamps = {} if earlier is None else earlier.stamps
    files = {}
    for file_path in source.grid_files:
        name = os.path.relpath(file_path, folder)
        if name in known and requested is not None and file_path not in requested:
            files[name] = known[name]
            continue
        files[name] = _file_digest(job, file_path, known.get(name), stamps.get(name))
        before = known.get(name, files[name])
        if earlier is not None and files[name] != before:
            files[name] = before if _has_same_grids(job, earlier, file_path) else files[name]
    return {
        **({"requests": requests} if requests else {}),
        "version": __version__,
        "settings": _deciding_settings(job),
        "stage": {"file": Path(source.file_path).name, **stage_pieces(source)},
        "files": files,
        "styles": [f"{style.name} {style.sha256}" for style in job.styles],
        "features_hash": features_hash,
        **({"start_hash": _start_digest(job, optimize)} if optimize.start else {}),
        **({"scenes": [dict(scene) for scene in job.scenes]} if job.scenes else {}),
    }


def _start_digest(job: Job, optimize: OptimizeConfig) -> str:
    """SHA-256 of the network that frames start from; of one that the run trains, only that."""
    return _file_digest(job, optimize.start_file) if optimize.start_file else OWN_NETWORK


def _file_digest(
    job: Job, file_path: str, known: str | None = None, stamp: Sequence[int] | None = None
) -> str:
    """SHA-256 of a file, taken once.

    Args:
        known, stamp: of an earlier run; the digest stands where the file is as it was then.
    """
    if file_path not in job.digests:
        now = _stamp(file_path)
        if known and stamp and now == tuple(stamp):
            job.digests[file_path] = FileDigest(known, now)
        else:
            job.digests[file_path] = FileDigest(hash_file(file_path), now)
    return job.digests[file_path].sha256


def _has_same_grids(job: Job, run: Run, file_path: str) -> bool:
    """Whether the grids that a result was made from are still in a file with other bytes."""
    key = run.run_id, file_path
    if key not in job.same_grids:
        job.same_grids[key] = _compare_grids(job, run, file_path)
    return job.same_grids[key]


def _compare_grids(job: Job, run: Run, file_path: str) -> bool:
    recorded = {
        (record["prim_path"], record["time_code"]): record["source_hashes"]
        for record in run.frames.values()
    }
    reader, is_known = FrameReader(job.plan), False
    for volume in job.plan.volumes:
        for frame in volume.frames:
            before = recorded.get((volume.source.prim_path, frame.source.time_code))
            if before is None or file_path not in frame.files:
                continue
            try:
                now = reader.hash_sources(volume, frame)
            except (GridError, NonFiniteError):
                return False
            if any(now.get(name) != digest for name, digest in before.items()):
                return False
            is_known = True
    return is_known


def _stamp(file_path: str) -> tuple[int, int] | None:
    """Size and time of writing (ns); None for a file written a moment ago, which may be written
    once more within the clock's resolution, and for one that cannot be read."""
    try:
        status = os.stat(file_path)
    except OSError:
        return None
    is_old = time.time_ns() - status.st_mtime_ns > _RECENT_NS
    return (status.st_size, status.st_mtime_ns) if is_old else None


def requested_values(plan: Plan, styles: Sequence[StyleImage]) -> dict[str, Any]:
    """What each Volume's prim asks for and gets, as JSON values that name no folder.

    Returns:
        ``settings``, ``styles`` (name and SHA-256) and, where values change over time, ``samples``
        (by setting and timeCode) by prim path; nothing for Volumes that ask for nothing.
    """
    found: dict[str, Any] = {}
    for volume in plan.volumes:
        request = volume.source.request
        if request.settings or request.styles:
            images = [styles[place] for place in volume.styles] if request.styles else []
            found[volume.source.prim_path] = {
                "settings": {key: dict(values) for key, values in request.settings.items()},
                "styles": [f"{image.name} {image.sha256}" for image in images],
            }
            if samples := _requested_samples(volume):
                found[volume.source.prim_path]["samples"] = samples
    return found


def _requested_samples(volume: VolumePlan) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for row in (row for row in REQUEST_ATTRIBUTES if row.control):
        for frame in volume.source.frames:
            value = getattr(frame.controls, row.control)
            if value is not None:
                code = format_time_code(frame.time_code)
                found.setdefault(row.setting, {})[code] = value
    return found


def _deciding_settings(job: Job) -> dict[str, dict[str, Any]]:
    """With the timeCodes that are selected, in whatever words they are."""
    settings = job.config.model_dump()
    settings["stage"]["frames"] = selected_frames(job.plan)
    for section, keys in _NEUTRAL.items():
        for key in keys:
            del settings[section][key]
    device = settings["optimize"]["device"]
    settings["optimize"]["device"] = device.partition(":")[
        0
    ]  # which one of several GPUs is as well
    return settings


def selected_frames(plan: Plan) -> str:
    """The timeCodes of all Volumes, as ``stage.frames`` takes them."""
    return format_time_codes(
        sorted({frame.source.time_code for volume in plan.volumes for frame in volume.frames})
    )


def _settled(description: dict[str, Any], earlier: Mapping[str, Any]) -> dict[str, Any]:
    """A description in which what is left to the machine is as it was when a run began."""
    taken = copy.deepcopy(description)
    if "scenes" in earlier:
        taken.setdefault("scenes", earlier["scenes"])
    for section, values in _OPEN.items():
        before = earlier.get("settings", {}).get(section, {})
        for name, value in values.items():
            if name in before and taken["settings"][section].get(name) == value:
                taken["settings"][section][name] = before[name]
    return taken


def _without_selection(description: Mapping[str, Any]) -> dict[str, Any]:
    """A description without the selected frames and what follows from them alone."""
    taken = copy.deepcopy(dict(description))
    taken["settings"]["stage"].pop("frames", None)
    for name in _FOLLOW_FRAMES:
        taken["stage"].pop(name, None)
    for pieces in taken["stage"].values():
        if isinstance(pieces, dict):
            pieces.pop("timeCodes", None)
    return taken


def _as_stored(description: dict[str, Any]) -> dict[str, Any]:
    """As it comes back from a record."""
    stored: dict[str, Any] = json.loads(json.dumps(description))
    return stored
