"""All commands but those in ``work_commands`` and ``preview_command``."""

import argparse
import os
import sys
import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from usdsmoke.base.errors import count_text
from usdsmoke.base.machine import process_seconds
from usdsmoke.base.publish import publish_file
from usdsmoke.config.presets import preset_file
from usdsmoke.config.resolve import Settings, resolve_config, settings_yaml
from usdsmoke.config.settings import Config
from usdsmoke.ui.cli.options import given_settings
from usdsmoke.ui.cli.plan_text import plan_text
from usdsmoke.ui.cli.record_text import provenance_text, rerun_text, verification_text
from usdsmoke.ui.cli.text import (
    LINE_EVERY,
    inspection_text,
    print_json,
    show,
    source_stage_text,
    validation_text,
)
from usdsmoke.ui.cli.work_commands import end_text, result_as_dict

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

    from usdsmoke.usd.rules import Finding
    from usdsmoke.work_precision import ReportResult


def run_inspect(arguments: argparse.Namespace) -> int:
    """``usdsmoke inspect``; the exit code, 1 where there are problems."""
    from usdsmoke.usd.inspect import inspect

    settings = given_settings(arguments)
    prims, frames = arguments.prim, arguments.frames or ""
    found = inspect(arguments.stage, prims, frames, arguments.style, settings)
    show(arguments, lambda: found, lambda: inspection_text(found))
    return 1 if found["problems"] else 0


def run_stage(arguments: argparse.Namespace) -> int:
    """``usdsmoke stage``; the exit code."""
    from usdsmoke.usd.source_stage import write_source_stage

    made = write_source_stage(
        arguments.pattern,
        arguments.output,
        arguments.meters_per_unit,
        arguments.up_axis,
        arguments.fps,
    )
    result = {**asdict(made), "file": str(made.file)}
    show(arguments, lambda: result, lambda: source_stage_text(made))
    return 0


def run_validate(arguments: argparse.Namespace) -> int:
    """``usdsmoke validate``; the exit code, 1 where a finding fails."""
    from usdsmoke.usd.gate import fails, junit_xml, short_looks, validate_look, write_mends
    from usdsmoke.usd.rules import check_rules, validate

    check_rules(arguments.ignore)
    if arguments.mend:
        mended = write_mends(Path(arguments.stage), Path(arguments.mend))
        for item in mended:
            print(f"mended: {item.rule}: <{item.prim_path}>: {item.message}", file=sys.stderr)
        print(f"mended: {count_text(len(mended), 'finding')}", file=sys.stderr)
        arguments.stage = arguments.mend if mended else arguments.stage
    of_source: list[Finding] = []
    if arguments.look_only:
        findings, of_source = validate_look(arguments.stage)
    else:
        findings = validate(arguments.stage)
        findings = [*short_looks(arguments.stage), *findings]  # errors: they come first
    ignored = Counter(item.rule for item in findings if item.rule in arguments.ignore)
    findings = [finding for finding in findings if finding.rule not in arguments.ignore]
    if arguments.junit:
        text = junit_xml(Path(arguments.stage).name, findings, arguments.strict, ignored)
        publish_file(Path(arguments.junit), lambda path: path.write_text(text, encoding="utf-8"))
    n_failed = sum(fails(finding, arguments.strict) for finding in findings)
    result = {
        "errors": n_failed,
        "findings": [asdict(finding) for finding in findings],
        "ignored": dict(ignored),
    }
    if arguments.look_only:
        result["of_source"] = [asdict(finding) for finding in of_source]
    show(
        arguments,
        lambda: result,
        lambda: validation_text(arguments.stage, findings, of_source, ignored, arguments.verbose),
    )
    return 1 if n_failed else 0


def run_plugin_path(arguments: argparse.Namespace) -> int:
    """``usdsmoke plugin-path``, as PXR_PLUGINPATH_NAME takes it; the exit code."""
    from usdsmoke.ui import usdview
    from usdsmoke.usd import schema

    folders = {"schema": str(schema.PLUGIN_FOLDER), "usdview": str(usdview.PLUGIN_FOLDER)}
    show(arguments, lambda: folders, lambda: os.pathsep.join(folders.values()))
    return 0


