"""What the menu does: functions of usdview's api and a window, without Qt.

Each reads the open stage as it is composed at the moment, unsaved edits included. None writes a
file, and none loads torch.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

from pxr import Tf, Usd

from usdsmoke.base.errors import StageError, UsdSmokeError
from usdsmoke.usd.diagnostics import short_reason


class UsdviewApi(Protocol):
    """The part of usdview's api that is used; the names are usdview's."""

    @property
    def stage(self) -> Usd.Stage:
        """The open stage."""

    @property
    def frame(self) -> Usd.TimeCode:
        """The timeCode that is shown; Default on a stage that has no range."""

    @property
    def selectedPrims(self) -> Sequence[Usd.Prim]:
        """What is selected; the pseudo-root alone means nothing is selected."""


class Window(Protocol):
    """How an action speaks to the person."""

    def show_text(self, title: str, text: str) -> None:
        """Show lines of text that may be long."""

    def warn(self, title: str, message: str) -> None:
        """Say what went wrong."""

    def say(self, message: str) -> None:
        """A short message that asks for no answer."""

    def copy(self, text: str) -> None:
        """Put a text on the clipboard."""


def run_action(name: str, label: str, api: UsdviewApi, window: Window) -> None:
    """Run a menu item's action; errors become messages in the window.

    Args:
        name: a key of this module's actions: inspect, provenance, validate, toggle, copy_frame or
            copy_all.
        label: how the menu calls it; titles of windows.
    """
    try:
        if not api.stage:
            raise StageError("no stage is open. Open one first.")
        _ACTIONS[name](api, window)
    except UsdSmokeError as error:
        window.warn(label, str(error))
    except Tf.ErrorException as error:
        window.warn(label, f"OpenUSD refused: {short_reason(error)}")
    except ImportError as error:
        window.warn(
            label,
            f"{error}. usdsmoke needs OpenUSD 24.05 or later, NumPy, PyYAML, pydantic and rich: "
            "install them into usdview's Python.",
        )
    except MemoryError:
        window.warn(label, "out of memory")
    except Exception as error:
        kind = type(error).__name__
        window.warn(label, f"unexpected {kind}: {error}. Please report this")


def _inspect(api: UsdviewApi, window: Window) -> None:
    """Show the fields, files, grids and sizes of the selected Volumes, at all timeCodes."""
    from usdsmoke.ui.cli.text import inspection_text
    from usdsmoke.ui.usdview.volumes import selected_volumes, selects_everything
    from usdsmoke.usd.inspect import inspect

    volumes = selected_volumes(api.stage, api.selectedPrims)
    everything = selects_everything(api.selectedPrims)
    paths = None if everything else [str(volume.GetPath()) for volume in volumes]
    window.show_text("volumes", inspection_text(inspect(api.stage, paths)))


def _show_provenance(api: UsdviewApi, window: Window) -> None:
    """Show the records of the selected Volumes' looks, muted ones too."""
    from usdsmoke.ui.usdview.looks import find_looks, look_text
    from usdsmoke.ui.usdview.volumes import selected_volumes

    volumes = selected_volumes(api.stage, api.selectedPrims)
    window.show_text("provenance", look_text(volumes, find_looks(api.stage)))


def _toggle(api: UsdviewApi, window: Window) -> None:
    """Show the next look of the selected Volumes; the source comes after the last look."""
    from usdsmoke.ui.usdview.looks import show_next
    from usdsmoke.ui.usdview.volumes import selected_volumes

    window.say(show_next(api.stage, selected_volumes(api.stage, api.selectedPrims)))


def _validate(api: UsdviewApi, window: Window) -> None:
    """Show what all validators find. Files that usdsmoke wrote are read whole, which takes time."""
    from usdsmoke.ui.cli.text import validation_text
    from usdsmoke.usd.rules import validate

    window.say("validating ...")
    name = api.stage.GetRootLayer().GetDisplayName()
    text = validation_text(name, validate(api.stage))
    window.say(text.splitlines()[-1])
    window.show_text("validation", text)


def _copy_frame(api: UsdviewApi, window: Window) -> None:
    code = api.frame
    _copy(api, window, float("-inf") if code.IsDefault() else code.GetValue())


def _copy_all(api: UsdviewApi, window: Window) -> None:
    _copy(api, window, None)


def _copy(api: UsdviewApi, window: Window, time_code: float | None) -> None:
    """Copy the command that stylizes the selected Volumes: one frame, or all frames for None."""
    from usdsmoke.ui.usdview.command_line import stylize_command
    from usdsmoke.ui.usdview.volumes import selected_volumes

    volumes = selected_volumes(api.stage, api.selectedPrims)
    text = stylize_command(api.stage, volumes, time_code)
    window.copy(text.command)
    window.say(f"copied: {text.command}")
    if text.notes:
        notes = "\n".join(f"note: {note}" for note in text.notes)
        window.show_text("command line", f"{text.command}\n\n{notes}")


_ACTIONS: dict[str, Callable[[UsdviewApi, Window], None]] = {
    "inspect": _inspect,
    "provenance": _show_provenance,
    "validate": _validate,
    "toggle": _toggle,
    "copy_frame": _copy_frame,
    "copy_all": _copy_all,
}
