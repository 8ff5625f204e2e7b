"""A parser of arguments whose errors name what was probably meant."""

import argparse
import difflib
import re
import sys
from collections.abc import Sequence
from typing import Any, NoReturn


class WrongUsage(SystemExit):
    """Arguments that are wrong: exit code 2, with the line that stderr has got."""

    def __init__(self, message: str) -> None:
        super().__init__(2)
        self.message = message


class SuggestingParser(argparse.ArgumentParser):
    """A parser whose errors take one line, and name the nearest command or option."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As of ``argparse``; the command's own parser reports options that it does not have."""
        words = sys.argv[1:] if args is None else list(args)
        arguments, unknown = self.parse_known_args(_joined(words), namespace)
        if unknown:
            own: argparse.ArgumentParser = arguments.parser
            options = re.findall(r"--[\w-]+", own.format_usage())
            hint = _closest(unknown[0].partition("=")[0], options) or f" See {own.prog} --help."
            if all(word.endswith(".vdb") for word in unknown):  # the shell has expanded plume.*.vdb
                hint = " Name a sequence by a pattern in quotes: 'plume.####.vdb'."
            own.error(f"unknown argument{'s' * (len(unknown) > 1)}: {' '.join(unknown)}.{hint}")
        return arguments

    def error(self, message: str) -> NoReturn:
        """One line on stderr that names the argument and what to write.

        For a word that is not a choice, the line names the nearest choice, or all of them.

        Raises:
            WrongUsage: always.
        """
        choice = r"argument (.*?): invalid choice: '(.*?)' \(choose from (.*)\)"
        if found := re.fullmatch(choice, message):
            known = re.findall(r"[\w-]+", found[3])
            what = f"{found[1]} cannot be" if found[1] != "COMMAND" else "there is no command"
            hint = _closest(found[2], known) or f" Choose from {', '.join(known)}."
            message = f"{what} {found[2]!r}.{hint}"
        elif found := re.fullmatch(r"argument (.*?): invalid (int|float) value: ('.*')", message):
            kind = "a whole number" if found[2] == "int" else "a number"
            message = f"{found[1]}: {found[3]} is not {kind}."
        elif found := re.fullmatch(r"the following arguments are required: (.*)", message):
            missing = [self._form(name) for name in found[1].split(", ")]
            verb = "is" if len(missing) == 1 else "are"
            message = f"{' and '.join(missing)} {verb} missing. See {self.prog} --help."
        elif found := re.fullmatch(r"argument (.*?): expected .*", message):
            message = f"{found[1]} has no value. Give {self._form(found[1])}."
        elif found := re.fullmatch(r"argument (.*?): not allowed with argument (.*)", message):
            message = f"{found[1]} and {found[2]} exclude each other. Give one of them."
        message = message.removeprefix("argument ")
        print(f"{self.prog}: {message}", file=sys.stderr)
        raise WrongUsage(message)

    def _form(self, name: str) -> str:
        """An argument as it is written, such as -o OUT."""
        for action in self._actions:
            if action.option_strings and name == "/".join(action.option_strings):
                return " ".join(filter(None, (action.option_strings[0], _value(action))))
        return name


def _value(action: argparse.Action) -> str:
    return action.metavar if isinstance(action.metavar, str) else action.dest.upper()


def _joined(words: Sequence[str]) -> list[str]:
    """The arguments with ``--frames -2-0`` as ``--frames=-2-0``: else -2-0 looks like an option.

    >>> _joined(["inspect", "a.usda", "--frames", "-2-0", "--json"])
    ['inspect', 'a.usda', '--frames=-2-0', '--json']
    """
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] == "--frames" and re.match(r"-\d", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _closest(word: str, known: Sequence[str]) -> str:
    names = {name.lstrip("-"): name for name in known}  # dashes are alike in all of them
    close = difflib.get_close_matches(word.lstrip("-"), names, n=1)
    return f" Did you mean {names[close[0]]}?" if close else ""
