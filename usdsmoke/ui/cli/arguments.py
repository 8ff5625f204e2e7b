"""The arguments of each command. Defaults and limits of settings come from the settings."""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

from usdsmoke import __version__
from usdsmoke.base.errors import ConfigError
from usdsmoke.base.presets import PRESETS, preset_file
from usdsmoke.base.resolve import GivenSettings, read_settings
from usdsmoke.base.setting_model import allowed_values
from usdsmoke.base.settings import SECTIONS, declared_settings
from usdsmoke.ui.cli.parser import SuggestingParser
from usdsmoke.ui.cli.record_arguments import add_record_commands
from usdsmoke.ui.cli.values import count_value, duration_value, repair_value, size_value

_OPTIONS = {  # that stand for a setting
    "--prim": "stage.prims",
    "--frames": "stage.frames",
    "--allow-missing": "stage.allow_missing",
    "--restylize": "stage.restylize",
    "--half": "grids.half",
    "--repair": "grids.repair_nan",
    "--camera": "views.camera",
    "--seed": "optimize.seed",
    "--tolerance": "optimize.target_error",
    "--mode": "layer.mode",
    "--look": "layer.look",
    "--emission-mode": "layer.emission_mode",
    "--alias-cd": "layer.scatter_colour",
    "--split-rgb": "layer.split_rgb",
}
_EXIT_CODES = (
    "exit codes: 0 ok, 1 an error, or a problem was found, 2 wrong usage, 130 stopped by Ctrl-C"
)


