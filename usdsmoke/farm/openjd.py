"""A run as a job for a render queue: a folder with an Open Job Description and its files.

The template has the coarse step, one task for each window, and the assembly. It follows version
2023-09 of the specification without extensions (OpenJD2023). It contains no path of this machine:
files are parameters, and their values are in a separate file, in the form that AWS Deadline Cloud
reads beside a template.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from usdsmoke.base.errors import ConfigError, OutputExists, PlanError
from usdsmoke.base.publish import make_folders, publish_file
from usdsmoke.config.resolve import FilePath, settings_yaml
from usdsmoke.config.settings import Config
from usdsmoke.pipeline import Request, plan_request
from usdsmoke.planning.job import prepare_job
from usdsmoke.planning.plan import Plan
from usdsmoke.planning.visibility import check_visibility
from usdsmoke.runs.opening import find_growth

FIRST_LINE = "# Written by 'usdsmoke submit', which replaces it; change the copy that is submitted."
_LONGEST_NAME = 128  # characters of a job's name
_LONGEST_VALUE = 1024  # characters of a parameter's value
_MOST_PARAMETERS = 50
_NOTICE_S = 60  # between SIGTERM and SIGKILL: time to finish writing a frame


def job_template(
    name: str,
    n_windows: int,
    n_styles: int,
    memory_gib: float,
    command: str = "usdsmoke",
    assembly: Sequence[str] = (),
) -> dict[str, Any]:
    """The job template as plain values, in the order in which they are written.

    Args:
        name: of the shot; characters that a job's name may not have are removed.
        n_windows: of the plan, all Volumes together, at least 1.
        n_styles: style images that are given for the run; 0 if Volumes name their own.
        memory_gib: memory that a task requires of its machine, GiB.
        command: one program, by name or path, without arguments.
        assembly: further arguments of ``usdsmoke assemble``.

    Raises:
        ConfigError: the command is empty or holds control characters or ``{{``.
        PlanError: there are more style images than a template may have parameters.
    """
    parameters = _parameter_definitions(n_styles, command)
    if len(parameters) > _MOST_PARAMETERS:
        raise PlanError(
            f"{n_styles} style images make {len(parameters)} job parameters; an Open Job "
            f"Description takes at most {_MOST_PARAMETERS}. Give fewer images."
        )
    styles = [part for n in range(n_styles) for part in ("--style", f"{{{{Param.Style{n + 1}}}}}")]
    stylize = ["stylize", "{{Param.Stage}}", *styles, "-o", "{{Param.Output}}"]
    stylize += ["--config", "{{Param.Settings}}", "--overrides", "{{Param.Overrides}}"]
    space = {"name": "Window", "type": "INT", "range": f"0-{n_windows - 1}"}
    return {
        "specificationVersion": "jobtemplate-2023-09",
        "name": _job_name(name),
        "description": "Stylizes the smoke of a USD stage in windows of frames.",
        "parameterDefinitions": parameters,
        "steps": [
            _step("Coarse", [*stylize, "--coarse"], memory_gib),
            {
                **_step("Windows", [*stylize, "--window", "{{Task.Param.Window}}"], memory_gib),
                "dependencies": [{"dependsOn": "Coarse"}],
                "parameterSpace": {"taskParameterDefinitions": [space]},
            },
            {
                # Both: job attachments bring the files of the steps that are named, no others.
                **_step("Assemble", ["assemble", "{{Param.Output}}", *assembly], memory_gib),
                "dependencies": [{"dependsOn": "Coarse"}, {"dependsOn": "Windows"}],
            },
        ],
    }


def job_parameters(
    stage: str, styles: Sequence[str], output: str, settings: str, overrides: str
) -> dict[str, str]:
    """The values of the template's parameters that have no default.

    Args:
        stage: absolute path, as are the others.
        settings: the YAML file of settings.
        overrides: the YAML file of the settings that override a Volume's own request.

    Raises:
        PlanError: a path is longer than a parameter's value may be.
    """
    values = {"Stage": stage, "Output": output, "Settings": settings, "Overrides": overrides}
    values |= {f"Style{n}": style for n, style in enumerate(styles, 1)}
    for value in values.values():
        if len(value) > _LONGEST_VALUE:
            raise PlanError(
                f"the path {value[:60]}... has {len(value)} characters; an Open Job Description "
                f"takes at most {_LONGEST_VALUE}. Move the file or use a link."
            )
    return values


def parameter_values(parameters: Mapping[str, str]) -> dict[str, Any]:
    """The content of Deadline Cloud's ``parameter_values.yaml``.

    >>> parameter_values({"Stage": "/shots/a.usda"})
    {'parameterValues': [{'name': 'Stage', 'value': '/shots/a.usda'}]}
    """
    pairs = [{"name": name, "value": value} for name, value in parameters.items()]
    return {"parameterValues": pairs}


def asset_references(inputs: Sequence[str], output: str) -> dict[str, Any]:
    """The content of Deadline Cloud's ``asset_references.yaml``.

    Args:
        inputs: every file that a run reads, absolute.
    """
    return {
        "assetReferences": {
            "inputs": {"filenames": sorted(set(inputs)), "directories": []},
            "outputs": {"directories": [output]},
        }
    }


def bundle_text(content: Mapping[str, Any]) -> str:
    """Plain values as a YAML file; equal values give equal text.

    >>> print(bundle_text({"name": "smoke"}).splitlines()[-1])
    name: smoke
    """
    text = yaml.dump(
        content, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True, width=math.inf
    )
    return f"{FIRST_LINE}\n{text}"


class _PlainDumper(yaml.SafeDumper):
    """YAML without anchors: a value that occurs twice is written twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _parameter_definitions(n_styles: int, command: str) -> list[dict[str, Any]]:
    if not command.strip() or "{{" in command or not command.isprintable():
        raise ConfigError(
            f"the command {command!r} cannot be run by a queue. Give one program, by its name or "
            "path, such as usdsmoke."
        )
    styles = [
        _path(f"Style{n + 1}", "FILE", "IN", "An image to take the style from.")
        for n in range(n_styles)
    ]
    return [
        _path("Stage", "FILE", "IN", "The USD stage; only read."),
        *styles,
        # INOUT: a job that is sent again finds what the first one finished.
        _path("Output", "DIRECTORY", "INOUT", "The result's folder, the same for every task."),
        _path("Settings", "FILE", "IN", "Settings, as written by 'usdsmoke submit'."),
        _path("Overrides", "FILE", "IN", "Settings that override a Volume's own request."),
        {
            "name": "Command",
            "type": "STRING",
            "description": "The program, by its name or path on the machines of the queue.",
            "default": command,
            "minLength": 1,
        },
    ]


def _path(name: str, object_type: str, data_flow: str, description: str) -> dict[str, Any]:
    return {
        "name": name,
        "type": "PATH",
        "objectType": object_type,
        "dataFlow": data_flow,
        "description": description,
        "minLength": 1,
    }


def _step(name: str, arguments: Sequence[str], memory_gib: float) -> dict[str, Any]:
    memory = {"name": "amount.worker.memory", "min": math.ceil(memory_gib * 1024)}  # MiB
    run = {
        "command": "{{Param.Command}}",
        "args": list(arguments),
        "cancelation": {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": _NOTICE_S},
    }
    return {
        "name": name,
        "hostRequirements": {"amounts": [memory]},
        "script": {"actions": {"onRun": run}},
    }


def _job_name(name: str) -> str:
    printable = "".join(letter for letter in name if letter.isprintable())
    return f"usdsmoke {re.sub('[{}]', '', printable)}".strip()[:_LONGEST_NAME]


@dataclass(frozen=True)
class JobBundle:
    """What a queue needs, on disk."""

    template: Path
    files: tuple[Path, ...]  # beside the template: settings, parameter values, asset references
    parameters: Mapping[str, str]  # values of the template's parameters
    n_windows: int
    plan: Plan  # with notes on what the output folder holds


def submit(
    request: Request, template: FilePath | None = None, command: str = "usdsmoke"
) -> JobBundle:
    """Plan a run and write it as an Open Job Description; nothing is stylized or sent.

    Equal arguments give equal files. The template fits the stage as it is now: write it again
    when frames come or go.

    Args:
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
    request = request.with_config(_with_absolute_files(request.config)).settled()
    job = prepare_job(request, fits=False)
    check_visibility(job.plan.volumes)
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
    growth, layer = find_growth(job), job.config.layer
    memory = (growth.job.plan if growth else job.plan).estimate.memory_gib
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
    planned = plan_request(request, fits=False)
    return JobBundle(target, tuple(beside.values()), parameters, n_windows, planned)


def _check_program(command: str) -> None:
    """A queue starts a program with arguments; it does not parse a shell command."""
    if len(command.split()) > 1 and not Path(command).is_file():
        raise ConfigError(
            f"--command takes one program without arguments, got {command!r}. Put the call into "
            f'an executable script:\n  #!/bin/sh\n  exec {command} "$@"'
        )


def _with_absolute_files(config: Config) -> Config:
    """The paths of files absolute: the queue's machines look up none of their own."""
    features, optimize = config.features, config.optimize
    if file := features.vgg19_file:
        features = features.replace(vgg19_file=str(Path(file).absolute()))
    if file := optimize.start_file:
        optimize = optimize.replace(start=str(Path(file).absolute()))
    return config.replace(features=features, optimize=optimize)


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
        publish_file(file_path, text)
