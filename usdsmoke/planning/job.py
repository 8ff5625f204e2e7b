"""A request for a run (`Request`), and the same opened, planned and checked (`Job`)."""

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.machine import check_packages
from usdsmoke.base.naming import SCATTERING, find_run_files, relative_asset_path
from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.base.volume import EarlierLooks, StageSource, VolumeSource
from usdsmoke.config.look_sections import MOST_STOPS
from usdsmoke.config.resolve import (
    FilePath,
    Settings,
    Styles,
    recorded_settings,
    resolve_settings,
    settings_record,
    style_paths,
)
from usdsmoke.config.settings import Config, style_shares
from usdsmoke.core.generator.weights import read_weights
from usdsmoke.core.style.style_areas import marked_areas
from usdsmoke.pictures import StyleImage, read_style_image, sheet_files
from usdsmoke.planning.make_plan import check_plan, make_plan
from usdsmoke.planning.materials import front_brightness
from usdsmoke.planning.networks import check_features
from usdsmoke.planning.output_folder import (
    check_characters,
    check_output_folder,
    check_writable,
    link_notes,
    resolve_output,
)
from usdsmoke.planning.plan import Omission, Plan, VolumePlan
from usdsmoke.planning.remarks import fine_marks_remarks
from usdsmoke.planning.visibility import check_visibility
from usdsmoke.usd.look import LookFiles, check_asset, check_search_paths, look_files
from usdsmoke.usd.stage import StageOrFile, layer_files, read_source, stage_file
from usdsmoke.usd.volume_settings import ResolvedVolumes
from usdsmoke.vdb.binding import binding_name

_LEFT_OUT = 0.05  # share of a style image that is worth a note


@dataclass(frozen=True)
class Request:
    """A request for a run: the arguments of ``usdsmoke.stylize``.

    Paths are used as given; ``Request.settled`` makes them absolute for another process.
    """

    stage: StageOrFile  # a file, or an open stage without unsaved edits
    style: Styles = None  # image files; None if every Volume's prim names its own
    output: FilePath = "look"  # the folder of the result
    settings: Settings = None  # see ``resolve_settings``
    force: bool = False  # replace a result, and discard an unfinished run of other settings

    @property
    def config(self) -> Config:
        """The settings, resolved.

        Raises:
            ConfigError: the settings are wrong.
        """
        return resolve_settings(self.settings)

    def settled(self) -> "Request":
        """The same with absolute paths and one Config, independent of the working folder.

        Raises:
            ConfigError: the settings are wrong.
            StageError: an open stage has unsaved edits.
        """
        return dataclasses.replace(
            self,
            stage=str(stage_file(self.stage)),
            style=tuple(str(Path(image).absolute()) for image in style_paths(self.style)),
            output=str(Path(self.output).absolute()),
            settings=self.config,
        )

    def with_config(self, config: Config) -> "Request":
        """The same with other settings."""
        return dataclasses.replace(self, settings=config)


@dataclass(frozen=True)
class FileDigest:
    """SHA-256 of an input file, and what the file looked like from outside when it was taken."""

    sha256: str
    stamp: tuple[int, int] | None  # bytes, and when it was written (ns); None: too recently


