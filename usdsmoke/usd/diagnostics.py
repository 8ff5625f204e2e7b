"""OpenUSD's own diagnostics, kept off the terminal and turned into messages."""

import os
import re
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pxr import Ar, Sdf, Tf, Usd, UsdUtils

from usdsmoke.base.errors import StageError
from usdsmoke.usd.crates import check_crates
from usdsmoke.usd.values import FRAME_PATTERN

_LINE = re.compile(r":(\d+):\d+: |\bline (\d+)")  # in two versions' words
_NUMBER = re.compile(r"\d+(?=\.vdb$)", re.IGNORECASE)
_LONGEST_REASON = 160  # characters: it quotes the line, which may hold an array
_GRAMMAR = re.compile(r" matching .*pxrInternal.* at '", re.DOTALL)  # a rule's C++ type
_RESULTS = ("look", "asset", "look_*")  # ends of names of stages that a run writes
_FORMATS = "Give a .usda, .usdc, .usd or .usdz file."


@contextmanager
def captured_diagnostics() -> Iterator[list[str]]:
    """Warnings and status messages of OpenUSD raised inside, as texts, instead of on stderr.

    The list is filled when the block is left, in the order in which OpenUSD delivers them. Errors
    that a call raises as ``Tf.ErrorException`` are raised as ever.
    """
    messages: list[str] = []
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield messages
    finally:
        messages.extend(_text(item) for item in delegate.TakeUncoalescedDiagnostics())
        del delegate  # its destruction gives stderr back to OpenUSD


@contextmanager
def readable_values() -> Iterator[None]:
    """Values that OpenUSD cannot read inside are an error of the stage; also a decorator.

    Raises:
        StageError: a layer is damaged, or a value has a type that does not fit its attribute, or
            is a text that is no UTF-8.
    """
    try:
        yield
    except UnicodeDecodeError as error:
        text = error.object.decode("utf-8", "replace")[:_LONGEST_REASON]
        raise StageError(
            f"the stage has a value that cannot be read: the text {text!r} is not UTF-8. Repair "
            "the value, or export the layer again."
        ) from None
    except Tf.ErrorException as error:
        raise StageError(
            f"the stage has a value that cannot be read: {short_reason(error)}. "
            "Repair the value, or export the layer again."
        ) from None


def check_is_stage(stage: object) -> None:
    """Refuse what is neither a path nor a stage: type checkers do not see into ``pxr``.

    Raises:
        StageError: it is something else, such as the missing stage of a result.
    """
    if not isinstance(stage, (str, os.PathLike, Usd.Stage)):
        raise StageError(
            f"{stage!r} is not a stage. Give a file or a Usd.Stage; a result with layer.mode=layer "
            "has a look layer alone, to be added to a stage's subLayers."
        )


def open_quietly(file_path: str) -> Usd.Stage:
    """The stage at ``file_path`` with all payloads; one sentence instead of OpenUSD's trace.

    Raises:
        StageError: the file is missing, of no USD format, or cannot be parsed, or reading a crate
            file takes too much memory or time.
    """
    with captured_diagnostics():
        layers = check_crates(file_path)
        try:
            stage = Usd.Stage.Open(file_path)
        except Tf.ErrorException as error:
            raise StageError(layer_problem(file_path, error)) from None
        del layers  # not before the stage has them
    if not stage:
        raise StageError(layer_problem(file_path))
    return stage


def short_reason(error: Tf.ErrorException) -> str:
    """What OpenUSD said first, without the places in its own source."""
    return next(_reasons(error), "no reason given")


def layer_problem(file_path: str, refusal: Tf.ErrorException | None = None) -> str:
    """Why USD cannot open a file: it is missing, a folder, not readable, not USD, or not valid.

    Args:
        refusal: from OpenUSD, which may name the line.
    """
    found = str(Ar.GetResolver().Resolve(file_path)) or file_path
    if Ar.IsPackageRelativePath(found):
        found = Ar.SplitPackageRelativePathOuter(found)[0]
    try:
        with open(found, "rb") as stream:
            stream.read(1)
    except (FileNotFoundError, NotADirectoryError):
        if FRAME_PATTERN.search(os.path.basename(file_path)) and file_path.lower().endswith(".vdb"):
            return f"{file_path} names VDB files, not a stage. {_make_stage(file_path)}"
        return f"there is no file {os.path.abspath(file_path)}. Check the path."
    except IsADirectoryError:
        stages = [p for name in _RESULTS for p in sorted(Path(found).glob(f"*_{name}.usd[ac]"))]
        advice = f"Give the stage {stages[0]}." if stages else _FORMATS
        return f"{file_path} is a folder. {advice}"
    except PermissionError as error:
        return f"{file_path} cannot be read: {error.strerror}. Change its permissions."
    except OSError as error:
        return f"{file_path} cannot be read: {error.strerror or error}. Check the disk."
    if file_path.lower().endswith(".vdb"):
        return f"{file_path} is a VDB file, not a stage. {_make_stage(file_path)}"
    if Sdf.FileFormat.FindByExtension(file_path) is None:
        return f"cannot open {file_path}: it is not a USD file. {_FORMATS}"
    suffix = Sdf.FileFormat.GetFileExtension(file_path)
    line = _line(refusal)
    advice = "Correct that line, or export the file again." if line else "Export it again."
    return f"cannot open {file_path}: it is not a valid .{suffix} file{line}. {advice}"


def _make_stage(file_path: str) -> str:
    files = shlex.quote(_sequence(file_path))
    return (
        f"Make a stage with: usdsmoke stage {files} -o STAGE.usda --meters-per-unit 1 (1 for files "
        "in metres, 0.01 for centimetres)"
    )


def _sequence(file_path: str) -> str:
    """The pattern of a numbered file and its neighbours; any other name as it is.

    >>> _sequence("cache/plume.0012.vdb")
    'cache/plume.####.vdb'
    """
    return _NUMBER.sub(lambda match: "#" * len(match[0]), file_path)


def _text(item: object) -> str:
    """The words of a diagnostic."""
    return decoded_text(lambda: str(getattr(item, "commentary", item)))


def decoded_text(get: Callable[[], str]) -> str:
    """A text from OpenUSD. It may quote bytes of a damaged file, which are no UTF-8."""
    try:
        return get()
    except UnicodeDecodeError as error:  # USD's bindings decode strictly
        return error.object.decode("utf-8", "replace")


def _reasons(error: Tf.ErrorException) -> Iterator[str]:
    """What OpenUSD said, error by error, each in one line."""
    texts = (" ".join(_text(item).split()) for item in error.args)
    return (text for text in texts if text)


def _line(error: Tf.ErrorException | None) -> str:
    """The line that OpenUSD names, with its reason; the names of its grammar's rules left out."""
    reasons = _reasons(error) if error is not None else iter(())
    # Values that are not allowed are told twice: first without their line.
    reason = next((text for text in reasons if _LINE.search(text)), "")
    found = _LINE.search(reason)
    if found is None:
        return ""
    if not found[1]:  # an older version's sentence, in which the line stands in the middle
        return f" (line {found[2]})"
    why = _GRAMMAR.sub(" at '", reason[found.end() :])[:_LONGEST_REASON]
    return f" (line {found[1]}: {why})" if why else f" (line {found[1]})"
