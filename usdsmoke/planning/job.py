"""All that is known before voxels are read: stage, plan, styles, and what they are made of."""

import dataclasses
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd

from usdsmoke.base.asset_paths import relative_asset_path
from usdsmoke.base.config import Config, resolve_config, style_shares
from usdsmoke.base.errors import ConfigError
from usdsmoke.base.given_settings import portable_settings, settle_files
from usdsmoke.base.naming import colour_names, run_record_files
from usdsmoke.base.volume import EarlierLooks, StageSource, VolumeSource
from usdsmoke.pictures.contact_sheet import sheet_files
from usdsmoke.pictures.png import StyleImage, read_style_image
from usdsmoke.planning.features import check_features
from usdsmoke.planning.needs import Omission
from usdsmoke.planning.originals import check_originals, check_output_folder, settle_output
from usdsmoke.planning.plan import Plan, VolumePlan, check_plan, make_plan
from usdsmoke.usd.diagnostics import captured_diagnostics
from usdsmoke.usd.look import LookFiles, check_asset, look_files
from usdsmoke.usd.stage import find_volumes, open_source, seen_through
from usdsmoke.usd.volume_settings import resolve_volumes

__all__ = [
    "Job",
    "describe_request",
    "frame_files",
    "prepare_job",
    "published_runs",
    "requested_job",
]


@dataclass(frozen=True)
class Job:
    """A run as it was asked for, found possible as far as stage, headers and images tell."""

    stage: Usd.Stage
    plan: Plan
    styles: tuple[StyleImage, ...]
    style_files: tuple[Path, ...]  # those given for the run, absolute; none: Volumes bring theirs
    output: Path
    targets: LookFiles
    earlier: EarlierLooks  # looks that the stage has already
    explicit: frozenset[str] = frozenset()  # settings that are stronger than a Volume's own
    digests: dict[str, str] = dataclasses.field(default_factory=dict, compare=False)  # of files

    def pictures(self, volume: VolumePlan) -> list[np.ndarray]:
        """The pixels of a Volume's style images."""
        return [self.styles[place].pixels for place in volume.styles]

    @property
    def config(self) -> Config:
        """The run's settings; a Volume's own are in its plan."""
        return self.plan.config


def prepare_job(
    stage_path: str | PathLike[str],
    style_paths: Sequence[str | PathLike[str]],
    output: Path,
    config: Config,
    fits: bool = True,
    explicit: Collection[str] = (),
) -> Job:
    """Open the stage, find its Volumes, read the style images, make the plan and see that it fits.

    Args:
        stage_path: a file.
        style_paths: files; none where every Volume brings its own.
        output: the output folder.
        config: the run's settings.
        fits: whether memory, disk and the network's file must do for the whole work.
        explicit: dotted names of the settings that are stronger than a Volume's own.

    Raises:
        UsdSmokeError: everything that can be wrong without a voxel being read.
    """
    output = settle_output(output)
    style_files = tuple(Path(style_path).absolute() for style_path in style_paths)
    if style_files:  # then no Volume's own images or weights count
        style_shares(config.style, len(style_files))
    stage, earlier = open_source(stage_path, config.stage.restylize)
    found = find_volumes(stage, config.stage, {*explicit, *(["style"] if style_files else [])})
    if not config.stage.restylize:
        check_originals(stage, found)
    resolved = resolve_volumes(found, config, style_files, explicit)
    cameras = [own.config.views.camera for own in resolved.volumes]
    source = seen_through(stage, resolved.source, cameras)
    for volume, own in zip(source.volumes, resolved.volumes, strict=True):
        _check_names(volume, own.config)
        check_features(own.config.features, fits)
    styles = tuple(read_style_image(style_file) for style_file in resolved.style_files)
    if config.layer.mode == "reference":
        check_asset(stage)
    plan = make_plan(source, config, resolved.volumes)
    left_out = [Omission("earlier look", note) for note in earlier.notes]
    plan = dataclasses.replace(plan, omitted=(*plan.omitted, *left_out))
    targets = look_files(source, output, config.layer)
    sheets = sheet_files([volume.stem for volume in plan.volumes], output, config.layer.look)
    inputs = _input_files(stage, source, resolved.style_files)
    inputs += [Path(file_path) for file_path in earlier.layers]
    check_output_folder(output, config.layer.look, inputs, [*targets.written, *sheets])
    if fits:
        check_plan(
            plan, None if any(run_record_files(output)) else output
        )  # with a run: ``check_room``
    return Job(stage, plan, styles, style_files, output, targets, earlier, frozenset(explicit))


