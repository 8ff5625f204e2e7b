"""OpenUSD's own diagnostics, kept off the terminal and turned into messages."""

from collections.abc import Iterator
from contextlib import contextmanager

from pxr import Tf, Usd, UsdUtils

from usdsmoke.base.errors import StageError

__all__ = ["captured_diagnostics", "open_quietly", "short_reason"]


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
        messages.extend(str(item.commentary) for item in delegate.TakeUncoalescedDiagnostics())
        del delegate  # its destruction gives stderr back to OpenUSD


def open_quietly(file_path: str) -> Usd.Stage:
    """The stage at ``file_path`` with all payloads; one sentence instead of OpenUSD's trace.

    Raises:
        StageError: the file is missing, of no USD format, or cannot be parsed.
    """
    with captured_diagnostics():
        try:
            stage = Usd.Stage.Open(file_path)
        except Tf.ErrorException as error:
            raise StageError(_refusal(file_path, error)) from None
    if not stage:
        raise StageError(f"cannot open the stage {file_path}. Check that it is a USD file.")
    return stage


def short_reason(error: Tf.ErrorException) -> str:
    """What OpenUSD said first, without the places in its own source."""
    for item in error.args:
        text = str(getattr(item, "commentary", item)).strip()
        if text:
            return " ".join(text.split())
    return "no reason given"


def _refusal(file_path: str, error: Tf.ErrorException) -> str:
    reason = short_reason(error)
    if reason.startswith("Failed to open layer"):
        reason = "it is missing, may not be read, or is of no format that USD knows"
    return (
        f"cannot open the stage {file_path}: {reason}. "
        "Give a readable .usda, .usdc, .usd or .usdz file."
    )