@dataclass(frozen=True)
class Job:
    """A prepared run: its stage, headers and images are read and checked."""

    request: Request  # settled
    stage: Any  # the open Usd.Stage
    plan: Plan
    styles: tuple[StyleImage, ...]
    style_files: tuple[Path, ...]  # those given for the run, absolute; none: the Volumes' own
    output: Path  # without links
    targets: LookFiles
    earlier: EarlierLooks  # existing looks of the stage
    files: tuple[Path, ...]  # all files that the run reads: layers, VDB files, style images
    fits: bool = True  # True if the machine was checked: see ``prepare_job``
    # Of each Volume, in the place of those that would be measured: those that a result was begun
    # with, whose files have been written again; none: they are measured.
    scenes: tuple[Mapping[str, Any], ...] = ()
    digests: dict[str, FileDigest] = dataclasses.field(default_factory=dict, compare=False)
    # Whether a file with other bytes has the grids that a run has read, by the run's id and file.
    same_grids: dict[tuple[str, str], bool] = dataclasses.field(default_factory=dict, compare=False)

    def pictures(self, volume: VolumePlan) -> list[np.ndarray]:
        """The pixels of a Volume's style images."""
        return [self.styles[place].pixels for place in volume.styles]

    @property
    def config(self) -> Config:
        """The run's settings; a Volume's own are in its plan."""
        return self.plan.config

    @property
    def sheets(self) -> list[Path]:
        """The contact sheets of the result: one for each Volume, or none."""
        return _sheets(self.plan, self.output)

    def refined_as(self, parts: Mapping[str, int]) -> "Job":
        """The same job, prepared anew where a Volume's ``grids.refine`` is another one.

        Args:
            parts: of voxels, by prim path.

        Raises:
            PlanError: this machine has too little memory for that.
        """
        found = {volume.source.prim_path: volume.config.grids.parts for volume in self.plan.volumes}
        if all(parts.get(path, own) == own for path, own in found.items()):
            return self
        job = prepare_job(self.request, self.fits, parts)
        return dataclasses.replace(
            job, scenes=self.scenes, digests=self.digests, same_grids=self.same_grids
        )

    def with_config(self, config: Config) -> "Job":
        """The same job with other settings, prepared anew."""
        job = prepare_job(self.request.with_config(config), self.fits)
        return dataclasses.replace(job, digests=self.digests, same_grids=self.same_grids)


def prepare_job(request: Request, fits: bool = True, parts: Mapping[str, int] | None = None) -> Job:
    """Open the stage, find its Volumes, read the style images, make the plan and check it.

    Args:
        fits: True if this machine's memory, disk and network file must suffice for the whole run.
        parts: ``grids.refine`` of Volumes that is not to be chosen, by prim path.

    Raises:
        UsdSmokeError: all errors that can be found without reading a voxel.
    """
    if fits:  # the packages that the run itself loads, before the plan is made
        check_packages("torch")
        binding_name()  # raises if there is none
    request = request.settled()
    config = request.config
    output = resolve_output(request.output)
    if fits:
        check_writable(output)
    style_files = tuple(Path(image) for image in style_paths(request.style))
    if style_files:  # they replace the Volumes' own images and weights
        style_shares(config.style, len(style_files))
    check_characters(output, Path(request.stage), style_files)
    # The stage: Volumes, their own settings, cameras, lights.
    stage, earlier, resolved = read_source(stage_file(request.stage), config, style_files)
    resolved, source = _refined(resolved, parts or {}), resolved.source
    for volume, own in zip(source.volumes, resolved.volumes, strict=True):
        _check_names(volume, own.config)
        _check_lights(volume, own.config)
        check_features(own.config.features, fits)
        _check_start(own.config, fits)
    styles = tuple(read_style_image(image) for image in resolved.style_files)
    if config.layer.mode == "reference":
        check_asset(stage)
    # The plan, and the files of its result.
    plan = _plan(source, config, resolved, earlier)
    opened = [*link_notes(request.output, output, Path(source.file_path))]
    if config.layer.mode == "reference" and not stage.HasDefaultPrim():
        opened.append(
            "the stage has no defaultPrim, so a reference to the asset has to name a prim, such as "
            f"</{source.volumes[0].prim_path.split('/')[1]}>"
        )
    plan = dataclasses.replace(plan, notes=(*opened, *plan.notes, *_style_notes(plan, styles)))
    targets = look_files(source.file_path, output, config.layer)
    if targets.root_stage is not None:
        check_search_paths(stage, targets.root_stage)
    files = _read_files(layer_files(stage), source, resolved)
    placed = [output / volume.file_of(f) for volume in plan.volumes for f in volume.frames]
    written = [*targets.written, *_sheets(plan, output), *(placed if config.layer.files else ())]
    inputs = [*files, *(Path(file_path) for file_path in earlier.layers)]
    check_output_folder(output, config.layer.look, inputs, written)
    if fits:  # of a run that has begun, ``OpenRun.check_disk`` looks at the rest
        check_visibility(plan.volumes)
        check_plan(plan, None if find_run_files(output) else output)
    return Job(request, stage, plan, styles, style_files, output, targets, earlier, files, fits)