def published_runs(job: Job) -> frozenset[str]:
    """Run ids that this look's layers in the output folder name; "" for one that names none."""
    found = set()
    for suffix in (".usda", ".usdc"):
        file_path = job.targets.look_layer.with_suffix(suffix)
        if file_path.exists():
            found.add(_named_run(file_path))
    return frozenset(found)


def _check_names(volume: VolumeSource, config: Config) -> None:
    """Refuse to write a colour under a name that the Volume uses for something else."""
    if "colour" not in config.optimize.steps:
        return
    colours = colour_names(config.layer.scatter_colour, config.layer.split_rgb)
    uses = {volume.density: "density", volume.mask: "mask"}
    uses |= dict.fromkeys(volume.velocity, "velocity")
    for name in colours:
        if name in uses:
            raise ConfigError(
                f"the colour field {name} of the result would take the place of the "
                f"{uses[name]} of <{volume.prim_path}>, which is called the same; wanted "
                "another name for it: rename the field on the stage, or change "
                "optimize.steps, layer.scatter_colour or layer.split_rgb"
            )


def _input_files(stage: Usd.Stage, source: StageSource, styles: Iterable[Path]) -> list[Path]:
    """Every file that a run reads: layers, VDB files, style images; absolute, each once."""
    layers = [layer.realPath for layer in stage.GetUsedLayers() if layer.realPath]
    files = [*layers, *frame_files(source), *styles]
    return list(dict.fromkeys(Path(file_path).absolute() for file_path in files))


def frame_files(source: StageSource) -> list[str]:
    """The VDB files of all selected frames, each once, in order."""
    return list(
        dict.fromkeys(
            field.file_path
            for volume in source.volumes
            for frame in volume.frames
            for field in frame.fields.values()
        )
    )


def describe_request(job: Job) -> dict[str, Any]:
    """What it takes to make the job again, as JSON values; files relative to the output folder."""
    files = [Path(job.plan.source.file_path), *job.style_files]
    stage, *styles = [relative_asset_path(file_path, job.output) for file_path in files]
    return {
        "stage": stage,
        "styles": styles,
        "config": portable_settings(job.config, job.output),
        "explicit": sorted(job.explicit),
    }


def requested_job(output: Path, request: Mapping[str, Any], mode: str | None = None) -> Job:
    """The job that a run was begun for.

    Args:
        output: the output folder.
        request: from ``describe_request``.
        mode: ``layer.mode`` in the place of the request's.

    Raises:
        UsdSmokeError: an input has vanished or is no longer what it was.
    """
    stage, *styles = [
        os.path.normpath(output / name) for name in (request["stage"], *request["styles"])
    ]
    other = {"layer": {"mode": mode}} if mode else {}
    config = settle_files(resolve_config(request["config"], other), output)
    return prepare_job(stage, styles, output, config, False, request.get("explicit", ()))


def _named_run(look_layer: Path) -> str:
    try:
        with captured_diagnostics():
            layer = Sdf.Layer.OpenAsAnonymous(str(look_layer), metadataOnly=True)
    except Tf.ErrorException:
        return ""  # no layer of ours, but somebody's file
    record = layer.customLayerData.get("usdsmoke", {})
    return str(record.get("run", "")) if isinstance(record, dict) else ""
