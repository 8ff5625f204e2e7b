"""The commands of a job: ``stylize``, ``train``, ``submit``, ``assemble``."""

import argparse
import sys
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

from usdsmoke.base.errors import REFUSED
from usdsmoke.base.machine import process_seconds
from usdsmoke.ui.cli.budget_text import budget_text
from usdsmoke.ui.cli.options import given_settings
from usdsmoke.ui.cli.plan_text import plan_text
from usdsmoke.ui.cli.text import (
    job_text,
    result_text,
    show,
    task_text,
    training_plan_text,
    training_text,
)

if TYPE_CHECKING:
    from usdsmoke.pipeline import Request, StylizeResult, TaskResult
    from usdsmoke.planning.plan import Plan
    from usdsmoke.ui.cli.progress_bar import ConsoleProgress

_Result = TypeVar("_Result")


def run_stylize(arguments: argparse.Namespace) -> int:
    """``usdsmoke stylize``; the exit code."""
    if arguments.dry_run:
        from usdsmoke.farm import choose_jobs, with_jobs
        from usdsmoke.pipeline import plan_request

        whole, elsewhere = not arguments.coarse and arguments.window is None, arguments.cluster
        plan = plan_request(_request(arguments), fits=elsewhere is None, whole=whole)
        if whole and elsewhere is None:
            plan = with_jobs(plan, min(arguments.jobs or choose_jobs(plan), len(plan.tasks)))
        if arguments.window is not None:
            plan.task(arguments.window)  # raises where there is no such window
        show(
            arguments,
            lambda: plan.to_dict() | {"config": plan.config.model_dump()},
            lambda: plan_text(plan, arguments.verbose),
        )
        return 1 if any(note.startswith(REFUSED) for note in plan.notes) else 0
    if arguments.coarse or arguments.window is not None:
        task = _with_progress(_run_task, arguments)
        for warning in task.warnings:
            print(f"note: {warning}", file=sys.stderr)
        show(arguments, lambda: _task_as_dict(task), lambda: task_text(task))
        return 0
    _show_result(_with_progress(_run_whole, arguments), arguments)
    return 0


def run_train(arguments: argparse.Namespace) -> int:
    """``usdsmoke train``; the exit code."""
    from rich.console import Console

    from usdsmoke.runs.train import plan_training, train
    from usdsmoke.ui.cli.progress_bar import ConsoleProgress

    asked = (
        arguments.stage,
        arguments.style,
        arguments.output,
        given_settings(arguments),
        arguments.iterations,
    )
    if arguments.dry_run:
        plan = plan_training(*asked)
        show(arguments, lambda: asdict(plan), lambda: training_plan_text(plan))
        return 0
    with ConsoleProgress(Console(stderr=True)) as progress:
        result = train(*asked, progress, lambda plan: progress.say(training_plan_text(plan)))
    show(
        arguments,
        lambda: asdict(result) | {"file": str(result.file)},
        lambda: training_text(result),
    )
    return 0


def run_submit(arguments: argparse.Namespace) -> int:
    """``usdsmoke submit``; the exit code."""
    from usdsmoke.farm import submit

    bundle = submit(_request(arguments), arguments.template, arguments.program)
    described = {
        "template": str(bundle.template),
        "files": [str(file_path) for file_path in bundle.files],
        "parameters": dict(bundle.parameters),
        "n_windows": bundle.n_windows,
        "plan": bundle.plan.to_dict(),
    }
    print(plan_text(bundle.plan, arguments.verbose), file=sys.stderr)
    show(arguments, lambda: described, lambda: job_text(bundle))
    return 0


def run_assemble(arguments: argparse.Namespace) -> int:
    """``usdsmoke assemble``; the exit code."""
    from rich.console import Console

    from usdsmoke.pipeline import assemble
    from usdsmoke.ui.cli.progress_bar import ConsoleProgress

    with ConsoleProgress(Console(stderr=True)) as progress:
        result = assemble(arguments.output, progress, arguments.look, arguments.mode)
    _show_result(result, arguments)
    return 0


