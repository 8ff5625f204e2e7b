"""Options that several commands share, most of them for a setting; from options to settings."""

import argparse
import textwrap
from pathlib import Path
from typing import Any

from usdsmoke.base.errors import ConfigError
from usdsmoke.config.presets import PRESETS, preset_file
from usdsmoke.config.resolve import GivenSettings, read_settings
from usdsmoke.config.setting_model import allowed_values
from usdsmoke.config.settings import SECTIONS, declared_settings

OPTIONS = {  # that stand for a setting
    "--prim": "stage.prims",
    "--frames": "stage.frames",
    "--allow-missing": "stage.allow_missing",
    "--restylize": "stage.restylize",
    "--half": "grids.half",
    "--repair": "grids.repair_nan",
    "--camera": "views.camera",
    "--seed": "optimize.seed",
    "--start": "optimize.start",
    "--mode": "layer.mode",
    "--look": "layer.look",
    "--emission-mode": "layer.emission_mode",
    "--alias-cd": "layer.scatter_colour",
    "--split-rgb": "layer.split_rgb",
}
EXIT_CODES = (
    "exit codes: 0 success; 1 an error, or a problem was found; 2 wrong usage; 130 Ctrl-C; "
    "141 closed pipe; 143 SIGTERM"
)


def given_settings(arguments: argparse.Namespace) -> list[Path | GivenSettings]:
    """The files of ``--preset`` and ``--config``, and all other options; the strongest last.

    Raises:
        ConfigError: the file of ``--overrides`` or an option cannot be read.
    """
    files = [preset_file(arguments.preset)] if arguments.preset else []
    files += [Path(arguments.config)] if arguments.config else []
    overrides = read_settings(Path(arguments.overrides) if arguments.overrides else None)
    options = {
        option: vars(arguments).get(option.strip("-").replace("-", "_")) for option in OPTIONS
    }
    given = {
        name: options[option] for option, name in OPTIONS.items() if options[option] is not None
    }
    sources = {name: option for option, name in OPTIONS.items()}
    for text in arguments.set:
        if "=" not in text:
            raise ConfigError(f"--set {text} has no '='. Write NAME=VALUE, such as windows.size=3.")
    texts = read_settings(arguments.set, "--set")
    return [*files, read_settings([overrides, GivenSettings(given, sources), texts])]


def add_command(
    commands: Any, name: str, summary: str, plans: bool = False
) -> argparse.ArgumentParser:
    """A command with what all commands have: ``--json``, ``--verbose`` and the exit codes.

    Args:
        plans: it prints a plan.
    """
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=summary,
        description=f"{summary[:1].upper()}{summary[1:]}.",
        epilog=EXIT_CODES,
        allow_abbrev=False,
    )
    parser.set_defaults(parser=parser)
    parser.add_argument("--json", action="store_true", help="print one JSON value on stdout")
    what = "show the traceback of an error"
    if plans:
        what = f"list everything in the plan and all estimated errors; {what}"
    parser.add_argument("--verbose", action="store_true", help=what)
    return parser


def add_option(parser: argparse.ArgumentParser, option: str, **more: Any) -> None:
    """An option that stands for a setting; choices and, by default, the help are the setting's."""
    name = OPTIONS[option]
    field = declared_settings()[name]
    if words := allowed_values(field):
        more.setdefault("choices", words)
    text = more.pop("help", field.description)
    parser.add_argument(option, help=f"{text} ({name})", **more)


def add_flag(parser: argparse.ArgumentParser, option: str) -> None:
    """An option without a value that sets its setting to true."""
    add_option(parser, option, action="store_const", const=True)


def add_selection(parser: argparse.ArgumentParser, frames_help: str = "") -> None:
    """Which Volumes and timeCodes."""
    parser.add_argument(
        "--prim",
        action="append",
        metavar="PATH",
        help="a Volume, or a prim above Volumes; may be repeated (default: all visible Volumes "
        "except guides and proxies)",
    )
    if frames_help:
        parser.add_argument("--frames", metavar="1-24", help=frames_help)
    else:
        text = "timeCodes, such as 1-24, 1,5,9 or 1-24x2 (every second one); default: all"
        add_option(parser, "--frames", metavar="1-24", help=text)
    add_flag(parser, "--allow-missing")


def add_layer(parser: argparse.ArgumentParser) -> None:
    """How the look is put on the stage, and its name."""
    add_option(parser, "--mode")
    add_option(parser, "--look", metavar="NAME")


def add_style(parser: argparse.ArgumentParser) -> None:
    """The style images."""
    parser.add_argument(
        "--style",
        action="append",
        metavar="IMAGE",
        help="a style image; may be repeated (default: the images that the Volumes request)",
    )


def add_preset(parser: argparse.ArgumentParser, summary: str) -> None:
    """One of the presets, with a help text."""
    parser.add_argument("--preset", choices=PRESETS, help=summary)


def add_settings(parser: argparse.ArgumentParser) -> None:
    """Files and values of settings."""
    add_preset(parser, "settings for a purpose; all other options override them")
    parser.add_argument(
        "--config",
        metavar="FILE.yaml",
        help="a settings file; requests on Volumes override it (see 'usdsmoke settings')",
    )
    parser.add_argument(
        "--overrides",
        metavar="FILE.yaml",
        help="a settings file that overrides requests on Volumes, as command-line options do",
    )
    add_set(
        parser,
        "one setting, such as windows.size=3; may be repeated; overrides everything else",
    )
    add_option(parser, "--camera", metavar="PATH")
    add_option(parser, "--seed", type=int, metavar="N")


def add_set(parser: argparse.ArgumentParser, summary: str) -> None:
    """Single settings."""
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help=summary)


def add_client_options(parser: argparse.ArgumentParser) -> None:
    """Output for particular renderers; see docs/clients.md."""
    parser.add_argument(
        "--alias-cd",
        action="store_const",
        const=["Cd"],
        help="also write the colour as a scattering colour Cd (layer.scatter_colour)",
    )
    add_flag(parser, "--split-rgb")
    add_option(parser, "--emission-mode")


def settings_summary() -> str:
    """The names of all settings by section, for a help text."""
    lines = ["settings for --set and --config (explained by 'usdsmoke settings'):"]
    for section, model in SECTIONS.items():
        names = f"{section}: {', '.join(model.model_fields)}"
        lines += textwrap.wrap(names, 80, initial_indent="  ", subsequent_indent="    ")
    return "\n".join(lines)
