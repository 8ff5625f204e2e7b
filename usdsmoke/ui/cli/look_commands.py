"""The commands that read and write nothing: inspect, validate, plugin-path, settings."""

import argparse
import os
from dataclasses import asdict

from usdsmoke.base.resolve import settings_yaml
from usdsmoke.base.settings import Config
from usdsmoke.ui.cli.arguments import given_settings
from usdsmoke.ui.cli.text import inspection_text, print_json, validation_text


def run_inspect(arguments: argparse.Namespace) -> int:
    """``usdsmoke inspect``; the exit code, 1 where there are problems."""
    from usdsmoke.usd.inspect import inspect

    settings = given_settings(arguments)
    prims, frames = arguments.prim, arguments.frames or ""
    found = inspect(arguments.stage, prims, frames, arguments.style, settings)
    if arguments.json:
        print_json(found)
    else:
        print(inspection_text(found))
    return 1 if found["problems"] else 0


def run_validate(arguments: argparse.Namespace) -> int:
    """``usdsmoke validate``; the exit code, 1 where there are errors."""
    from usdsmoke.usd.rules import Severity, validate

    findings = validate(arguments.stage)
    n_errors = sum(finding.severity == Severity.ERROR for finding in findings)
    if arguments.json:
        print_json({"errors": n_errors, "findings": [asdict(finding) for finding in findings]})
    else:
        print(validation_text(arguments.stage, findings))
    return 1 if n_errors else 0


def run_plugin_path(arguments: argparse.Namespace) -> int:
    """``usdsmoke plugin-path``, as PXR_PLUGINPATH_NAME takes it; the exit code."""
    from usdsmoke.ui import usdview
    from usdsmoke.usd import schema

    folders = {"schema": str(schema.PLUGIN_FOLDER), "usdview": str(usdview.PLUGIN_FOLDER)}
    if arguments.json:
        print_json(folders)
    else:
        print(os.pathsep.join(folders.values()))
    return 0


def run_settings(arguments: argparse.Namespace) -> int:
    """``usdsmoke settings``; the exit code."""
    if arguments.json:
        print_json(Config().model_dump())
    else:
        print(settings_yaml(Config()), end="")
    return 0
