"""usdview's way to our menu: found on PXR_PLUGINPATH_NAME, loaded, registered, built; no torch."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.fixtures.usd_fixtures import make_look, needs_usd, plume_stage
from tests.fixtures.usdview_fixtures import STAND_IN
from usdsmoke.ui.usdview import PLUGIN_FOLDER

PROJECT = Path(__file__).resolve().parents[4]
ITEMS = [
    "usdsmoke.inspect",
    "usdsmoke.provenance",
    "usdsmoke.validate",
    "-",
    "usdsmoke.toggle",
    "-",
    "usdsmoke.copy_frame",
    "usdsmoke.copy_all",
]


def in_usdview(code: str) -> Any:
    """What ``code`` prints last, as JSON, in a process with the stand-in and our plug-in path."""
    done = subprocess.run(
        [sys.executable, "-c", STAND_IN + code],
        capture_output=True,
        text=True,
        cwd=PROJECT,
        env={**os.environ, "PXR_PLUGINPATH_NAME": str(PLUGIN_FOLDER)},
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_the_plugin_is_found_loads_and_builds_its_menu_without_anything_heavy() -> None:
    found = in_usdview("""
registry, builder = load_plugins()
heavy = {"torch", "numpy", "yaml", "rich", "usdsmoke.ui.usdview.actions"} & set(sys.modules)
labels = [registry.commands[name][0] for name in builder.menus["usdsmoke"].items if name != "-"]
print(json.dumps([list(builder.menus), builder.menus["usdsmoke"].items, labels, sorted(heavy)]))
""")
    menus, items, labels, heavy = found
    assert menus == ["usdsmoke"]
    assert items == ITEMS
    assert "Toggle original/stylized" in labels and len(set(labels)) == 6
    assert heavy == []


@needs_usd(26, 5)
def test_every_menu_item_works_through_its_callback_and_loads_no_torch(tmp_path: Path) -> None:
    files = make_look(plume_stage(tmp_path), tmp_path / "out", ours=True)
    found = in_usdview(f"""
from pxr import Usd
registry, builder = load_plugins()
from usdsmoke.ui.usdview import container
said = []
for method in ("show_text", "warn", "say", "copy"):
    def record(self, *texts, method=method):
        said.append((method, *texts))
    setattr(container.QtWindow, method, record)
class Api:
    stage = Usd.Stage.Open({str(files.root_stage)!r})
    selectedPrims = [stage.GetPseudoRoot()]
    frame = Usd.TimeCode(2)
seen = {{}}
for name, (label, callback, description) in registry.commands.items():
    said.clear()
    callback(Api())
    seen[name] = list(said)
ours = {{"usdsmoke", "pxr"}} | set(sys.stdlib_module_names)
files = {{name for name, module in sys.modules.items() if getattr(module, "__file__", None)}}
foreign = {{name.split(".")[0] for name in files}} - ours
print(json.dumps([seen, sorted(foreign)]))
""")
    seen, foreign = found
    assert {name for name, calls in seen.items() if any(c[0] == "warn" for c in calls)} == set()
    assert "4 frames, 1 to 4" in seen["usdsmoke.inspect"][0][2]
    assert "shows run 3f2b8c1e" in seen["usdsmoke.provenance"][0][2]
    assert seen["usdsmoke.validate"][-1][2].endswith(": no findings")
    assert seen["usdsmoke.toggle"] == [["say", "original: muted look.usda"]]
    assert "--frames 2 " in seen["usdsmoke.copy_frame"][0][1]
    assert "--frames 1-4 " in seen["usdsmoke.copy_all"][0][1]
    assert "torch" not in foreign
    allowed = {"numpy", "yaml", "rich", "pydantic"}  # docs/look.md names them
    named = {name for name in foreign if not name.startswith("_") and "distutils" not in name}
    of_rich = {"pygments", "markdown_it", "mdurl"}
    of_pydantic = {"pydantic_core", "typing_extensions", "typing_inspection", "annotated_types"}
    assert named <= allowed | of_rich | of_pydantic


def test_a_part_that_is_missing_becomes_a_message() -> None:
    found = in_usdview("""
registry, builder = load_plugins()
from usdsmoke.ui.usdview import container
said = []
container.QtWindow.warn = lambda self, title, message: said.append([title, message])
sys.modules["usdsmoke.ui.usdview.actions"] = None
registry.commands["usdsmoke.inspect"][1](None)
print(json.dumps(said))
""")
    ((title, message),) = found
    assert title == "Inspect volume" and "usdsmoke is not installed completely" in message


def test_the_type_in_plug_info_is_the_class_that_the_module_defines() -> None:
    info = json.loads((PLUGIN_FOLDER / "plugInfo.json").read_text())
    (plugin,) = info["Plugins"]
    (type_name,) = plugin["Info"]["Types"]
    module, _, class_name = type_name.rpartition(".")
    assert plugin["Type"] == "python" and plugin["Name"] == module
    assert f"class {class_name}(PluginContainer)" in (PLUGIN_FOLDER / "container.py").read_text()


def test_plugin_path_prints_the_folders_with_which_usd_finds_schemas_and_menu() -> None:
    def run(*arguments: str) -> str:
        command = [sys.executable, "-m", "usdsmoke", "plugin-path", *arguments]
        return subprocess.run(
            command, capture_output=True, text=True, cwd=PROJECT, check=True, timeout=60
        ).stdout

    folders = json.loads(run("--json"))
    assert run() == f"{folders['schema']}{os.pathsep}{folders['usdview']}\n"
    code = """
from pxr import Plug
names = {plugin.name for plugin in Plug.Registry().GetAllPlugins()}
print({"usdSmoke", "usdsmoke.ui.usdview.container"} <= names)
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "PXR_PLUGINPATH_NAME": run().strip()},
        timeout=60,
    )
    assert done.stdout == "True\n", done.stderr