def build_parser() -> argparse.ArgumentParser:
    """The parser of ``usdsmoke`` with its subcommands."""
    parser = SuggestingParser(
        prog="usdsmoke",
        description="Stylize the smoke in a USD stage to match an example image. "
        "The result is a new layer.",
        epilog=_EXIT_CODES,
    )
    parser.add_argument("--version", action="version", version=f"usdsmoke {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_inspect(commands)
    _add_stage(commands)
    _add_stylize(commands)
    _add_submit(commands)
    assemble = _add_command(
        commands, "assemble", "combine windows that were run separately into one result"
    )
    assemble.add_argument(
        "output", metavar="OUT", help="the output folder that the windows were run with"
    )
    _add_layer(assemble)
    validate = _add_command(commands, "validate", "check a stage or layer, and its files and grids")
    validate.add_argument("stage", metavar="STAGE_OR_LAYER", help="a USD file")
    validate.add_argument(
        "--look-only",
        action="store_true",
        help="count only what the look is to blame for; list the findings of its source apart",
    )
    validate.add_argument(
        "--ignore",
        action="append",
        default=[],
        metavar="RULE",
        help="leave out the findings of this rule, named as it is printed; may be repeated",
    )
    validate.add_argument(
        "--junit", metavar="FILE.xml", help="also write the findings as JUnit XML"
    )
    _add_command(
        commands, "plugin-path", "print the folders of usdsmoke's USD and usdview plug-ins"
    )
    _add_preview(commands)
    _add_report(commands)
    add_record_commands(partial(_add_command, commands))
    settings = _add_command(commands, "settings", "print all settings with their meanings, as YAML")
    _add_preset(settings, "print this preset's settings file instead")
    return parser


def given_settings(arguments: argparse.Namespace) -> list[Path | GivenSettings]:
    """The files of ``--preset`` and ``--config``, and all other options; the strongest last.

    Raises:
        ConfigError: the file of ``--overrides`` or an option cannot be read.
    """
    files = [preset_file(arguments.preset)] if arguments.preset else []
    files += [Path(arguments.config)] if arguments.config else []
    overrides = read_settings(Path(arguments.overrides) if arguments.overrides else None)
    options = {
        option: vars(arguments).get(option.strip("-").replace("-", "_")) for option in _OPTIONS
    }
    given = {
        name: options[option] for option, name in _OPTIONS.items() if options[option] is not None
    }
    sources = {name: option for option, name in _OPTIONS.items()}
    for text in arguments.set:
        if "=" not in text:
            raise ConfigError(f"--set {text} has no '='. Write NAME=VALUE, such as windows.size=3.")
    texts = read_settings(arguments.set, "--set")
    return [*files, read_settings([overrides, GivenSettings(given, sources), texts])]


def _add_command(commands: Any, name: str, summary: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=summary,
        description=f"{summary[:1].upper()}{summary[1:]}.",
        epilog=_EXIT_CODES,
    )
    parser.set_defaults(parser=parser)
    parser.add_argument("--json", action="store_true", help="print one JSON value on stdout")
    what = "list everything in a plan; show the traceback of an error"
    parser.add_argument("--verbose", action="store_true", help=what)
    return parser


def _add_option(parser: argparse.ArgumentParser, option: str, **more: Any) -> None:
    """An option that stands for a setting; meaning and choices are the setting's."""
    name = _OPTIONS[option]
    field = declared_settings()[name]
    if words := allowed_values(field):
        more.setdefault("choices", words)
    parser.add_argument(option, help=f"{field.description} ({name})", **more)


def _add_flag(parser: argparse.ArgumentParser, option: str) -> None:
    _add_option(parser, option, action="store_const", const=True)


def _add_selection(parser: argparse.ArgumentParser, frames_help: str = "") -> None:
    parser.add_argument(
        "--prim",
        action="append",
        metavar="PATH",
        help="a Volume prim; may be repeated (default: all that are visible and no guides)",
    )
    if frames_help:
        parser.add_argument("--frames", metavar="1-24", help=frames_help)
    else:
        _add_option(parser, "--frames", metavar="1-24")
    _add_flag(parser, "--allow-missing")


def _add_layer(parser: argparse.ArgumentParser) -> None:
    _add_option(parser, "--mode")
    _add_option(parser, "--look", metavar="NAME")


def _add_inspect(commands: Any) -> None:
    parser = _add_command(
        commands, "inspect", "show the Volumes of a stage: fields, files, frames and grids"
    )
    parser.add_argument("stage", metavar="STAGE", help="a USD file")
    _add_selection(parser)
    _add_style(parser)
    _add_settings(parser)


def _add_stage(commands: Any) -> None:
    parser = _add_command(commands, "stage", "make a stage that shows bare VDB files")
    parser.add_argument(
        "pattern",
        metavar="FILES",
        help="a .vdb file, or a quoted pattern such as 'plume.####.vdb' or 'plume.$F4.vdb'",
    )
    parser.add_argument(
        "-o", "--output", required=True, metavar="STAGE", help="the USD file to write"
    )
    parser.add_argument(
        "--meters-per-unit",
        type=float,
        required=True,
        metavar="M",
        help="metres in one unit of the VDB files, such as 1 or 0.01",
    )
    parser.add_argument("--up-axis", choices=("Y", "Z"), default="Y", help="(default: Y)")
    parser.add_argument(
        "--fps", type=float, default=24.0, metavar="N", help="frames per second (default: 24)"
    )


def _add_stylize(commands: Any) -> None:
    parser = _add_command(commands, "stylize", "stylize the smoke of a stage")
    _add_run(parser)
    part = parser.add_mutually_exclusive_group()
    part.add_argument(
        "--coarse", action="store_true", help="run only the coarse step, which all windows share"
    )
    part.add_argument(
        "--window",
        type=int,
        metavar="K",
        help="run only window K (the first is 0; --dry-run lists all). After the last window, run "
        "'usdsmoke assemble'",
    )
    part.add_argument(
        "--cluster",
        metavar="tcp://HOST:PORT",
        help="run the windows on the workers of this Dask scheduler",
    )
    part.add_argument(
        "--jobs",
        type=count_value,
        default=1,
        metavar="N",
        help="compute N windows at once, in processes of this machine (default: 1)",
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="print the plan and its cost; write nothing"
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="replace an existing result, or an unfinished run whose settings differ",
    )


def _add_submit(commands: Any) -> None:
    parser = _add_command(
        commands, "submit", "write a job for a render queue; nothing is submitted"
    )
    _add_run(parser)
    parser.add_argument(
        "--template",
        metavar="FILE.yaml",
        help="the Open Job Description template to write (default: OUT/job/template.yaml)",
    )
    parser.add_argument(
        "--command",
        dest="program",
        default="usdsmoke",
        metavar="PROGRAM",
        help="the program that the queue starts, a name or path without arguments "
        "(default: usdsmoke)",
    )


def _add_preview(commands: Any) -> None:
    parser = _add_command(commands, "preview", "draw the smoke of a stage, including its looks")
    parser.add_argument(
        "stage", metavar="STAGE", help="a USD file; to draw a look, give its root layer"
    )
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FILE",
        help=".png: a picture, or a contact sheet of several; .webp: an animation; .exr: "
        "scene-linear, one file per frame",
    )
    _add_selection(
        parser,
        "timeCodes, such as 1-24, 1,5,9 or 1-24x2 (default: the first, the middle and the last; "
        "all for an animation; the middle for a turn)",
    )
    parser.add_argument(
        "--camera", default="", metavar="PATH", help="a Camera prim (default: a fitted front view)"
    )
    parser.add_argument(
        "--compare", action="store_true", help="also draw the stage without its look"
    )
    parser.add_argument(
        "--width", type=int, metavar="N", help="width of a picture in pixels (default: up to 512)"
    )
    parser.add_argument("--size", type=size_value, metavar="WxH", help="width and height in pixels")
    parser.add_argument(
        "--background",
        choices=("grey", "black", "none"),
        default="grey",
        help="background of PNG and WebP; none: transparent (single PNGs only)",
    )
    parser.add_argument(
        "--turn",
        type=count_value,
        metavar="N",
        help="draw one frame N times, around the up axis (default: from the front)",
    )
    parser.add_argument(
        "--threads", type=count_value, default=1, metavar="N", help="CPU threads (default: 1)"
    )


