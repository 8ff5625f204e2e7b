"""What usdview loads: the menu, and windows made with usdview's own Qt.

The menu's actions stand in `actions`, which is imported when one of them is first chosen, so that
usdview starts as fast as without. The type's name in ``plugInfo.json`` is this module's and the
class's; usdview finds it by that.
"""

from collections.abc import Callable
from typing import Any

from pxr import Tf
from pxr.Usdviewq.plugin import PluginContainer

MENU = "usdsmoke"
# (name of the action, label, what it does); None is a line between groups.
_ITEMS: tuple[tuple[str, str, str] | None, ...] = (
    ("inspect", "Inspect volume", "Fields, files, grids and sizes of the selected Volumes"),
    ("provenance", "Show provenance", "What the looks on this stage were made with and from"),
    ("validate", "Validate", "Check the stage, its files and grids"),
    None,
    ("toggle", "Toggle original/stylized", "Show the next look, or the source; in memory only"),
    None,
    ("copy_frame", "Copy command line (this frame)", "The command that stylizes this frame"),
    ("copy_all", "Copy command line (all frames)", "The command that stylizes all frames"),
)


class QtWindow:
    """How actions speak to the person, in usdview; see ``actions.Window``."""

    def __init__(self, api: Any) -> None:
        self._api = api

    def show_text(self, title: str, text: str) -> None:
        """Show lines of text in a window of its own that may stay open."""
        from pxr.Usdviewq.qt import QtCore, QtGui, QtWidgets

        dialog = QtWidgets.QDialog(self._api.qMainWindow)
        dialog.setAttribute(QtCore.Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.setWindowTitle(f"{MENU}: {title}")
        view = QtWidgets.QPlainTextEdit(text, dialog)
        view.setReadOnly(True)
        view.setLineWrapMode(QtWidgets.QPlainTextEdit.LineWrapMode.NoWrap)
        font = QtGui.QFont("monospace")
        font.setStyleHint(QtGui.QFont.StyleHint.Monospace)
        view.setFont(font)
        layout = QtWidgets.QVBoxLayout(dialog)
        layout.addWidget(view)
        dialog.resize(1000, 500)
        dialog.show()

    def warn(self, title: str, message: str) -> None:
        """Say what went wrong."""
        from pxr.Usdviewq.qt import QtCore, QtWidgets

        box = QtWidgets.QMessageBox(self._api.qMainWindow)
        box.setAttribute(QtCore.Qt.WidgetAttribute.WA_DeleteOnClose)
        box.setIcon(QtWidgets.QMessageBox.Icon.Warning)
        box.setWindowTitle(f"{MENU}: {title}")
        box.setTextFormat(QtCore.Qt.TextFormat.PlainText)  # paths of prims look like HTML to Qt
        box.setText(message)
        box.show()

    def say(self, message: str) -> None:
        """A short message in the status bar."""
        self._api.PrintStatus(message)

    def copy(self, text: str) -> None:
        """Put a text on the clipboard."""
        from pxr.Usdviewq.qt import QtWidgets

        QtWidgets.QApplication.clipboard().setText(text)


class SmokeContainer(PluginContainer):
    """The commands of usdsmoke and their menu."""

    def registerPlugins(self, plugRegistry: Any, plugCtx: Any) -> None:
        """Make a command of every action; called by usdview when it starts."""
        actions = self.deferredImport("usdsmoke.ui.usdview.actions")
        self._commands = [
            None
            if item is None
            else plugRegistry.registerCommandPlugin(
                f"{MENU}.{item[0]}", item[1], _callback(actions, item[0], item[1]), item[2]
            )
            for item in _ITEMS
        ]

    def configureView(self, plugRegistry: Any, plugUIBuilder: Any) -> None:
        """Put the commands into a menu of their own; called by usdview when it starts."""
        menu = plugUIBuilder.findOrCreateMenu(MENU)
        for command in self._commands:
            if command is None:
                menu.addSeparator()
            else:
                menu.addItem(command)


def _callback(actions: Any, name: str, label: str) -> Callable[[Any], None]:
    """What usdview calls with its api when the item is chosen."""

    def run(api: Any) -> None:
        window = QtWindow(api)
        try:
            actions.run_action(name, label, api, window)
        except ImportError as error:  # of the module itself: a part of usdsmoke is missing
            window.warn(label, f"usdsmoke is not installed completely: {error}")

    return run


Tf.Type.Define(SmokeContainer)
