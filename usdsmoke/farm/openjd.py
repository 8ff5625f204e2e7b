"""A run handed to a render queue: a folder with a job template and what belongs to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from usdsmoke.base.config import Config, config_to_yaml
from usdsmoke.base.errors import ConfigError, OutputExists
from usdsmoke.base.given_settings import (
    FilePath,
    Settings,
    Styles,
    explicit_values,
    resolve_settings,
    style_paths,
)
from usdsmoke.base.publish import make_folders, publish_file
from usdsmoke.farm.openjd_template import (
    FIRST_LINE,
    asset_references,
    bundle_text,
    job_parameters,
    job_template,
    parameter_values,
)
from usdsmoke.pipeline import plan_stylize
from usdsmoke.planning.plan import Plan
from usdsmoke.usd.stage import open_stage

__all__ = ["JobBundle", "submit"]


@dataclass(frozen=True)
class JobBundle:
    """What a queue needs, on disk."""

    template: Path
    files: tuple[Path, ...]  # beside the template: settings, parameter values, asset references
    parameters: Mapping[str, str]  # values of the template's parameters
    n_windows: int


def submit(
    stage: FilePath,
    style: Styles,
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
        style: one image file or several; None where every Volume's prim brings its own.
        output: the folder of the result.
        config: settings.
        settings: further ones, stronger than ``config``.
        template: the file to write; None takes ``OUT/job/template.yaml``. The folder becomes a
            job bundle of AWS Deadline Cloud when the file is named ``template.yaml``.
        command: the program that the queue's machines start.

    Raises:
        UsdSmokeError: what ``plan_stylize`` raises; the command is no single program.
        OutputExists: a file of another origin stands where one of the bundle goes.
        WriteFailed: the operating system refused.
    """
    _check_program(command)
    styles = style_paths(style)
    resolved, explicit = resolve_settings(config, settings)
    resolved = _with_network_file(resolved)
    plan = plan_stylize(stage, styles, output, config, settings, fits=False)
    folder = Path(output).absolute()
    target = Path(template).absolute() if template is not None else folder / "job/template.yaml"
    images = [str(Path(image).absolute()) for image in styles]
    beside = {
        name: target.with_name(f"{name}.yaml")
        for name in ("settings", "overrides", "parameter_values", "asset_references")
    }
    n_windows = sum(len(volume.windows) for volume in plan.volumes)
    stage_file = _read_stage(stage, plan)
    given = [str(beside[name]) for name in ("settings", "overrides")]
    parameters = job_parameters(str(stage_file), images, str(folder), *given)
    memory, layer = plan.estimate.memory_gib, plan.config.layer
    assembly = ["--look", layer.look, "--mode", layer.mode]
    texts = {
        beside["settings"]: f"{FIRST_LINE}\n{config_to_yaml(resolved, comments=False)}",
        beside["overrides"]: bundle_text(explicit_values(resolved, explicit)),
        beside["parameter_values"]: bundle_text(parameter_values(parameters)),
        beside["asset_references"]: bundle_text(
            asset_references([*_read_files(plan), *images], str(folder))
        ),
        target: bundle_text(
            job_template(stage_file.stem, n_windows, len(images), memory, command, assembly)
        ),
    }
    _publish_texts(texts)
    return JobBundle(target, tuple(beside.values()), parameters, n_windows)


def _check_program(command: str) -> None:
    """A queue starts a program and hands it arguments; it takes no line of a shell apart."""
    if len(command.split()) > 1 and not Path(command).is_file():
        raise ConfigError(
            f"the command {command!r} is no single program; wanted one program, by name or path, "
            "without arguments: write them into an executable script, such as\n"
            f'  #!/bin/sh\n  exec {command} "$@"\nand give --command its path'
        )


def _with_network_file(config: Config) -> Config:
    """Its path absolute: the queue's machines look up no file of their own."""
    if not config.features.vgg19_file:
        return config
    found = str(Path(config.features.vgg19_file).absolute())
    return replace(config, features=replace(config.features, vgg19_file=found))


def _read_stage(given: FilePath, plan: Plan) -> Path:
    """The stage as it was given, or what it was made from where it is a result itself."""
    stage_file = Path(given).absolute()
    is_read = stage_file.samefile(plan.source.file_path)
    return stage_file if is_read else Path(plan.source.file_path)


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
    images = [image for volume in plan.volumes for image in volume.source.request.styles]
    network = [plan.config.features.vgg19_file] if plan.config.features.vgg19_file else []
    return [str(Path(file_path).absolute()) for file_path in (*layers, *grids, *images, *network)]


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


def _publish_texts(texts: Mapping[Path, str]) -> None:
    for file_path in texts:
        _refuse_foreign(file_path)
    for file_path, text in texts.items():
        make_folders(file_path.parent)
        _publish_text(file_path, text)


def _publish_text(target: Path, text: str) -> None:
    def write(path: Path) -> None:
        path.write_text(text, encoding="utf-8")

    publish_file(target, write)
