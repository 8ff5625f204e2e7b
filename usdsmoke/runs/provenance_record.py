"""The provenance record of a finished run, and the metadata in the file of each frame."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from usdsmoke import __version__
from usdsmoke.base.machine import package_versions
from usdsmoke.base.naming import relative_asset_path
from usdsmoke.base.publish import publish_file
from usdsmoke.base.record_format import (
    RECORD_FILE,
    RECORD_FORMAT,
    Extinction,
    FrameRecord,
    NetworkRecord,
    RunRecord,
    SourceGrid,
    StyleRecord,
    utc_now,
)
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.planning.job import Job, describe_request
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.planning.stage_values import stage_values
from usdsmoke.runs.budget import step_seconds, summarize_figures
from usdsmoke.runs.delivery import result_file
from usdsmoke.runs.manifests import WindowRecord, network_file_name
from usdsmoke.runs.run import Run
from usdsmoke.runs.run_machine import machine_record
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import read_binding_version

_OURS = "usdsmoke:"
_HASHED = ("density", "mask", "velocity")  # sources whose hashes a frame's file has


def frame_metadata(
    run: Run, volume: VolumePlan, frame: FramePlan, source_hashes: Mapping[str, str]
) -> dict[str, Any]:
    """The metadata of a frame's file: what its source has, and what it takes to check the file.

    The record of the run has everything else, see ``make_record``.

    Args:
        source_hashes: content hashes by field, of what was read.
    """
    source_file = frame.source.fields[volume.source.density].file_path
    header = read_header(source_file).metadata
    theirs = {key: value for key, value in header.items() if not key.startswith(_OURS)}
    return {
        "creator": f"usdsmoke {__version__}",
        **theirs,  # without the record of a source that is a result itself
        "usdsmoke:version": __version__,
        "usdsmoke:run": run.run_id,
        "usdsmoke:source": Path(source_file).name,
        **{
            f"usdsmoke:{_source_key(name)}": source_hashes[name]
            for name in _HASHED
            if name in source_hashes
        },
    }


def make_record(
    job: Job,
    run: Run,
    windows: Sequence[WindowRecord],
    results: Mapping[str, str],
    shaders: Mapping[str, str],
) -> RunRecord:
    """The record of a run that has every frame of the result.

    Args:
        run: with its error budget.
        windows: the manifests of all windows.
        results, shaders: content hash of each VDB file, SHA-256 of each shader that is written.
    """
    plan, config, output = job.plan, job.plan.config, run.output
    reports = list(run.reports.values())
    coarse, work = run.coarse().seconds, sum(window.seconds for window in windows)
    request, measured = describe_request(job), list(zip(plan.volumes, run.scenes, strict=True))
    return RunRecord(
        format=RECORD_FORMAT,
        run=run.run_id,
        version=__version__,
        created=run.created,
        finished=utc_now(),
        grown_from=tuple(run.grown_from),
        look=config.layer.look,
        stage=request["stage"],
        packages=_versions(config.grids),
        machine=machine_record(run),
        seed=config.optimize.seed,
        settings=request["config"],
        explicit=tuple(request["explicit"]),
        requests=run.description.get("requests", {}),
        style_request=tuple(request["styles"]),
        styles=tuple(
            StyleRecord(relative_asset_path(style.file_path, output), style.sha256)
            for style in job.styles
        ),
        features=_feature_networks(plan),
        features_hash=run.description["features_hash"],
        start_hash=run.description.get("start_hash", "") if config.optimize.start_file else "",
        networks=tuple(_networks(run, plan)),
        scenes=tuple(run.description.get("scenes", ())),
        stage_values=stage_values(plan.source),
        variants=request["variants"],
        source_files=run.description["files"],
        frames=tuple(
            _frame_record(run, volume, frame) for volume in plan.volumes for frame in volume.frames
        ),
        results=results,
        shaders=shaders,
        extinction={volume.source.prim_path: _extinction(scene) for volume, scene in measured},
        style_sizes={v.source.prim_path: used_style_size(v, scene) for v, scene in measured},
        refinements={v.source.prim_path: scene.get("refine", 1) for v, scene in measured},
        omitted=tuple(f"{omission.what}: {omission.reason}" for omission in plan.omitted),
        seconds={"stylize": work + coarse, "coarse": coarse, **step_seconds(reports)},
        figures=summarize_figures(reports),
        error_budget=run.error_budget,
    )


def _extinction(scene: Mapping[str, Any]) -> Extinction:
    curve = (scene.get("thicken", 1.0), scene.get("knee", 0.0))
    return Extinction(scene["gamma_w"], scene["gamma_w_shape"], *curve)


def used_style_size(volume: VolumePlan, scene: Mapping[str, Any]) -> float:
    """``style.size`` as it is set or, if it is unset, as it was chosen for a measured scene."""
    asked = volume.config.style.size
    return float(scene.get("style_size", 1.0) if asked is None else asked)


def _feature_networks(plan: Plan) -> str:
    return ", ".join(dict.fromkeys(volume.config.features.network for volume in plan.volumes))


def _networks(run: Run, plan: Plan) -> Iterator[NetworkRecord]:
    """Those that the run has trained."""
    for number, (volume, scene) in enumerate(zip(plan.volumes, run.scenes, strict=True)):
        if digest := scene.get("network"):
            place = relative_asset_path(run.folder / network_file_name(number), run.output)
            yield NetworkRecord(volume.source.prim_path, place, digest)


def keep_record(run: Run, record: RunRecord) -> None:
    """Write a record into the folder of its run.

    Raises:
        WriteFailed: the operating system refused.
    """
    publish_file(run.folder / RECORD_FILE, record.to_text())


def _frame_record(run: Run, volume: VolumePlan, frame: FramePlan) -> FrameRecord:
    hashes = run.frames[frame.file_name]["source_hashes"]
    sources: dict[str, SourceGrid] = {}
    for name, path, label in _sources(volume, frame):  # a copied grid may have a name of ours
        source = SourceGrid(name, relative_asset_path(path, run.output), label)
        digest = "" if name in sources else hashes.get(name, "")
        sources[f"{name} {label}" if name in sources else name] = replace(source, hash=digest)
    place = relative_asset_path(result_file(run, volume, frame), run.output)
    return FrameRecord(place, volume.source.prim_path, frame.source.time_code, (*sources.values(),))


def _sources(volume: VolumePlan, frame: FramePlan) -> Iterator[tuple[str, str, str]]:
    """Field, file and grids of everything that a frame is made from."""
    yield "density", frame.source.fields[volume.source.density].file_path, frame.grid.label
    if frame.mask is not None:
        yield "mask", frame.mask.field.file_path, frame.mask.grid.label
    velocity = frame.velocity or frame.copied
    if velocity is not None:
        label = ", ".join(grid.label for grid in velocity.grids)
        yield "velocity", velocity.field.file_path, label
    for other in frame.others:
        yield other.name, other.field.file_path, other.grid.label


def _source_key(field: str) -> str:
    return "source_sha256" if field == "density" else f"{field}_sha256"


@lru_cache(maxsize=4)
def _versions(config: GridsConfig) -> dict[str, str]:
    """Asked once in a process: the version of OpenVDB takes a child process."""
    return {**package_versions(), "openvdb": read_binding_version(config)}