def describe_request(job: Job) -> dict[str, Any]:
    """All that is needed to prepare the job again, as JSON; files relative to the output folder."""
    files = [Path(job.plan.source.file_path), *job.style_files]
    stage, *styles = [relative_asset_path(file_path, job.output) for file_path in files]
    return {
        "stage": stage,
        "styles": styles,
        "variants": selected_variants(job.plan.source),  # for people: it is the stage that counts
        **settings_record(job.config, job.output),
    }


def selected_variants(source: StageSource) -> dict[str, str]:
    """The variants that are selected on the Volumes and above, by variant set."""
    return {name: value for volume in source.volumes for name, value in volume.variants.items()}


def recorded_request(output: Path, record: Mapping[str, Any], mode: str | None = None) -> Request:
    """The request that started a run.

    Args:
        record: from ``describe_request``.
        mode: ``layer.mode`` instead of the record's.

    Raises:
        ConfigError: this version of usdsmoke knows other settings.
    """
    names = (record["stage"], *record["styles"])
    stage, *styles = [os.path.normpath(output / name) for name in names]
    other = {"layer.mode": mode} if mode else {}
    return Request(stage, styles, output, recorded_settings(record, output).with_values(other))


def _refined(resolved: ResolvedVolumes, parts: Mapping[str, int]) -> ResolvedVolumes:
    """The Volumes with the parts of voxels that are given, by prim path."""
    volumes = list(resolved.volumes)
    for number, volume in enumerate(resolved.source.volumes):
        if volume.prim_path in parts:
            own = volumes[number]
            config = own.config.with_values({"grids.refine": parts[volume.prim_path]})
            volumes[number] = dataclasses.replace(own, config=config)
    return dataclasses.replace(resolved, volumes=tuple(volumes))


def _plan(
    source: StageSource, config: Config, resolved: ResolvedVolumes, earlier: EarlierLooks
) -> Plan:
    plan = make_plan(source, config, resolved.volumes)
    left_out = [Omission("earlier look", note) for note in earlier.notes]
    notes = [*source.dropped, *(note for volume in source.volumes for note in volume.notes)]
    return dataclasses.replace(
        plan, omitted=(*plan.omitted, *left_out), notes=(*plan.notes, *notes)
    )


def _sheets(plan: Plan, output: Path) -> list[Path]:
    if plan.config.layer.contact_sheet == 0:
        return []
    stems = [volume.stem for volume in plan.volumes]
    return list(sheet_files(stems, output, plan.config.layer.look))


def _check_start(config: Config, fits: bool) -> None:
    """Refuse a network that cannot be read, and a run without iterations that has none."""
    optimize = config.optimize
    if optimize.start_file and fits:
        read_weights(Path(optimize.start_file))
    if optimize.iterations == 0 and not optimize.paints:
        why = "optimize.start names no network to paint the smoke alone. Pass --start network"
        if optimize.start:
            why = "a network paints only colours. Add colour to optimize.steps"
        raise ConfigError(f"optimize.iterations is 0, but {why}, or give at least 1 iteration.")


def _check_names(volume: VolumeSource, config: Config) -> None:
    """Refuse to write a colour under a name that the Volume uses for something else."""
    if "colour" not in config.optimize.steps:
        return
    uses = {volume.density: "density", volume.mask: "mask"}
    uses |= dict.fromkeys(volume.velocity, "velocity")
    for name in config.colour_grids:
        if name in uses:
            raise ConfigError(
                f"the colour field {name} would have the same name as the {uses[name]} of "
                f"<{volume.prim_path}>. Rename the field on the stage, or change optimize.steps, "
                "colour.target, layer.scatter_colour or layer.split_rgb."
            )


