"""The command ``usdsmoke``: arguments in, one call of the package, results out.

Results go to stdout, progress and messages to stderr. Exit codes: 0 ok, 1 a named error (or, for
``inspect`` and ``validate``, a problem that was found), 2 wrong usage, 128 + n when stopped by
signal n: 130 after Ctrl-C, 143 after a polite kill, 141 when nobody reads stdout any more.

With ``--json`` stdout holds exactly one JSON value, whatever happens: the result, or
``{"error": {"type": ..., "message": ...}}``.
"""

import argparse
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeVar

from usdsmoke.cli_arguments import build_parser, options_as_sections
from usdsmoke.cli_text import (
    inspection_text,
    job_text,
    plan_text,
    result_text,
    step_text,
    validation_text,
)
from usdsmoke.config import Config, config_to_dict, config_to_yaml, read_config, resolve_config
from usdsmoke.errors import Interrupted, UsdSmokeError

if TYPE_CHECKING:
    from usdsmoke.pipeline import StepResult, StylizeResult

__all__ = ["main"]

_BROKEN_PIPE = 128 + 13
_Result = TypeVar("_Result")


class _Stopped(KeyboardInterrupt):
    """A signal that asks the process to end."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code.

    Args:
        argv: arguments without the program's name; None takes the process's own.
    """
    arguments = build_parser().parse_args(argv)
    commands: dict[str, Callable[[argparse.Namespace], int]] = {
        "inspect": _inspect,
        "stylize": _stylize,
        "submit": _submit,
        "assemble": _assemble,
        "validate": _validate,
        "settings": _settings,
    }
    try:
        with _signals_as_exceptions() as seen:
            code = _run(commands[arguments.command], arguments, seen)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # Whatever is flushed when the interpreter ends must not complain again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE


def _run(
    command: Callable[[argparse.Namespace], int], arguments: argparse.Namespace, seen: list[int]
) -> int:
    """Run a command and turn its errors into messages and exit codes."""
    try:
        return command(arguments)
    except BrokenPipeError:
        raise
    except (UsdSmokeError, KeyboardInterrupt, MemoryError) as error:
        _report(error, arguments)
        stopped = isinstance(error, (Interrupted, KeyboardInterrupt))
        return 128 + (seen[-1] if seen else signal.SIGINT) if stopped else 1
    except Exception as error:
        _report(error, arguments)
        return 1


@contextmanager
def _signals_as_exceptions() -> Iterator[list[int]]:
    """SIGINT and SIGTERM end the work from inside, so that it can tidy up; yields those seen."""
    seen: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        raise _Stopped

    try:
        before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:  # not the main thread: signals are somebody else's business
        yield seen
        return
    try:
        yield seen
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _report(error: BaseException, arguments: argparse.Namespace) -> None:
    """The message on stderr, as JSON on stdout too where it is asked for."""
    if arguments.verbose:
        traceback.print_exception(error)
    kind, message = type(error).__name__, str(error)
    if isinstance(error, KeyboardInterrupt):
        kind, message = Interrupted.__name__, "stopped; nothing was left behind"
    elif isinstance(error, MemoryError):
        message = "out of memory; lower views.pool, views.image_size or grids.refine"
    elif not isinstance(error, UsdSmokeError):
        message = f"unexpected {kind}: {message}; --verbose shows where. Please report this"
    print(f"usdsmoke: {message}", file=sys.stderr)
    if arguments.json:
        _print_json({"error": {"type": kind, "message": message}})


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False))


def _inspect(arguments: argparse.Namespace) -> int:
    from usdsmoke.inspection import inspect

    found = inspect(arguments.stage, arguments.prim, arguments.frames or "")
    if arguments.json:
        _print_json(found)
    else:
        print(inspection_text(found))
    return 1 if found["problems"] else 0


def _stylize(arguments: argparse.Namespace) -> int:
    from usdsmoke.pipeline import plan_stylize

    config = _config(arguments)
    if arguments.dry_run:
        plan = plan_stylize(arguments.stage, arguments.style, arguments.output, config)
        if arguments.json:
            _print_json(plan.to_dict() | {"config": config_to_dict(config)})
        else:
            print(plan_text(plan))
        return 0
    if arguments.coarse or arguments.window is not None:
        step = _with_progress(_step_call(arguments), arguments, config)
        if arguments.json:
            _print_json(_step_as_dict(step))
        else:
            print(step_text(step))
        return 0
    _show_result(_with_progress(_whole_call(arguments), arguments, config), arguments)
    return 0


