"""Whether the inputs of a result are still there and unchanged.

A VDB file with other bytes is read as the run read it, and its grids are compared by their content.
A file that was only written again, for example compressed, is a note.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from usdsmoke.audit.record import FoundRecord
from usdsmoke.base.errors import BindingMissing, ConfigError, FeatureError, UsdSmokeError
from usdsmoke.base.record_format import SHOWN_DIGITS, RunRecord, hash_file
from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.base.volume import StageSource
from usdsmoke.config.resolve import recorded_settings
from usdsmoke.config.settings import Config
from usdsmoke.planning.frame_reader import FrameReader
from usdsmoke.planning.job import Job, prepare_job, recorded_request, selected_variants
from usdsmoke.planning.networks import features_hashes
from usdsmoke.planning.plan import FramePlan
from usdsmoke.planning.stage_values import stage_pieces, stage_values
from usdsmoke.runs.changes import find_changes
from usdsmoke.runs.run import find_runs
from usdsmoke.usd.rules import switched_files, switched_variants, written_at
from usdsmoke.usd.stage import read_source


@dataclass(frozen=True)
class Change:
    """One difference between a record and what is there."""

    kind: str  # such as input-edited; docs/provenance.md lists them
    file: str
    expected: str
    found: str
    severity: Literal["changed", "note"] = "changed"

    @classmethod
    def note(cls, kind: str, file: str, expected: str, found: str) -> "Change":
        """A difference that does not make the result another one."""
        return cls(kind, file, expected, found, "note")


def shown(digest: str) -> str:
    """As much of a hash as people compare."""
    return digest[:SHOWN_DIGITS] or "none"


def recorded_config(item: FoundRecord) -> Config:
    """The settings of a run, with the place of its parameter file as it is now.

    Raises:
        ConfigError: this version of usdsmoke knows other settings.
    """
    return recorded_settings(item.record.request, item.folder)


def check_inputs(item: FoundRecord) -> list[Change]:
    """What differs of stage, VDB files, style images, features and the network of starts."""
    if not item.record.stage:
        found = "a record that does not say where the inputs are"
        return [Change.note("unchecked", str(item.file), "stage and style images", found)]
    try:
        config = recorded_config(item)
    except ConfigError as error:
        file = str(item.file)
        return [Change.note("unchecked", file, "settings that this version knows", str(error))]
    stage = item.place(item.record.stage)
    job = _job(item, config) if os.path.isfile(stage) else None
    changes = [
        *_check_styles(item),
        *_check_features(item.record, config, job),
        *_check_start(item, config),
    ]
    if not os.path.isfile(stage):
        lost = Change("stage-missing", str(stage), "the source stage", "no file")
        return [lost, *_check_files(item, stage, None), *changes]
    files = _check_files(item, stage, job)
    some_are_gone = any(change.kind == "input-missing" for change in files)
    return [*files, *_check_stage(item, stage, config, job, some_are_gone), *changes]


def _job(item: FoundRecord, config: Config) -> Job | None:
    """The run's job with the inputs as they are now; None where that is impossible."""
    request = {**item.record.request, "config": config.model_dump()}
    try:
        return prepare_job(recorded_request(item.folder, request), fits=False)
    except UsdSmokeError:
        return None


def _check_styles(item: FoundRecord) -> Iterator[Change]:
    for style in item.record.styles:
        file, expected = item.place(style.file), f"sha256 {shown(style.sha256)}"
        if not os.path.isfile(file):
            yield Change("style-missing", str(file), expected, "no file")
        elif (found := hash_file(file)) != style.sha256:
            yield Change("style-edited", str(file), expected, f"sha256 {shown(found)}")