def _check_lights(volume: VolumeSource, config: Config) -> None:
    """Refuse lights too bright for any exposure, and to paint an albedo that no light shows."""
    target = config.colour.target
    _check_brightness(volume, config)
    if SCATTERING not in config.painted:
        return
    if target == "both" and config.optics.anisotropy:
        raise ConfigError(
            f"optics.anisotropy={config.optics.anisotropy:g} makes the light depend on the view, "
            "and colour.target=both splits colours into albedo and emission for all views alike. "
            "Set optics.anisotropy=0, or another colour.target."
        )
    if config.optics.bounces:
        raise ConfigError(
            f"optics.bounces=true needs an albedo that is known, and colour.target={target} paints "
            "it. Set optics.bounces=false, or colour.target=emission."
        )
    dark = [frame.time_code for frame in volume.frames if not frame.lights]
    if dark or config.albedo == 0:
        found = "optics.albedo=0" if config.albedo == 0 else f"no light at {name_time_codes(dark)}"
        raise ConfigError(
            f"colour.target={target} paints what lit smoke scatters, but <{volume.prim_path}> has "
            f"{found}. Name a light with optics.sun or optics.sky, or set colour.target=emission."
        )


def _check_brightness(volume: VolumeSource, config: Config) -> None:
    least = 2.0**-MOST_STOPS if SCATTERING in config.painted else 0.0
    for frame in volume.frames:
        brightness = front_brightness(config, frame.lights)
        if brightness and not least <= brightness <= 2.0**MOST_STOPS:
            names = ", ".join(light.prim_path for light in frame.lights)
            raise ConfigError(
                f"in the light of {names}, smoke of <{volume.prim_path}> is {brightness:.2g} times "
                f"as bright as white at timeCode {frame.time_code:g}, and optics.exposure reaches "
                f"{MOST_STOPS:g} stops. Change the brightness of the lights, or set "
                "colour.target=emission and optics.albedo=0."
            )


def _style_notes(plan: Plan, styles: tuple[StyleImage, ...]) -> list[str]:
    """What is said of the style images."""
    fine_marks = [
        text
        for volume in plan.volumes
        for text in fine_marks_remarks(volume, [styles[place].pixels for place in volume.styles])
    ]
    of_files = filter(None, (style.note for style in styles))
    return [*fine_marks, *of_files, *_area_notes(plan, styles)]


def _area_notes(plan: Plan, styles: tuple[StyleImage, ...]) -> list[str]:
    """What of the style images looks are not painted with."""
    used = set[int]()
    for volume in plan.volumes:
        style = volume.with_all_weights.style
        if style.areas == "marked":
            shares = style_shares(style, len(volume.styles))
            used |= {n for n, share in zip(volume.styles, shares, strict=True) if share > 0}
    found = list[str]()
    for name, number in sorted((styles[n].name, n) for n in used):
        share = 1 - marked_areas(styles[number].pixels).mean()
        if share >= _LEFT_OUT:
            found.append(
                f"{share:.0%} of {name} is left out, because it is dark or has no marks. To paint "
                "with the whole image, set style.areas=all"
            )
    return found


def _read_files(
    layers: list[str], source: StageSource, resolved: ResolvedVolumes
) -> tuple[Path, ...]:
    """Every file that a run reads: layers, VDB files, style images; absolute, each once."""
    networks = [own.config.features.vgg19_file for own in resolved.volumes]
    files: list[str | Path] = [*layers, *source.grid_files, *resolved.style_files]
    files += filter(
        None, [*networks, *(own.config.optimize.start_file for own in resolved.volumes)]
    )
    return tuple(dict.fromkeys(Path(file_path).absolute() for file_path in files))
