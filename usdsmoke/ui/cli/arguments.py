"""The arguments of each command. Defaults and limits of settings come from the settings."""

import argparse
import textwrap
from functools import partial
from typing import Any

from usdsmoke import __version__
from usdsmoke.ui.cli.options import (
    EXIT_CODES,
    add_client_options,
    add_command,
    add_flag,
    add_layer,
    add_option,
    add_preset,
    add_selection,
    add_set,
    add_settings,
    add_style,
    settings_summary,
)
from usdsmoke.ui.cli.parser import SuggestingParser
from usdsmoke.ui.cli.record_arguments import add_record_commands
from usdsmoke.ui.cli.values import count_value, duration_value, repair_value, size_value


def build_parser() -> argparse.ArgumentParser:
    """The parser of ``usdsmoke`` with its subcommands."""
    parser = SuggestingParser(
        prog="usdsmoke",
        description="Stylize the smoke in a USD stage to match an example image. "
        "The result is a new layer.",
        epilog=EXIT_CODES,
    )
    parser.add_argument("--version", action="version", version=f"usdsmoke {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_inspect(commands)
    _add_stage(commands)
    _add_stylize(commands)
    _add_train(commands)
    _add_submit(commands)
    _add_assemble(commands)
    _add_validate(commands)
    add_command(commands, "plugin-path", "print the folders of usdsmoke's USD and usdview plug-ins")
    _add_preview(commands)
    _add_report(commands)
    add_record_commands(partial(add_command, commands))
    settings = add_command(commands, "settings", "print all settings with their meanings, as YAML")
    add_preset(settings, "print this preset's settings file instead")
    return parser


def _add_inspect(commands: Any) -> None:
    parser = add_command(
        commands, "inspect", "show the Volumes of a stage: fields, files, frames and grids"
    )
    parser.add_argument("stage", metavar="STAGE", help="a USD file")
    add_selection(parser)
    add_style(parser)
    add_settings(parser)


def _add_stage(commands: Any) -> None:
    parser = add_command(commands, "stage", "make a stage from VDB files")
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
    parser.add_argument("--up-axis", choices=("Y", "Z"), default="Y", help="up axis (default: Y)")
    parser.add_argument(
        "--fps", type=float, default=24.0, metavar="N", help="frames per second (default: 24)"
    )


def _add_stylize(commands: Any) -> None:
    parser = add_command(commands, "stylize", "stylize the smoke of a stage", plans=True)
    _add_run(parser)
    part = parser.add_mutually_exclusive_group()
    part.add_argument(
        "--coarse", action="store_true", help="run only the coarse step, which all windows share"
    )
    part.add_argument(
        "--window",
        type=int,
        metavar="K",
        help="run only window K (the first is 0; --dry-run lists all); when all are done, run "
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
        metavar="N",
        help="compute N windows at once, in processes of this machine; the result is the same "
        "(default: as many as cores and memory allow; on a GPU 1)",
    )
    _add_dry_run(parser)
    parser.add_argument(
        "--force",
        action="store_true",
        help="replace an existing result, or an unfinished run whose settings differ",
    )


def _add_dry_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--dry-run", action="store_true", help="print the plan and its cost; write nothing"
    )


def _add_train(commands: Any) -> None:
    parser = add_command(
        commands, "train", "train a network on the smoke of a stage, for stylize --start"
    )
    parser.add_argument("stage", metavar="STAGE", help="a USD file")
    add_style(parser)
    parser.add_argument(
        "-o", "--output", required=True, metavar="FILE.safetensors", help="the network to write"
    )
    add_selection(parser)
    add_settings(parser)
    parser.add_argument(
        "--iterations",
        type=count_value,
        metavar="N",
        help="length of the training, as iterations on small smoke (default: 1200); large smoke "
        "takes fewer of them: the plan tells how many",
    )
    _add_dry_run(parser)


def _add_submit(commands: Any) -> None:
    parser = add_command(
        commands, "submit", "write a job for a render queue, without sending it", plans=True
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
        help="the program that the queue starts: a name or path without arguments "
        "(default: usdsmoke)",
    )


def _add_assemble(commands: Any) -> None:
    parser = add_command(
        commands, "assemble", "combine windows that were run separately into one result"
    )
    parser.add_argument(
        "output", metavar="OUT", help="the output folder that the windows were run with"
    )
    add_layer(parser)