def _check_features(record: RunRecord, config: Config, job: Job | None) -> Iterator[Change]:
    volumes = [volume.config for volume in job.plan.volumes] if job is not None else [config]
    digest = record.features_hash
    networks = sorted({own.features.network for own in volumes})
    expected = f"{', '.join(networks)} {shown(digest)}"
    file = config.features.vgg19_file or config.features.network
    try:
        found = features_hashes(own.features for own in volumes)
    except FeatureError as error:
        yield Change("features-missing", file, expected, str(error))
        return
    if found == digest or (job is None and " " in digest):  # several networks: whose, is unknown
        return
    if networks == ["embedded"]:  # they come with usdsmoke, like its version
        yield Change.note("features-changed", "embedded features", expected, shown(found))
    else:
        yield Change("features-edited", file, expected, shown(found))


def _check_start(item: FoundRecord, config: Config) -> Iterator[Change]:
    """Of a network that was there before the run, and of those that it trained."""
    record, files = item.record, dict[Path, str]()
    if record.start_hash:
        files[Path(config.optimize.start)] = record.start_hash
    files |= {item.place(network.file): network.sha256 for network in record.networks}
    for file, digest in files.items():
        expected = f"sha256 {shown(digest)}"
        if not os.path.isfile(file):
            yield Change("start-missing", str(file), expected, "no file")
        elif (found := hash_file(file)) != digest:
            yield Change("start-edited", str(file), expected, f"sha256 {shown(found)}")


def _check_stage(
    item: FoundRecord, stage: Path, config: Config, job: Job | None, some_are_gone: bool
) -> Iterator[Change]:
    record, folder = item.record, item.folder
    expected = "the Volumes of the record"
    try:
        source = job.plan.source if job is not None else _source(record, stage, config)
    except UsdSmokeError as error:
        if some_are_gone:
            yield Change.note(
                "unchecked", str(stage), expected, "a stage some of whose files are missing"
            )
        else:
            yield Change("stage-edited", str(stage), expected, str(error))
        return
    for sentence in switched_variants(record, selected_variants(source)):
        expected, now = sentence.partition(" when the look was made, and is ")[::2]
        yield Change("stage-variant", str(stage), expected.replace(" was ", " "), now)
    for path, sentence in switched_files(record, folder, source):
        yield Change("stage-files", str(stage), f"<{path}> as recorded", sentence)
    recorded, here = record.stage_values, stage_values(source)
    if recorded != here and (then := _as_it_was(record, source)):
        yield Change.note("stage-frames", str(stage), *_added_codes(record, source))
        here |= then | {name: recorded.get(name, here[name]) for name in _RANGE}
    for name in (*recorded, *sorted(here.keys() - recorded.keys())):
        if job is None and (name.endswith(" request") or f"{name} request" in recorded):
            continue  # what counts of a prim's word is known together with the style images only
        before, now = recorded.get(name, "absent"), here.get(name, "absent")
        if before != now:
            texts = [shown(text) if len(text) == 64 else text for text in (before, now)]
            words = _in_words(item, source, name)
            now = f"{name} {texts[1]}" + (f", {words}" if words else "")
            yield Change("stage-edited", str(stage), f"{name} {texts[0]}", now)


def _in_words(item: FoundRecord, source: StageSource, name: str) -> str:
    """What differs of a Volume ``<prim path>``; "" where the run's folder is gone."""
    run = next((run for run in find_runs(item.folder) if run.run_id == item.record.run), None)
    if run is None or not name.startswith("<"):
        return ""
    then, now = (
        {name: values.get(name, {})} for values in (run.description["stage"], stage_pieces(source))
    )
    return str(find_changes({"stage": then}, {"stage": now}))


_RANGE = ("startTimeCode", "endTimeCode")


def _as_it_was(record: RunRecord, source: StageSource) -> dict[str, str]:
    """The values of a stage that has only got more timeCodes, or files of some, as they were;
    empty where something else has changed too."""
    codes: dict[str, set[float]] = {}
    for frame in record.frames:
        codes.setdefault(frame.prim, set()).add(frame.time_code)
    for all_codes in (False, True):  # whether those without a frame were there already
        volumes = []
        for volume in source.volumes:
            own = codes.get(volume.prim_path, set())
            frames = tuple(frame for frame in volume.frames if frame.time_code in own)
            known = volume.time_codes if all_codes else tuple(sorted(own))
            volumes.append(replace(volume, frames=frames, time_codes=known))
        values = stage_values(replace(source, volumes=tuple(volumes)))
        found = {name: value for name, value in values.items() if name not in _RANGE}
        if all(record.stage_values.get(name) == value for name, value in found.items()):
            return found
    return {}