def _request(arguments: argparse.Namespace) -> "Request":
    """What the options ask for; those beside ``--config`` are stronger than a Volume's own."""
    from usdsmoke.pipeline import Request

    force, settings = bool(getattr(arguments, "force", False)), given_settings(arguments)
    return Request(arguments.stage, arguments.style, arguments.output, settings, force)


def _run_whole(
    arguments: argparse.Namespace, progress: "ConsoleProgress", planned: "Callable[[Plan], None]"
) -> "StylizeResult":
    """A whole run: in this process or on a cluster."""
    request = _request(arguments)
    if arguments.cluster is not None:
        from usdsmoke.farm import stylize_on_cluster

        return stylize_on_cluster(arguments.cluster, request, progress, planned)
    from usdsmoke.farm import stylize_in_processes

    arguments.starting = arguments.starting and process_seconds()  # with the imports
    return stylize_in_processes(arguments.jobs, request, progress, planned)


def _run_task(
    arguments: argparse.Namespace, progress: "ConsoleProgress", planned: "Callable[[Plan], None]"
) -> "TaskResult":
    """One task of a run: a window or the coarse step."""
    from usdsmoke.pipeline import run_coarse, run_window

    request = _request(arguments)
    if arguments.coarse:
        return run_coarse(request, progress, planned)
    return run_window(request, arguments.window, progress, planned)


def _with_progress(call: Callable[..., _Result], arguments: argparse.Namespace) -> _Result:
    """Call ``stylize`` or one task of it; the plan and the progress are shown on stderr."""
    from rich.console import Console

    from usdsmoke.ui.cli.progress_bar import ConsoleProgress

    with ConsoleProgress(Console(stderr=True)) as progress:

        def say_plan(plan: "Plan") -> None:
            progress.say(plan_text(plan, arguments.verbose))

        return call(arguments, progress, say_plan)


def _show_result(result: "StylizeResult", arguments: argparse.Namespace) -> None:
    if arguments.json:  # for the log; the text ends with them
        for text in result.warnings:
            print(f"note: {text}", file=sys.stderr)
    verbose, starting = arguments.verbose, arguments.starting
    show(
        arguments,
        lambda: result_as_dict(result),
        lambda: end_text(result, verbose, starting),
    )


def end_text(result: "StylizeResult", everything: bool, starting: float = 0.0) -> str:
    """The end of a run: what keeps it from being seen, its files, and what to make of it.

    Args:
        everything, starting: see ``budget_text``.
    """
    warnings, budget = result.plan.warnings, result.error_budget
    notes = [text for text in result.warnings if text not in warnings]
    texts = ["\n".join(f"warning: {text}" for text in warnings)] if warnings else []
    texts.append(result_text(result))
    if budget is not None:
        omitted = result.plan.omitted
        texts.append(budget_text(budget, result.seconds, omitted, everything, starting))
    if notes:
        texts.append("\n".join(f"note: {text}" for text in notes))
    return "\n\n".join(texts)


def _task_as_dict(task: "TaskResult") -> dict[str, Any]:
    manifest = str(task.manifest) if task.manifest.is_file() else None
    return {
        "folder": str(task.folder),
        "manifest": manifest,
        "was_done": task.was_done,
        "warnings": list(task.warnings),
    }


def result_as_dict(result: "StylizeResult") -> dict[str, Any]:
    """A result as plain values."""
    budget = result.error_budget
    return {
        "root_stage": str(result.root_stage) if result.root_stage else None,
        "look_layer": str(result.look_layer),
        "frames": [str(file_path) for file_path in result.frames],
        "contact_sheets": [str(file_path) for file_path in result.contact_sheets],
        "warnings": list(result.warnings),
        "temporal_error": result.temporal_error,
        "overlap_difference": result.overlap_difference,
        "verdicts": [asdict(item) for item in budget.verdicts] if budget else [],
        "error_budget": budget.to_json() if budget else None,
        "seconds": result.seconds,
        "plan": result.plan.to_dict(),
    }
