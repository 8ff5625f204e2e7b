"""The main job from end to end: stage -> plan -> grids -> core -> grids -> layer, nothing else."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from usdsmoke.config import Config, config_to_dict, read_config, resolve_config
from usdsmoke.contact_sheet import sheet_files
from usdsmoke.errors import Interrupted, UsdSmokeError
from usdsmoke.layer import author_look
from usdsmoke.pipeline_frames import FrameReader
from usdsmoke.pipeline_inputs import Job, describe_run, prepare_job, published_runs
from usdsmoke.pipeline_outputs import collect_volume, make_provenance
from usdsmoke.pipeline_pictures import write_contact_sheet
from usdsmoke.pipeline_windows import check_frames, measure_volume, stylize_windows
from usdsmoke.plan import Plan
from usdsmoke.provenance import hash_file
from usdsmoke.run_folder import RunFolder, lock_output, open_run
from usdsmoke.run_progress import RunProgress, RunProgressCallback

if TYPE_CHECKING:
    from usdsmoke.core.scene import Scene

__all__ = ["Settings", "StylizeResult", "plan_stylize", "stylize"]

FilePath = str | PathLike[str]
Settings = Config | Mapping[str, Any] | FilePath | None


@dataclass(frozen=True)
class StylizeResult:
    """What a run left behind."""

    root_stage: Path  # the stage to open
    look_layer: Path
    frames: tuple[Path, ...]  # VDB files, Volume by Volume
    contact_sheets: tuple[Path, ...]  # one picture for each Volume
    plan: Plan
    warnings: tuple[str, ...]  # worth knowing, none of them fatal


def plan_stylize(
    stage: FilePath,
    style: FilePath | Sequence[FilePath],
    output: FilePath,
    config: Settings = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
) -> Plan:
    """What ``stylize`` with the same arguments would do; no voxel is read, no file is written.

    Raises:
        UsdSmokeError: everything that can be known before voxels are read.
    """
    return prepare_job(stage, _paths(style), Path(output), _resolve(config, settings)).plan


def stylize(
    stage: FilePath,
    style: FilePath | Sequence[FilePath],
    output: FilePath,
    config: Settings = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
    force: bool = False,
    progress: RunProgressCallback | None = None,
    planned: Callable[[Plan], None] | None = None,
) -> StylizeResult:
    """Stylize the smoke of a stage after one or more images and write the result as a look layer.

    A run that was stopped, however rudely, is continued by the same call: finished windows are
    kept. Input files are only read.

    Args:
        stage: a .usda, .usdc or .usd file.
        style: one image file or several.
        output: the folder of the result; made if missing.
        config: a YAML file, a mapping of sections, or ready made; None takes the defaults.
        settings: further ones, stronger than ``config``: a mapping of sections, or texts such as
            ``windows.size=3``.
        force: replace an earlier result, which stays whole until the new one is.
        progress: called often, with how far the run is.
        planned: called once with the plan, before anything heavy is loaded.

    Raises:
        UsdSmokeError: see ``usdsmoke.errors``; nothing is left behind but finished frames.
        Interrupted: by Ctrl-C.
    """
    # Threads that spin while they wait slow each other down many times where processors are shared.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # read when torch is imported, below
    job = prepare_job(stage, _paths(style), Path(output), _resolve(config, settings))
    if planned is not None:
        planned(job.plan)
    tell = progress or (lambda report: None)
    features_hash = _features_hash(job.config)
    description = describe_run(job, features_hash)
    with lock_output(job.output):
        run = open_run(job.output, description, published_runs(job), force)
        try:
            reader = FrameReader(job.plan)
            source_hashes = check_frames(reader, job.plan, run, tell)
            scenes = [measure_volume(reader, job.plan, volume) for volume in job.plan.volumes]
            run.begin(_plan_record(job.plan))
            seconds = stylize_windows(job, run, reader, scenes, source_hashes, tell)
            return _publish(job, run, reader, scenes, features_hash, seconds, tell)
        except KeyboardInterrupt:
            raise Interrupted(_how_far(run, job.plan)) from None
        finally:
            run.discard_if_useless()


def _paths(style: FilePath | Sequence[FilePath]) -> list[FilePath]:
    return [style] if isinstance(style, (str, PathLike)) else list(style)


def _resolve(config: Settings, settings: Mapping[str, Any] | Sequence[str]) -> Config:
    if isinstance(config, Config):
        sections: Mapping[str, Any] = config_to_dict(config)
    elif config is None or isinstance(config, Mapping):
        sections = config or {}
    else:
        sections = read_config(Path(config))
    if isinstance(settings, Mapping):
        return resolve_config(sections, settings)
    return resolve_config(sections, assignments=settings)


def _features_hash(config: Config) -> str:
    """SHA-256 of the network's parameter file; "" for the embedded features, which have none."""
    if config.features.network == "embedded":
        return ""
    from usdsmoke.core.vgg19 import find_vgg19_file

    return hash_file(find_vgg19_file(config.features.vgg19_file))


