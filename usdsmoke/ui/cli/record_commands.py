"""The commands that go by a result's own record: ``provenance``, ``verify``, ``rerun``."""

import argparse
from dataclasses import asdict

from usdsmoke.ui.cli.record_text import provenance_text, rerun_text, verification_text
from usdsmoke.ui.cli.text import plan_text, print_json, result_text, show
from usdsmoke.ui.cli.work_commands import result_as_dict


def run_provenance(arguments: argparse.Namespace) -> int:
    """``usdsmoke provenance``; the exit code."""
    from usdsmoke.audit import prov_document, provenance

    found = provenance(arguments.file)
    if arguments.prov:
        print_json(prov_document(found))
        return 0
    show(
        arguments,
        lambda: {"records": [item.to_dict() for item in found]},
        lambda: "\n\n".join(map(provenance_text, found)),
    )
    return 0


def run_verify(arguments: argparse.Namespace) -> int:
    """``usdsmoke verify``; the exit code, 1 where something has changed."""
    from usdsmoke.audit import verify

    changes = verify(arguments.file)
    is_same = all(change.severity == "note" for change in changes)
    show(
        arguments,
        lambda: {"as_recorded": is_same, "changes": [asdict(change) for change in changes]},
        lambda: verification_text(arguments.file, changes),
    )
    return 0 if is_same else 1


def run_rerun(arguments: argparse.Namespace) -> int:
    """``usdsmoke rerun``; the exit code, 1 where the result differs from the recorded one."""
    from rich.console import Console

    from usdsmoke.audit import rerun
    from usdsmoke.ui.cli.progress_bar import ConsoleProgress

    with ConsoleProgress(Console(stderr=True)) as progress:
        again = rerun(
            arguments.file,
            arguments.output,
            arguments.force,
            progress,
            lambda plan: progress.say(plan_text(plan)),
        )
        for warning in again.result.warnings:
            progress.say(f"note: {warning}")
    same = {"as_recorded": not again.differences, "differences": list(again.differences)}
    show(
        arguments,
        lambda: result_as_dict(again.result) | {"record": str(again.record)} | same,
        lambda: f"{result_text(again.result)}\n\n{rerun_text(again)}",
    )
    return 1 if again.differences else 0