def _add_validate(commands: Any) -> None:
    parser = add_command(commands, "validate", "check a stage or layer, and its files and grids")
    parser.add_argument("stage", metavar="STAGE_OR_LAYER", help="a USD file")
    parser.add_argument(
        "--look-only",
        action="store_true",
        help="count only findings that the look causes; list those of its source separately",
    )
    parser.add_argument(
        "--strict", action="store_true", help="fail for warnings as for errors, also in JUnit"
    )
    parser.add_argument(
        "--ignore",
        action="append",
        default=[],
        metavar="RULE",
        help="leave out findings of this rule, by its printed name; may be repeated",
    )
    parser.add_argument("--junit", metavar="FILE.xml", help="also write the findings as JUnit XML")
    parser.add_argument(
        "--mend",
        metavar="NEW.usda",
        help="write a layer over the stage that fixes missing extents, wrong field types, "
        "relationships named unlike their grids, and absolute paths; validate this layer",
    )


def _add_preview(commands: Any) -> None:
    parser = add_command(commands, "preview", "draw the smoke of a stage, including its looks")
    parser.add_argument(
        "stage",
        nargs="+",
        metavar="STAGE",
        help="a USD file; to draw a look, give its root layer; more of them are drawn beside it",
    )
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FILE",
        help=".png: a picture, or a contact sheet of several; .webp, .gif, .mp4: an animation; "
        ".exr: scene-linear, one file per frame",
    )
    add_selection(
        parser,
        "timeCodes, such as 1-24, 1,5,9 or 1-24x2 (default: the first, the middle and the last "
        "that have colours; all for an animation; the middle for a turntable)",
    )
    add_set(parser, "a setting of the section 'stage', such as stage.density=fog; may be repeated")
    seen_from = parser.add_mutually_exclusive_group()
    seen_from.add_argument(
        "--camera", default="", metavar="PATH", help="a Camera prim (default: a fitted front view)"
    )
    seen_from.add_argument(
        "--turntable",
        type=count_value,
        nargs="?",
        const=36,
        metavar="N",
        help="draw one frame N times (default: 36), evenly around the up axis",
    )
    parser.add_argument(
        "--look", default="", metavar="NAME", help="a look of an asset (default: the selected one)"
    )
    parser.add_argument(
        "--compare", action="store_true", help="also draw the stage without its look"
    )
    pixels = parser.add_mutually_exclusive_group()
    pixels.add_argument(
        "--width",
        type=int,
        metavar="N",
        help="width of a picture in pixels (default: the longer side has 512)",
    )
    pixels.add_argument("--size", type=size_value, metavar="WxH", help="width and height in pixels")
    parser.add_argument(
        "--background",
        choices=("grey", "black", "none"),
        default="grey",
        help="background of all but OpenEXR; none: transparent (single PNGs only)",
    )
    parser.add_argument(
        "--threads", type=count_value, default=1, metavar="N", help="CPU threads (default: 1)"
    )


def _add_report(commands: Any) -> None:
    parser = add_command(
        commands, "report", "measure how settings change error and time in a scene", plans=True
    )
    parser.add_argument(
        "stage", metavar="STAGE", help="a USD file; with --final, the root layer of a result"
    )
    parser.add_argument(
        "--final",
        action="store_true",
        help="instead, draw a result with all bounces of light, and score it; needs Mitsuba 3",
    )
    parser.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="the folder of the report"
    )
    add_selection(parser)
    add_style(parser)
    add_settings(parser)
    parser.add_argument(
        "--budget",
        default="5min",
        type=duration_value,
        metavar="TIME",
        help="time for the measurements, such as 300s, 5min or 1h (default: 5min)",
    )


def _add_run(parser: argparse.ArgumentParser) -> None:
    """The arguments of a run."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = f"{textwrap.fill(EXIT_CODES, 80)}\n\n{settings_summary()}"
    parser.add_argument("stage", metavar="STAGE", help="a USD file")
    add_style(parser)
    parser.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="the folder of the result"
    )
    add_selection(parser)
    add_layer(parser)
    add_flag(parser, "--restylize")
    add_settings(parser)
    add_option(parser, "--start", metavar="FILE|network")
    add_flag(parser, "--half")
    add_client_options(parser)
    text = "replace NaN and infinity by this number (default: they are an error)"
    add_option(parser, "--repair", type=repair_value, metavar="nan=0", help=text)
