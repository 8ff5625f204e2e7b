"""Stand-ins for usdview: its api, its window, and the module that plug-ins derive from."""

from dataclasses import dataclass, field
from pathlib import Path

from pxr import Usd

from tests.usd_fixtures import (
    density_prim,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.ui.usdview.actions import run_action

__all__ = [
    "STAND_IN",
    "FakeApi",
    "FakeWindow",
    "do",
    "open_in_usdview",
    "refusal",
    "two_plumes_stage",
]


@dataclass
class FakeWindow:
    """Keeps what actions say."""

    texts: list[tuple[str, str]] = field(default_factory=list)
    warnings: list[tuple[str, str]] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    copied: list[str] = field(default_factory=list)

    def show_text(self, title: str, text: str) -> None:
        self.texts.append((title, text))

    def warn(self, title: str, message: str) -> None:
        self.warnings.append((title, message))

    def say(self, message: str) -> None:
        self.said.append(message)

    def copy(self, text: str) -> None:
        self.copied.append(text)


@dataclass
class FakeApi:
    """An open stage with a selection and a frame."""

    stage: Usd.Stage | None
    selectedPrims: list[Usd.Prim]
    frame: Usd.TimeCode


def open_in_usdview(
    stage_file: Path, *selection: str, time_code: float | None = 1.0
) -> tuple[FakeApi, FakeWindow]:
    """A stage as usdview has it open, with prims selected; none stands for the pseudo-root."""
    stage = Usd.Stage.Open(str(stage_file))
    selected = [stage.GetPrimAtPath(path) for path in selection or ("/",)]
    frame = Usd.TimeCode.Default() if time_code is None else Usd.TimeCode(time_code)
    return FakeApi(stage, selected, frame), FakeWindow()


def do(name: str, api: FakeApi) -> FakeWindow:
    """A window after one action that went well."""
    window = FakeWindow()
    run_action(name, "Item", api, window)
    assert window.warnings == []
    return window


def refusal(name: str, api: FakeApi) -> str:
    """The one message of an action that could not be done."""
    window = FakeWindow()
    run_action(name, "Item", api, window)
    ((title, message),) = window.warnings
    assert (title, window.texts, window.copied) == ("Item", [], [])
    return message


def two_plumes_stage(folder: Path) -> Path:
    """Volumes /World/a and /World/b below one Xform, b with time samples of its own."""
    write_sequence(folder, [1, 2, 3, 4])
    bodies = [
        volume_prim(density_prim(sequence(codes)), name)
        for name, codes in (("a", [1, 2]), ("b", [1, 3, 4]))
    ]
    return write_text(folder / "two plumes.usda", world("".join(bodies)))


# Makes pxr.Usdviewq of its own, with the signatures of OpenUSD's usdviewq/plugin.py, and records
# what plug-ins do. It runs in a process that then loads our plug-in as usdview does.
STAND_IN = '''
import importlib, json, sys, types
from pxr import Plug, Tf

class PluginContainer(object):
    def deferredImport(self, name):
        class Deferred:
            def __getattr__(self, attribute):
                def call(*arguments):
                    module = importlib.import_module(name, "a package that does not matter")
                    return getattr(module, attribute)(*arguments)
                return call
        return Deferred()

PluginContainer.__module__ = "pxr.Usdviewq.plugin"
package, plugin = types.ModuleType("pxr.Usdviewq"), types.ModuleType("pxr.Usdviewq.plugin")
package.__path__ = []
plugin.PluginContainer = PluginContainer
package.plugin = plugin
sys.modules.update({"pxr.Usdviewq": package, "pxr.Usdviewq.plugin": plugin})
CONTAINER = Tf.Type.Define(PluginContainer)

class Registry:
    def __init__(self):
        self.commands = {}
    def registerCommandPlugin(self, name, displayName, callback, description=""):
        assert name not in self.commands
        self.commands[name] = (displayName, callback, description)
        return name

class Menu:
    def __init__(self):
        self.items = []
    def addItem(self, command, shortcut=None):
        self.items.append(command)
    def addSeparator(self):
        self.items.append("-")

class Builder:
    def __init__(self):
        self.menus = {}
    def findOrCreateMenu(self, name):
        return self.menus.setdefault(name, Menu())

def load_plugins():
    """What usdview does when it starts: find, load, make, register, build menus."""
    registry, builder = Registry(), Builder()
    for found in Plug.Registry.GetAllDerivedTypes(CONTAINER):
        Plug.Registry().GetPluginForType(found).Load()
        container = found.pythonClass()
        container.registerPlugins(registry, None)
        container.configureView(registry, builder)
    return registry, builder
'''
