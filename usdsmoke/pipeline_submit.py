"""A run handed to a render queue: a folder with a job template and what belongs to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

from usdsmoke.config import Config, config_to_yaml
from usdsmoke.errors import OutputExists
from usdsmoke.openjd_template import (
    FIRST_LINE,
    asset_references,
    bundle_text,
    job_parameters,
    job_template,
    parameter_values,
)
from usdsmoke.pipeline import Settings, plan_stylize
from usdsmoke.plan import Plan
from usdsmoke.publish import make_folders, publish_file
from usdsmoke.stage import open_stage

__all__ = ["JobBundle", "submit"]

FilePath = str | PathLike[str]


@dataclass(frozen=True)
class JobBundle:
    """What a queue needs, on disk."""

    template: Path
    files: tuple[Path, ...]  # beside the template: settings, parameter values, asset references
    parameters: Mapping[str, str]  # values of the template's parameters
    n_windows: int


def submit(
    stage: FilePath,
    style: FilePath | Sequence[FilePath],
    output: FilePath,
    config: Settings = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
    template: FilePath | None = None,
    command: str = "usdsmoke",
) -> JobBundle:
    """Plan a run and write it as an Open Job Description; nothing is stylized or sent.

    Equal arguments give equal files. The template fits the stage as it is now: write it again
    when frames come or go.

    Args:
        stage: as in ``stylize``, like those that follow it.
        style: one image file or several.
        output: the folder of the result.
        config: settings.
        settings: further ones, stronger than ``config``.
        template: the file to write; None takes ``OUT/job/template.yaml``. The folder becomes a
            job bundle of AWS Deadline Cloud when the file is named ``template.yaml``.
        command: the program that the queue's machines start.

    Raises:
        UsdSmokeError: what ``plan_stylize`` raises.
        OutputExists: a file of another origin stands where one of the bundle goes.
        WriteFailed: the operating system refused.
    """
    styles = [style] if isinstance(style, (str, PathLike)) else list(style)
    plan = plan_stylize(stage, styles, output, config, settings, fits=False)
    folder = Path(output).absolute()
    target = Path(template).absolute() if template is not None else folder / "job/template.yaml"
    images = [str(Path(image).absolute()) for image in styles]
    beside = {
        name: target.with_name(f"{name}.yaml")
        for name in ("settings", "parameter_values", "asset_references")
    }
    n_windows = sum(len(volume.windows) for volume in plan.volumes)
    parameters = job_parameters(
        str(Path(stage).absolute()), images, str(folder), str(beside["settings"])
    )
    memory, layer = plan.estimate.memory_gib, plan.config.layer
    assembly = ["--look", layer.look, "--mode", layer.mode]
    texts = {
        beside["settings"]: f"{FIRST_LINE}\n{_settings_text(plan.config)}",
        beside["parameter_values"]: bundle_text(parameter_values(parameters)),
        beside["asset_references"]: bundle_text(
            asset_references([*_read_files(plan), *images], str(folder))
        ),
        target: bundle_text(
            job_template(Path(stage).stem, n_windows, len(images), memory, command, assembly)
        ),
    }
    for file_path in texts:
        _refuse_foreign(file_path)
    make_folders(target.parent)
    for file_path, text in texts.items():
        _publish_text(file_path, text)
    return JobBundle(target, tuple(beside.values()), parameters, n_windows)


def _settings_text(config: Config) -> str:
    """All settings, resolved: the queue's machines look up no file of their own."""
    if config.features.vgg19_file:
        found = str(Path(config.features.vgg19_file).absolute())
        config = replace(config, features=replace(config.features, vgg19_file=found))
    return config_to_yaml(config, comments=False)


def _read_files(plan: Plan) -> list[str]:
    """Layers, VDB files and the network's parameters; absolute."""
    stage = open_stage(plan.source.file_path)
    layers = [layer.realPath for layer in stage.GetUsedLayers() if layer.realPath]
    grids = [
        field.file_path
        for volume in plan.source.volumes
        for frame in volume.frames
        for field in frame.fields.values()
    ]
    network = [plan.config.features.vgg19_file] if plan.config.features.vgg19_file else []
    return [str(Path(file_path).absolute()) for file_path in (*layers, *grids, *network)]


def _refuse_foreign(file_path: Path) -> None:
    """A file that ``submit`` did not write, such as the user's own settings, is not replaced."""
    if not file_path.exists():
        return
    try:
        with open(file_path, encoding="utf-8") as stream:
            is_own = stream.readline().rstrip("\n") == FIRST_LINE
    except (OSError, UnicodeDecodeError):
        is_own = False
    if not is_own:
        raise OutputExists(
            f"{file_path} stands where a file of the job goes and was not written by 'usdsmoke "
            "submit'; choose another folder with --template"
        )


def _publish_text(target: Path, text: str) -> None:
    def write(path: Path) -> None:
        path.write_text(text, encoding="utf-8")

    publish_file(target, write)