def _add_report(commands: Any) -> None:
    parser = _add_command(
        commands, "report", "measure the benefit and cost of the settings on a scene"
    )
    parser.add_argument("stage", metavar="STAGE", help="a USD file")
    parser.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="the folder of the report"
    )
    _add_selection(parser)
    _add_style(parser)
    _add_settings(parser)
    parser.add_argument(
        "--budget",
        default="5min",
        type=duration_value,
        metavar="TIME",
        help="time for measurements, such as 300s, 5min or 1h (default: 5min)",
    )


def _add_run(parser: argparse.ArgumentParser) -> None:
    """The arguments of a run."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = f"{_EXIT_CODES}\n\n{_settings_summary()}"
    parser.add_argument("stage", metavar="STAGE", help="a USD file")
    _add_style(parser)
    parser.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="the folder of the result"
    )
    _add_selection(parser)
    _add_layer(parser)
    _add_flag(parser, "--restylize")
    _add_settings(parser)
    _add_flag(parser, "--half")
    _add_client_options(parser)
    _add_option(parser, "--repair", type=repair_value, metavar="nan=0")


def _add_style(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--style",
        action="append",
        metavar="IMAGE",
        help="the style image; may be repeated (default: the images that the Volumes request)",
    )


def _add_preset(parser: argparse.ArgumentParser, summary: str) -> None:
    parser.add_argument("--preset", choices=PRESETS, help=summary)


def _add_settings(parser: argparse.ArgumentParser) -> None:
    _add_preset(parser, "settings for a purpose; all other settings override it")
    parser.add_argument(
        "--config",
        metavar="FILE.yaml",
        help="settings file; requests on Volumes override it (see 'usdsmoke settings')",
    )
    parser.add_argument(
        "--overrides",
        metavar="FILE.yaml",
        help="settings file that overrides requests on Volumes, as command-line options do",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="one setting, such as windows.size=3; may be repeated; overrides everything else",
    )
    _add_option(parser, "--camera", metavar="PATH")
    _add_option(parser, "--seed", type=int, metavar="N")
    _add_option(parser, "--tolerance", type=float, metavar="E")


def _add_client_options(parser: argparse.ArgumentParser) -> None:
    """Output for particular renderers; see docs/clients.md."""
    parser.add_argument(
        "--alias-cd",
        action="store_const",
        const=["Cd"],
        help="also write the colour as a scattering colour Cd (layer.scatter_colour)",
    )
    _add_flag(parser, "--split-rgb")
    _add_option(parser, "--emission-mode")


def _settings_summary() -> str:
    lines = ["settings for --set and --config (explained by 'usdsmoke settings'):"]
    for section, model in SECTIONS.items():
        lines.append(f"  {section}: {', '.join(model.model_fields)}")
    return "\n".join(lines)
