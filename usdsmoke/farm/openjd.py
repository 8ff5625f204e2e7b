"""A run as a job for a render queue: a folder with a job template and its files."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from usdsmoke.base.errors import ConfigError, OutputExists
from usdsmoke.base.publish import make_folders, publish_file
from usdsmoke.base.resolve import FilePath, settings_yaml
from usdsmoke.base.settings import Config
from usdsmoke.farm.openjd_template import (
    FIRST_LINE,
    asset_references,
    bundle_text,
    job_parameters,
    job_template,
    parameter_values,
)
from usdsmoke.pipeline import Request
from usdsmoke.planning.job import prepare_job
from usdsmoke.planning.plan import Plan


@dataclass(frozen=True)
class JobBundle:
    """What a queue needs, on disk."""

    template: Path
    files: tuple[Path, ...]  # beside the template: settings, parameter values, asset references
    parameters: Mapping[str, str]  # values of the template's parameters
    n_windows: int


def submit(
    request: Request, template: FilePath | None = None, command: str = "usdsmoke"
) -> JobBundle:
    """Plan a run and write it as an Open Job Description; nothing is stylized or sent.

    Equal arguments give equal files. The template fits the stage as it is now: write it again
    when frames come or go.

    Args:
        request: the request.
        template: the file to write; None takes ``OUT/job/template.yaml``. The folder becomes a
            job bundle of AWS Deadline Cloud when the file is named ``template.yaml``.
        command: the program that the queue's machines start.

    Raises:
        UsdSmokeError: what ``plan`` raises.
        ConfigError: the command is not one program.
        OutputExists: a file of another origin has the path of a file of the bundle.
        WriteFailed: the operating system refused.
    """
    _check_program(command)
    request = request.with_config(_with_network_file(request.config)).settled()
    job = prepare_job(request, fits=False)
    folder = Path(request.output)
    target = Path(template).absolute() if template is not None else folder / "job/template.yaml"
    images = [str(image) for image in job.style_files]
    beside = {
        name: target.with_name(f"{name}.yaml")
        for name in ("settings", "overrides", "parameter_values", "asset_references")
    }
    n_windows = sum(len(volume.windows) for volume in job.plan.volumes)
    stage_file = _read_stage(Path(str(request.stage)), job.plan)
    given = [str(beside[name]) for name in ("settings", "overrides")]
    parameters = job_parameters(str(stage_file), images, str(folder), *given)
    memory, layer = job.plan.estimate.memory_gib, job.config.layer
    assembly = ["--look", layer.look, "--mode", layer.mode]
    texts = {
        beside["settings"]: f"{FIRST_LINE}\n{settings_yaml(request.config, comments=False)}",
        beside["overrides"]: bundle_text(request.config.explicit_values()),
        beside["parameter_values"]: bundle_text(parameter_values(parameters)),
        beside["asset_references"]: bundle_text(
            asset_references([str(file_path) for file_path in job.files], str(folder))
        ),
        target: bundle_text(
            job_template(stage_file.stem, n_windows, len(images), memory, command, assembly)
        ),
    }
    _publish_texts(texts)
    return JobBundle(target, tuple(beside.values()), parameters, n_windows)


def _check_program(command: str) -> None:
    """A queue starts a program with arguments; it does not parse a shell command."""
    if len(command.split()) > 1 and not Path(command).is_file():
        raise ConfigError(
            f"--command takes one program without arguments, got {command!r}. Put the call into "
            f'an executable script:\n  #!/bin/sh\n  exec {command} "$@"'
        )


def _with_network_file(config: Config) -> Config:
    """Its path absolute: the queue's machines look up no file of their own."""
    if not config.features.vgg19_file:
        return config
    found = str(Path(config.features.vgg19_file).absolute())
    return config.replace(features=config.features.replace(vgg19_file=found))


def _read_stage(given: Path, plan: Plan) -> Path:
    """The given stage, or the stage that it was made from if it is a result itself."""
    source = Path(plan.source.file_path)
    return given if given.samefile(source) else source


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
            f"{file_path} would be replaced by a file of the job, but was not written by "
            "'usdsmoke submit'. Choose another folder with --template."
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