def _whole_call(arguments: argparse.Namespace) -> Callable[..., "StylizeResult"]:
    """What does a whole run: this process or a cluster."""
    if arguments.cluster is not None:
        from usdsmoke.cluster import stylize_on_cluster

        return partial(stylize_on_cluster, arguments.cluster)
    from usdsmoke.pipeline import stylize

    return stylize


def _step_call(arguments: argparse.Namespace) -> Callable[..., "StepResult"]:
    """What does a part of a run: one window or the coarse step."""
    from usdsmoke.pipeline import run_coarse, run_window

    return run_coarse if arguments.coarse else partial(run_window, window=arguments.window)


def _config(arguments: argparse.Namespace) -> Config:
    sections = read_config(arguments.config) if arguments.config else {}
    return resolve_config(sections, options_as_sections(arguments), assignments=arguments.set)


def _with_progress(
    call: Callable[..., _Result], arguments: argparse.Namespace, config: Config
) -> _Result:
    """Call ``stylize`` or a part of it, telling the plan and the progress on stderr."""
    from rich.console import Console

    from usdsmoke.progress import ConsoleProgress

    with ConsoleProgress(Console(stderr=True)) as progress:
        result = call(
            stage=arguments.stage,
            style=arguments.style,
            output=arguments.output,
            config=config,
            force=arguments.force,
            progress=progress,
            planned=lambda plan: progress.say(plan_text(plan)),
        )
        for warning in getattr(result, "warnings", ()):
            progress.say(f"note: {warning}")
    return result


def _submit(arguments: argparse.Namespace) -> int:
    from usdsmoke.pipeline_submit import submit

    bundle = submit(
        arguments.stage,
        arguments.style,
        arguments.output,
        _config(arguments),
        template=arguments.template,
        command=arguments.program,
    )
    if arguments.json:
        _print_json(
            {
                "template": str(bundle.template),
                "files": [str(file_path) for file_path in bundle.files],
                "parameters": dict(bundle.parameters),
                "n_windows": bundle.n_windows,
            }
        )
    else:
        print(job_text(bundle))
    return 0


def _assemble(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from usdsmoke.pipeline import assemble
    from usdsmoke.progress import ConsoleProgress

    with ConsoleProgress(Console(stderr=True)) as progress:
        result = assemble(arguments.output, progress)
        for warning in result.warnings:
            progress.say(f"note: {warning}")
    _show_result(result, arguments)
    return 0


def _show_result(result: "StylizeResult", arguments: argparse.Namespace) -> None:
    if arguments.json:
        _print_json(_result_as_dict(result))
    else:
        print(result_text(result))


def _step_as_dict(step: "StepResult") -> dict[str, Any]:
    manifest = str(step.manifest) if step.manifest.is_file() else None
    return {"folder": str(step.folder), "manifest": manifest, "was_done": step.was_done}


def _result_as_dict(result: "StylizeResult") -> dict[str, Any]:
    return {
        "root_stage": str(result.root_stage),
        "look_layer": str(result.look_layer),
        "frames": [str(file_path) for file_path in result.frames],
        "contact_sheets": [str(file_path) for file_path in result.contact_sheets],
        "warnings": list(result.warnings),
        "temporal_error": result.temporal_error,
        "overlap_difference": result.overlap_difference,
        "plan": result.plan.to_dict(),
    }


def _validate(arguments: argparse.Namespace) -> int:
    from usdsmoke.validators import Severity, validate

    findings = validate(arguments.stage)
    n_errors = sum(finding.severity == Severity.ERROR for finding in findings)
    if arguments.json:
        _print_json({"errors": n_errors, "findings": [asdict(finding) for finding in findings]})
    else:
        print(validation_text(arguments.stage, findings))
    return 1 if n_errors else 0


def _settings(arguments: argparse.Namespace) -> int:
    if arguments.json:
        _print_json(config_to_dict(Config()))
    else:
        print(config_to_yaml(Config()), end="")
    return 0