def _added_codes(record: RunRecord, source: StageSource) -> tuple[str, str]:
    """The timeCodes of the record's frames, and those of the stage."""
    then = {frame.time_code for frame in record.frames}
    now = {code for volume in source.volumes for code in volume.time_codes}
    return name_time_codes(sorted(then)), name_time_codes(sorted(now | then))


def _source(record: RunRecord, stage: Path, config: Config) -> StageSource:
    """What the stage says, without the images that a job needs too."""
    if record.style_request:
        config = config.with_explicit({*config.explicit, "style.weights"})
    _, _, resolved = read_source(stage, config, bare=True)
    return resolved.source


def _check_files(item: FoundRecord, stage: Path, job: Job | None) -> list[Change]:
    """The VDB files by their bytes, and where these differ by what their grids hold."""
    changes, other = [], {}
    for name, digest in item.record.source_files.items():
        file, expected = Path(os.path.normpath(stage.parent / name)), f"sha256 {shown(digest)}"
        if not os.path.isfile(file):
            changes.append(Change("input-missing", str(file), expected, "no file"))
        elif (found := hash_file(file)) != digest:
            found = f"sha256 {shown(found)}, written {written_at(file)}"
            other[file] = Change("input-edited", str(file), expected, found)
    if not other or job is None:
        return [*changes, *other.values()]
    contents = _check_contents(item, job, other)
    unhashed: dict[Path, dict[str, None]] = {}
    for source in (source for frame in item.record.frames for source in frame.sources):
        if not source.hash:
            unhashed.setdefault(item.place(source.file), {})[source.grid] = None
    return [
        *changes,
        *(contents.get(file, _rewritten(other[file], unhashed.get(file, ()))) for file in other),
    ]


def _rewritten(change: Change, unhashed: Iterable[str]) -> Change:
    same = "a different file, but with identical grids where they were compared"
    if names := ", ".join(unhashed):
        same += f"; no hash is recorded of {names}"
    return Change.note("input-rewritten", change.file, change.expected, same)


def _check_contents(
    item: FoundRecord, job: Job, other: Mapping[Path, Change]
) -> dict[Path, Change]:
    """Of the files whose bytes differ those with a grid that does not hold what was read."""
    frames = {
        (volume.source.prim_path, frame.source.time_code): (volume, frame)
        for volume in job.plan.volumes
        for frame in volume.frames
    }
    reader, changes, before = FrameReader(job.plan), dict[Path, Change](), list[FramePlan]()
    for frame in item.record.frames:
        sources = [(file, s) for s in frame.sources if (file := item.place(s.file)) in other]
        if not sources:
            continue
        planned = frames.get((frame.prim, frame.time_code))
        if planned is None:  # the stage no longer has this frame: it cannot be read as before
            changes = {file: other[file] for file, _ in sources} | changes
            continue
        reader.release(before, [planned[1]])  # neighbours may show the same file
        before = [planned[1]]
        try:
            hashes, trouble = reader.hash_sources(*planned), ""
        except BindingMissing as error:
            notes = {file: _unread(other[file], str(error)) for file, _ in sources}
            changes = notes | changes
            continue
        except UsdSmokeError as error:
            hashes, trouble = {}, str(error)
        for file, source in sources:
            found = hashes.get(source.field, "")
            if source.hash and found != source.hash:
                expected = f"{source.grid} {shown(source.hash)}"
                now = trouble or f"{shown(found)}, written {written_at(file)}"
                change = Change("input-edited", str(file), expected, now)
                changes.setdefault(file, change)
    return changes


def _unread(change: Change, reason: str) -> Change:
    return Change.note("unchecked", change.file, change.expected, f"a different file; {reason}")