def run_settings(arguments: argparse.Namespace) -> int:
    """``usdsmoke settings``; the exit code."""
    config = Config()
    if arguments.preset:
        file_path = preset_file(arguments.preset)
        config, text = resolve_config(file_path), file_path.read_text(encoding="utf-8")
    else:
        text = settings_yaml(config)
    show(arguments, config.model_dump, lambda: text.removesuffix("\n"))
    return 0


def run_report(arguments: argparse.Namespace) -> int:
    """``usdsmoke report``; the exit code."""
    from rich.console import Console
    from rich.progress import Progress

    from usdsmoke.work_precision import make_report, report_as_dict

    settings = given_settings(arguments)
    if arguments.final:
        return _run_final(arguments, settings)
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        result = make_report(
            arguments.stage,
            arguments.style,
            arguments.output,
            settings,
            arguments.budget,
            _Teller(console, bar),
        )
    files = [str(file_path) for file_path in result.files]
    show(
        arguments,
        lambda: {"page": str(result.page), "files": files, **report_as_dict(result.report)},
        lambda: _report_text(result),
    )
    return 0


def _run_final(arguments: argparse.Namespace, settings: Settings) -> int:
    from usdsmoke.work_precision import check_final

    found, files = check_final(arguments.stage, arguments.style, arguments.output, settings)
    show(
        arguments,
        lambda: {**asdict(found), "files": [str(path) for path in files]},
        lambda: "\n".join(
            [
                str(files[0]),
                *(f"  {name}: style loss {loss:.4g}" for name, loss in found.loss.items()),
                f"  bounces add {found.bounces_add:.0%} to the light",
            ]
        ),
    )
    return 0


class _Teller:
    """A bar on a terminal, a line now and then elsewhere."""

    def __init__(self, console: "Console", bar: "Progress") -> None:
        self._console, self._bar = console, bar
        self._task: TaskID = bar.add_task("reading", total=1.0)
        self._last = -LINE_EVERY

    def __call__(self, sweep: str, point: str, share: float) -> None:
        text = f"{sweep}: {point}"
        self._bar.update(self._task, description=text, completed=share)
        now = time.monotonic()
        if not self._console.is_terminal and now - self._last >= LINE_EVERY:
            self._last = now
            self._console.print(f"{share:4.0%} {text}", markup=False, highlight=False)


def _report_text(result: "ReportResult") -> str:
    lines = [str(result.page)]
    for sweep in result.report.sweeps:
        lines.append(f"  {sweep.title}: {sweep.verdict}")
    for item in result.report.omissions:
        lines.append(f"  left out: {item.what}: {item.reason}")
    return "\n".join(lines)


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
        lambda: verification_text(arguments.file, changes, arguments.verbose),
    )
    return 0 if is_same else 1


def run_rerun(arguments: argparse.Namespace) -> int:
    """``usdsmoke rerun``; the exit code, 1 where the result differs from the recorded one."""
    from rich.console import Console

    from usdsmoke.audit import rerun
    from usdsmoke.ui.cli.progress_bar import ConsoleProgress

    arguments.starting = arguments.starting and process_seconds()  # with the imports
    with ConsoleProgress(Console(stderr=True)) as progress:
        again = rerun(
            arguments.file,
            arguments.output,
            arguments.force,
            progress,
            lambda plan: progress.say(plan_text(plan, arguments.verbose)),
        )
    verbose, starting = arguments.verbose, arguments.starting
    same = {"as_recorded": not again.differences, "differences": list(again.differences)}
    show(
        arguments,
        lambda: result_as_dict(again.result) | {"record": str(again.record)} | same,
        lambda: "\n\n".join([end_text(again.result, verbose, starting), rerun_text(again)]),
    )
    return 1 if again.differences else 0
