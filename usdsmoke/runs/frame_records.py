"""What is written down about a run: in the layer for all of it, in each frame's file for the frame.

Where the keys mean the same they carry the same name: ``usdsmoke:seed`` in a file is ``seed`` in
the layer.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from usdsmoke import __version__
from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.machine import package_versions, platform_name
from usdsmoke.base.naming import relative_asset_path
from usdsmoke.base.record_format import Provenance, RunFacts, build_provenance
from usdsmoke.base.resolve import settings_record
from usdsmoke.base.sections import GridsConfig
from usdsmoke.pictures.png import StyleImage
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.planning.stage_values import stage_values
from usdsmoke.runs.budget import ErrorBudget, step_seconds, summarize_figures
from usdsmoke.runs.machine import machine_texts
from usdsmoke.runs.manifests import WindowRecord
from usdsmoke.runs.run import Run
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.read import read_binding_version

__all__ = ["budget_texts", "frame_metadata", "make_provenance"]

_OURS = "usdsmoke:"


def frame_metadata(
    run: Run,
    volume: VolumePlan,
    frame: FramePlan,
    source_hashes: Mapping[str, str],
    report: FrameReport,
    config: GridsConfig,
) -> dict[str, Any]:
    """What a frame's file says about itself, on top of what its source said.

    Args:
        run: gives settings and inputs.
        volume, frame: what the file is the result of.
        source_hashes: content hashes by field, of what was read.
        report: the frame's.
        config: how OpenVDB's version is asked for.
    """
    source_file = frame.source.fields[volume.source.density].file_path
    header = read_header(source_file).metadata
    theirs = {key: value for key, value in header.items() if not key.startswith(_OURS)}
    described = run.description
    nothing: dict[str, Any] = {"settings": {}, "styles": []}
    asked = described.get("requests", {}).get(volume.source.prim_path, nothing)
    settings = {
        section: {**values, **asked["settings"].get(section, {})}
        for section, values in described["settings"].items()
    }
    packages = sorted(_versions(config).items())
    return {
        "creator": f"usdsmoke {__version__}",
        **theirs,  # a source that is a result itself does not pass its record on as this one's
        "usdsmoke:version": __version__,
        "usdsmoke:packages": ", ".join(f"{name}={text}" for name, text in packages),
        "usdsmoke:platform": platform_name(),
        "usdsmoke:run": run.run_id,
        "usdsmoke:created": run.created,
        "usdsmoke:seed": volume.config.optimize.seed,
        "usdsmoke:config": _as_json(settings),
        "usdsmoke:params_sha256": run.settings_hash,
        "usdsmoke:features": volume.config.features.network,
        "usdsmoke:featuresHash": described["features_hash"],
        "usdsmoke:styles": _as_json(asked["styles"] or described["styles"]),
        "usdsmoke:source": Path(source_file).name,
        **{f"usdsmoke:{_source_key(name)}": digest for name, digest in source_hashes.items()},
        "usdsmoke:prim": volume.source.prim_path,
        "usdsmoke:timeCode": float(frame.source.time_code),
        "usdsmoke:report": _as_json(report.to_json()),
    }


def make_provenance(
    run: Run,
    plan: Plan,
    styles: Sequence[StyleImage],
    windows: Sequence[WindowRecord],
    temporal_error: Mapping[str, float],
    overlap_difference: Mapping[str, float],
) -> Provenance:
    """The record of a run, all of whose frames are there, for the layer.

    Args:
        run: with every frame of the result.
        plan, styles: what the run was made from.
        windows: the manifests of all windows.
        temporal_error, overlap_difference: means over the frames that have them.
    """
    config = plan.config
    reports = list(run.reports.values())
    coarse = run.coarse().seconds
    work = sum(window.seconds for window in windows)
    state = {key: value for key, value in run.description.items() if key != "settings"}
    facts = RunFacts(
        version=__version__,
        seed=config.optimize.seed,
        config=settings_record(config, run.output)["config"],
        inputs=_inputs(run, plan),
        styles={f"{n}/{style.name}": style.sha256 for n, style in enumerate(styles)},
        features=", ".join(
            dict.fromkeys(volume.config.features.network for volume in plan.volumes)
        ),
        features_hash=run.description["features_hash"],
        packages=_versions(config.grids),
        platform=platform_name(),
        machine=machine_texts(run),
        timings={"stylize": work + coarse, "coarse": coarse, **step_seconds(reports)},
        extinction={
            volume.source.prim_path: (scene["gamma_w"], scene["gamma_w_shape"])
            for volume, scene in zip(plan.volumes, run.scenes, strict=True)
        },
        temporal_error=temporal_error,
        overlap_difference=overlap_difference,
        figures=summarize_figures(reports),
        error_budget=budget_texts(ErrorBudget.from_dict(run.error_budget)),
        omissions=[f"{omission.what}: {omission.reason}" for omission in plan.omitted],
        stage_values=stage_values(plan.source),
        request=run.request,
        input_state=state,
        style_files={
            relative_asset_path(style.file_path, run.output): style.sha256 for style in styles
        },
        frames=[
            _frame_entry(run, volume, frame) for volume in plan.volumes for frame in volume.frames
        ],
        run_id=run.run_id,
        created=run.created,
    )
    return build_provenance(facts)


def _inputs(run: Run, plan: Plan) -> dict[str, str]:
    """Content hashes by file and grid."""
    inputs = {}
    for volume in plan.volumes:
        for frame in volume.frames:
            hashes = run.frames[frame.file_name]["source_hashes"]
            for name, file_path, label in _sources(volume, frame):
                if name in hashes:
                    inputs[f"{file_path} {label}"] = hashes[name]
    return inputs


def _frame_entry(run: Run, volume: VolumePlan, frame: FramePlan) -> dict[str, Any]:
    """A frame of the result and what it was made from, files relative to the output folder."""
    hashes = run.frames[frame.file_name]["source_hashes"]
    return {
        "file": relative_asset_path(run.folder / frame.file_name, run.output),
        "prim": volume.source.prim_path,
        "timeCode": frame.source.time_code,
        "sources": [
            {
                "field": name,
                "file": relative_asset_path(file_path, run.output),
                "grid": label,
                "hash": hashes.get(name, ""),
            }
            for name, file_path, label in _sources(volume, frame)
        ],
    }


def _sources(volume: VolumePlan, frame: FramePlan) -> Iterator[tuple[str, str, str]]:
    """Field, file and grids of everything that a frame is made from."""
    yield "density", frame.source.fields[volume.source.density].file_path, frame.grid.label
    if frame.mask is not None:
        yield "mask", frame.mask.field.file_path, frame.mask.grid.label
    velocity = frame.velocity or frame.copied
    if velocity is not None:
        label = ", ".join(grid.label for grid in velocity.grids)
        yield "velocity", velocity.field.file_path, label


def _source_key(field: str) -> str:
    return "source_sha256" if field == "density" else f"{field}_sha256"


@lru_cache(maxsize=4)
def _versions(config: GridsConfig) -> dict[str, str]:
    """Asked once in a process: OpenVDB's bindings tell theirs in a child of its own."""
    return {**package_versions(), "openvdb": read_binding_version(config)}


def _as_json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, ensure_ascii=False)


def budget_texts(budget: ErrorBudget) -> list[str]:
    """``name=figures`` of each error for the record, then what was left out."""
    found = []
    for item in budget.estimates:
        note = budget.notes.get(item.name, "")
        found.append(
            f"{item.name}=mean {item.mean:.6g}, max {item.largest:.6g}, of {item.relative_to}, "
            f"frames {item.n_frames}, seconds {item.seconds:.3f}, {item.how}"
            f"{f' ({note})' if note else ''}"
        )
    found += [f"{name}=left out: {why}" for name, why in budget.left_out.items()]
    return found if budget.tolerance is None else [*found, f"tolerance={budget.tolerance}"]
