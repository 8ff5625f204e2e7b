"""The command ``usdsmoke``: arguments in, one call of the package, results out.

Results go to stdout, progress and messages to stderr. Exit codes: 0 ok, 1 a named error (or, for
``inspect``, ``validate``, ``verify`` and ``rerun``, a problem that was found), 2 wrong usage,
128 + n when stopped by signal n: 130 after Ctrl-C, 143 after a polite kill, 141 when nobody reads
stdout any more.

With ``--json`` stdout holds exactly one JSON value, whatever happens: the result, or
``{"error": {"type": ..., "message": ...}}``.
"""

import argparse
import errno
import gc
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from usdsmoke.base.errors import Interrupted, UsdSmokeError, lacks_memory
from usdsmoke.base.machine import (
    check_packages,
    missing_package,
    prepare_numpy_environment,
    process_seconds,
)

_LOWER = "Lower views.pool, views.image_size or grids.refine"
_BROKEN_PIPE = 128 + 13
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # of a disk
_AGAIN_S = 0.02  # until a signal that waits for an import is looked at again


class _Stopped(KeyboardInterrupt):
    """A signal that asks the process to end."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code.

    Args:
        argv: arguments without the program's name; None takes the process's own.
    """
    words = sys.argv[1:] if argv is None else argv
    _open_closed_streams()
    try:
        with _signals_as_exceptions() as seen:
            try:
                code = _main(words, argv is None, seen)
            except (UsdSmokeError, KeyboardInterrupt) as error:  # before the command itself
                _report(error, argparse.Namespace(verbose=False, json="--json" in words))
                code = _stopped(seen) if isinstance(error, KeyboardInterrupt) else 1
            sys.stdout.flush()
            return _stopped(seen) if seen else code
    except BrokenPipeError:
        _close_output()
        return _BROKEN_PIPE
    except OSError as error:
        if not _is_output(error):
            raise
        _close_output()
        message = f"cannot write standard output: {error.strerror}"
        print(f"usdsmoke: {message}. Free some space, or write elsewhere.", file=sys.stderr)
        return 1
    finally:
        if argv is None:  # the process ends: to look through torch's objects takes half a second
            gc.freeze()
            with suppress(ValueError):  # not the main thread
                signal.signal(signal.SIGINT, signal.SIG_IGN)


def _open_closed_streams() -> None:
    """Let output go nowhere where the process was started without stdout or stderr, as by cron."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))


def _close_output() -> None:
    """Let go of what stdout does not take: it must not complain when the interpreter ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _is_output(error: BaseException) -> bool:
    """Whether stdout is a file that takes no more: what writes other files names them."""
    return isinstance(error, OSError) and error.filename is None and error.errno in _FULL


def _main(words: Sequence[str], is_process: bool, seen: list[int]) -> int:
    prepare_numpy_environment()
    check_packages("numpy", "yaml", "pydantic", "rich")  # which the imports below need
    from usdsmoke.ui.cli.arguments import build_parser
    from usdsmoke.ui.cli.parser import WrongUsage
    from usdsmoke.ui.cli.values import empty_value

    parser, commands = build_parser(), _commands()
    try:
        arguments = parser.parse_args(words)
        if name := empty_value(arguments):
            parser.error(f"{name} is empty. Give a value, or leave it out.")
    except WrongUsage as error:
        if "--json" in words:
            _print_error("WrongUsage", error.message)
        raise
    arguments.starting = process_seconds() if is_process else 0.0
    return _run(commands[arguments.command], arguments, seen)


def _commands() -> dict[str, Callable[[argparse.Namespace], int]]:
    """The function of each command."""
    from usdsmoke.ui.cli import commands, preview_command, work_commands

    return {
        "inspect": commands.run_inspect,
        "stage": commands.run_stage,
        "stylize": work_commands.run_stylize,
        "submit": work_commands.run_submit,
        "train": work_commands.run_train,
        "assemble": work_commands.run_assemble,
        "validate": commands.run_validate,
        "plugin-path": commands.run_plugin_path,
        "preview": preview_command.run_preview,
        "report": commands.run_report,
        "provenance": commands.run_provenance,
        "verify": commands.run_verify,
        "rerun": commands.run_rerun,
        "settings": commands.run_settings,
    }


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
        return _stopped(seen) if stopped else 1
    except ModuleNotFoundError as error:
        is_ours = (error.name or "").startswith("usdsmoke")
        _report(error if is_ours else missing_package(error.name), arguments)
        return 1
    except Exception as error:
        if _is_output(error):
            raise
        _report(error, arguments)
        return 1


def _stopped(seen: Sequence[int]) -> int:
    """The exit code behind signals; of Ctrl-C, where a program has raised it itself."""
    return 128 + (seen[-1] if seen else signal.SIGINT)


@contextmanager
def _signals_as_exceptions() -> Iterator[list[int]]:
    """SIGINT and SIGTERM end the work from inside, so that it can tidy up; yields those seen.

    The first one waits while a module is loaded: USD loads its own from C++ and loses what is
    raised there.
    """
    seen: list[int] = []
    before: dict[int, Any] = {}

    def handle(number: int, handler: Any) -> None:
        before[number] = signal.signal(number, handler)

    def stop(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        if len(seen) == 1 and _is_importing(frame):
            handle(signal.SIGALRM, again)
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
            return
        signal.setitimer(signal.ITIMER_REAL, 0)
        raise _Stopped

    def again(number: int, frame: FrameType | None) -> None:
        if _is_importing(frame):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
            return
        raise _Stopped

    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            handle(number, stop)
    except ValueError:  # not the main thread: signals are somebody else's business
        yield seen
        return
    try:
        yield seen
    finally:
        if signal.SIGALRM in before:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for which, handler in before.items():
            signal.signal(which, signal.SIG_DFL if handler is None else handler)


def _is_importing(frame: FrameType | None) -> bool:
    """Whether a module is being loaded, by something that ``main`` has called."""
    while frame is not None and frame.f_code is not main.__code__:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _report(error: BaseException, arguments: argparse.Namespace) -> None:
    """The message on stderr, as JSON on stdout too where it is asked for."""
    if arguments.verbose:
        traceback.print_exception(error)
    kind, message = type(error).__name__, str(error)
    if isinstance(error, KeyboardInterrupt):
        kind, message = Interrupted.__name__, "stopped. No incomplete files are left"
    elif kind == "OutOfMemoryError":  # torch's
        message = f"out of memory on the GPU. {_LOWER}, or set optimize.device=cpu."
    elif isinstance(error, ImportError) and lacks_memory(error):
        message = "out of memory: a library cannot be loaded. Raise the limit of address space."
    elif lacks_memory(error):
        message = f"out of memory. {_LOWER}."
    elif not isinstance(error, UsdSmokeError):
        message = f"unexpected {kind}: {message}. Run with --verbose to see where, and report it."
    print(f"usdsmoke: {message}", file=sys.stderr)
    if arguments.verbose and (details := getattr(error, "details", "")):
        print(details, file=sys.stderr)
    if arguments.json:
        _print_error(kind, message)


def _print_error(kind: str, message: str) -> None:
    """An error as the one JSON value of stdout."""
    print(json.dumps({"error": {"type": kind, "message": message}}, ensure_ascii=False))
