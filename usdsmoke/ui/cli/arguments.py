"""What the command line takes; defaults and limits of settings come from the settings."""

import argparse
from dataclasses import fields
from functools import partial
from typing import Any

from usdsmoke import __version__
from usdsmoke.base.config import Config, LayerConfig, config_to_dict, merge_settings, read_config
from usdsmoke.ui.cli.record_arguments import add_record_commands
from usdsmoke.ui.cli.values import duration_value, repair_value, size_value

__all__ = ["build_parser", "given_settings"]

_EXIT_CODES = "exit codes: 0 ok, 1 a named error, 2 wrong usage, 130 stopped by Ctrl-C"


def build_parser() -> argparse.ArgumentParser:
    """The parser of ``usdsmoke`` with its subcommands."""
    parser = argparse.ArgumentParser(
        prog="usdsmoke",
        description="Stylize the smoke of a USD stage after an example image, as a new look layer.",
        epilog=_EXIT_CODES,
    )
    parser.add_argument("--version", action="version", version=f"usdsmoke {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_inspect(commands)
    _add_stylize(commands)
    _add_submit(commands)
    assemble = _add_command(commands, "assemble", "make the result of windows run one by one")
    assemble.add_argument("output", metavar="OUT", help="the folder that they were written to")
    _add_layer(assemble)
    validate = _add_command(commands, "validate", "check a stage or layer, its files and grids")
    validate.add_argument("stage", metavar="STAGE_OR_LAYER", help="a USD file")
    _add_command(commands, "plugin-path", "print where usdview and USD find usdsmoke's plug-ins")
    _add_preview(commands)
    _add_report(commands)
    add_record_commands(partial(_add_command, commands))
    _add_command(commands, "settings", "print every setting with its meaning, as a YAML file")
    return parser


def given_settings(arguments: argparse.Namespace) -> tuple[dict[str, Any], dict[str, Any]]:
    """The sections of the configuration, and those of all options that stand for settings.

    Raises:
        ConfigError: a file or an option cannot be read.
    """
    config = read_config(arguments.config) if arguments.config else {}
    overrides = read_config(arguments.overrides) if arguments.overrides else {}
    options = _options_as_sections(arguments)
    return config, merge_settings(overrides, options, assignments=arguments.set)


def _options_as_sections(arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Of commands that have some of them only, these."""
    given = vars(arguments)
    options = {
        "stage": {
            "prims": given.get("prim"),
            "frames": given.get("frames"),
            "restylize": given.get("restylize"),
        },
        "grids": {"half": given.get("half"), "repair_nan": given.get("repair")},
        "views": {"camera": given.get("camera")},
        "optimize": {"seed": given.get("seed"), "target_error": given.get("tolerance")},
        "layer": {
            "mode": given.get("mode"),
            "look": given.get("look"),
            "emission_mode": given.get("emission_mode"),
            "scatter_colour": given.get("alias_cd"),
            "split_rgb": given.get("split_rgb"),
        },
    }
    return {
        section: {key: value for key, value in settings.items() if value is not None}
        for section, settings in options.items()
    }


def _add_command(commands: Any, name: str, summary: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=summary, description=summary.capitalize() + ".", epilog=_EXIT_CODES
    )
    parser.add_argument("--json", action="store_true", help="print one JSON value on stdout")
    parser.add_argument("--verbose", action="store_true", help="show where an error comes from")
    return parser


def _add_selection(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--prim", action="append", metavar="PATH", help="a Volume; may be repeated; default: all"
    )
    parser.add_argument("--frames", metavar="1-24", help="timeCodes: 1-24, 1,5,9, 1-24x2")


def _add_layer(parser: argparse.ArgumentParser) -> None:
    limits = {item.name: item.metadata for item in fields(LayerConfig)}
    parser.add_argument(
        "--mode",
        choices=limits["mode"]["choices"],
        help="what to write: a root stage with the look over the source (sublayer, the default), "
        "an asset with a variant for each look (reference), or the look layer alone (layer)",
    )
    parser.add_argument(
        "--look", metavar="NAME", help="the look's name; looks of other names stay beside it"
    )


def _add_inspect(commands: Any) -> None:
    parser = _add_command(commands, "inspect", "show volumes, fields, files, frames and grids")
    parser.add_argument("stage", metavar="STAGE", help="a USD file")
    _add_selection(parser)
    _add_style(parser)
    _add_settings(parser)


def _add_stylize(commands: Any) -> None:
    parser = _add_command(commands, "stylize", "stylize the smoke of a stage")
    _add_run(parser)
    part = parser.add_mutually_exclusive_group()
    part.add_argument(
        "--coarse", action="store_true", help="do only the step that all windows share"
    )
    part.add_argument(
        "--window",
        type=int,
        metavar="K",
        help="do only this window, from 0; the plan lists them; 'usdsmoke assemble OUT' comes last",
    )
    part.add_argument(
        "--cluster",
        metavar="tcp://HOST:PORT",
        help="let the workers of this Dask scheduler do the windows",
    )
    parser.add_argument("--dry-run", action="store_true", help="print the plan and write nothing")
    parser.add_argument(
        "--force", action="store_true", help="replace a result, or give up an unfinished run"
    )


def _add_submit(commands: Any) -> None:
    parser = _add_command(commands, "submit", "write a run as a job for a render queue")
    _add_run(parser)
    parser.add_argument(
        "--template",
        metavar="FILE.yaml",
        help="the job template (Open Job Description) to write; default: OUT/job/template.yaml",
    )
    parser.add_argument(
        "--command",
        dest="program",
        default="usdsmoke",
        metavar="PROGRAM",
        help="what the machines of the queue start: one program, by name or path, without "
        "arguments; default: usdsmoke",
    )


def _add_preview(commands: Any) -> None:
    parser = _add_command(commands, "preview", "draw the smoke of a stage, looks included")
    parser.add_argument("stage", metavar="STAGE", help="a USD file; of a look its root stage")
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FILE",
        help=".png: a picture, or a contact sheet of several; .exr: scene-linear, a file a frame",
    )
    _add_selection(parser)
    parser.add_argument(
        "--camera", default="", metavar="PATH", help="a Camera prim; default: a fitted front view"
    )
    parser.add_argument(
        "--compare", action="store_true", help="draw the stage without its look as well"
    )
    parser.add_argument("--width", type=int, metavar="N", help="pixels; default: 512 at most")
    parser.add_argument("--size", type=size_value, metavar="WxH", help="pixels each way")
    parser.add_argument(
        "--background",
        choices=("grey", "black", "none"),
        default="grey",
        help="of a PNG; none: transparent, for one picture",
    )


def _add_report(commands: Any) -> None:
    parser = _add_command(commands, "report", "measure what a scene's choices gain and cost")
    parser.add_argument("stage", metavar="STAGE", help="a USD file")
    parser.add_argument(
        "-o", "--output", required=True, metavar="DIR", help="the folder of the report"
    )
    _add_selection(parser)
    _add_style(parser)
    _add_settings(parser)
    parser.add_argument(
        "--budget",
        default="5min",
        type=duration_value,
        metavar="TIME",
        help="how long to measure: 300s, 5min, 1h30m; what does not fit is named; default: 5min",
    )


def _add_run(parser: argparse.ArgumentParser) -> None:
    """What a run is made of."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = f"{_EXIT_CODES}\n\n{_settings_summary()}"
    parser.add_argument("stage", metavar="STAGE", help="a USD file")
    _add_style(parser)
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="the result's folder")
    _add_selection(parser)
    _add_layer(parser)
    parser.add_argument(
        "--restylize",
        action="store_const",
        const=True,
        help="take smoke that is stylized already as the source, not the original",
    )
    _add_settings(parser)
    parser.add_argument("--half", action="store_const", const=True, help="write 16-bit floats")
    _add_client_options(parser)
    parser.add_argument(
        "--repair",
        type=repair_value,
        metavar="nan=0",
        help="put a number in the place of NaN and infinite voxels, which are refused otherwise",
    )


def _add_style(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--style",
        action="append",
        metavar="IMAGE",
        help="an image to take the style from; may be repeated; default: the Volumes' own",
    )


def _add_settings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config",
        metavar="FILE.yaml",
        help="settings, weaker than what a Volume asks for itself; see 'usdsmoke settings'",
    )
    parser.add_argument(
        "--overrides",
        metavar="FILE.yaml",
        help="settings, stronger than what a Volume asks for itself, as all options are",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="one setting, such as windows.size=3; may be repeated; stronger than all others",
    )
    parser.add_argument(
        "--camera",
        metavar="PATH",
        help="the shot's Camera prim: only what it sees is stylized, seen from its direction",
    )
    parser.add_argument("--seed", type=int, metavar="N", help="the same as --set optimize.seed=N")
    parser.add_argument(
        "--tolerance",
        type=float,
        metavar="E",
        help="choose the cheapest settings whose estimated errors stay below this, such as 0.05",
    )


def _add_client_options(parser: argparse.ArgumentParser) -> None:
    """What particular renderers want; docs/clients.md says which."""
    parser.add_argument(
        "--alias-cd",
        action="store_const",
        const=["Cd"],
        help="the same as --set layer.scatter_colour=Cd",
    )
    parser.add_argument(
        "--split-rgb",
        action="store_const",
        const=True,
        help="write colours as three grids of floats too",
    )
    parser.add_argument(
        "--emission-mode",
        choices=("absolute", "perDensity"),
        help="perDensity is for renderers that multiply emission by density",
    )


def _settings_summary() -> str:
    lines = ["settings for --set and --config (usdsmoke settings explains them):"]
    for section, settings in config_to_dict(Config()).items():
        lines.append(f"  {section}: {', '.join(settings)}")
    return "\n".join(lines)