def _plan_record(plan: Plan) -> dict[str, Any]:
    """What of the plan stays with the result: nothing that names folders of this machine."""
    described = plan.to_dict()
    return {key: described[key] for key in ("windows", "needed", "omitted", "estimate")}


def _publish(
    job: Job,
    run: RunFolder,
    reader: FrameReader,
    scenes: Sequence["Scene"],
    features_hash: str,
    seconds: float,
    tell: RunProgressCallback,
) -> StylizeResult:
    """All frames are there: author the layer, which makes them the result, and draw the sheets."""
    plan, styles = job.plan, job.styles
    volumes = [
        collect_volume(run, volume, scene.gamma_w, plan.config)
        for volume, scene in zip(plan.volumes, scenes, strict=True)
    ]
    provenance = make_provenance(run, plan, styles, features_hash, scenes, {"stylize": seconds})
    files = author_look(job.stage, plan.source, volumes, job.output, plan.config.layer, provenance)
    sheets = sheet_files([volume.stem for volume in plan.volumes], job.output)
    warnings = _warnings(plan, run)
    for number, (sheet, volume) in enumerate(zip(sheets, plan.volumes, strict=True)):
        tell(RunProgress("picture", volume.frames[0].source.time_code, number, len(sheets), 1.0))
        pixels = [style.pixels for style in styles]
        try:
            write_contact_sheet(sheet, plan, volume, reader, run.folder, scenes[number], pixels)
        except UsdSmokeError as error:  # the result is whole without it
            warnings += (f"no contact sheet: {error}",)
    run.finish([files.look_layer, files.root_stage, *sheets])
    return StylizeResult(
        root_stage=files.root_stage,
        look_layer=files.look_layer,
        frames=tuple(Path(frame.file_path) for volume in volumes for frame in volume.frames),
        contact_sheets=tuple(sheet for sheet in sheets if sheet.is_file()),
        plan=plan,
        warnings=warnings,
    )


def _warnings(plan: Plan, run: RunFolder) -> tuple[str, ...]:
    found = [
        f"{name}: {warning}"
        for name, record in sorted(run.frames.items())
        for warning in record["report"].get("warnings", [])
    ]
    codes = [frame.source.time_code for volume in plan.volumes for frame in volume.frames]
    if any(code != round(code) for code in codes):
        found.append(
            "some timeCodes are no whole numbers: Blender's importer cannot follow such sequences"
        )
    return tuple(found)


def _how_far(run: RunFolder, plan: Plan) -> str:
    if not run.frames:
        return "stopped before the first frame was finished; nothing was left behind"
    return (
        f"stopped with {len(run.frames)} of {plan.n_frames} frames finished in {run.folder}; "
        "run the same command again to continue"
    )
