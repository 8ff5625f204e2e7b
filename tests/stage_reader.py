"""Everything a stage composes to, as JSON, by USD alone: no usdsmoke, no plugin of it.

    python -m tests.stage_reader STAGE [--original PRIM]... [--mute LAYER]...

is run in a process of its own, so that nothing this package has registered or opened counts.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd, UsdGeom

__all__ = ["read_stage"]

PROJECT = Path(__file__).resolve().parents[1]
_ALL = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)


def read_stage(
    stage_file: Path | str, original: tuple[str, ...] = (), mute: tuple[Path | str, ...] = ()
) -> dict[str, Any]:
    """What a process without usdsmoke composes.

    Args:
        stage_file: the stage.
        original: prims whose variant ``original`` of the set ``look`` is selected first.
        mute: layers that are muted first.
    """
    command = [sys.executable, "-m", "tests.stage_reader", str(stage_file)]
    for prim in original:
        command += ["--original", prim]
    for layer in mute:
        command += ["--mute", str(layer)]
    environment = {key: value for key, value in os.environ.items() if key != "PXR_PLUGINPATH_NAME"}
    done = subprocess.run(
        command, cwd=PROJECT, env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    told: dict[str, Any] = json.loads(done.stdout)
    return told | {"stderr": done.stderr}


def _describe(stage: Usd.Stage) -> dict[str, Any]:
    prims = {}
    for prim in Usd.PrimRange.Stage(stage, _ALL):
        prims[str(prim.GetPath())] = {
            "type": prim.GetTypeName(),
            "specifier": str(prim.GetSpecifier()),
            "schemas": list(prim.GetAppliedSchemas()),
            "kind": prim.GetMetadata("kind"),
            "active": prim.IsActive(),
            "instance": prim.IsInstance(),
            "sets": [name for name in prim.GetVariantSets().GetNames() if name != "look"],
            "properties": {
                item.GetName(): _property(item) for item in prim.GetAuthoredProperties()
            },
        }
    root = stage.GetRootLayer()
    return {
        "prims": prims,
        "default": root.defaultPrim,
        "up": str(UsdGeom.GetStageUpAxis(stage)),
        "unit": UsdGeom.GetStageMetersPerUnit(stage),
        "rates": [stage.GetTimeCodesPerSecond(), stage.GetFramesPerSecond()],
        "range": [stage.GetStartTimeCode(), stage.GetEndTimeCode()],
        "layers": [layer.identifier for layer in stage.GetLayerStack(False)],
        "errors": [str(error) for error in getattr(stage, "GetCompositionErrors", list)()],
    }


def _property(item: Usd.Property) -> Any:
    if isinstance(item, Usd.Relationship):
        return [str(path) for path in item.GetTargets()]
    return {
        "default": _plain(item.Get()),
        "samples": {str(code): _plain(item.Get(code)) for code in item.GetTimeSamples()},
        "connections": [str(path) for path in item.GetConnections()],
    }


def _plain(value: Any) -> str:
    return str(value.resolvedPath) if isinstance(value, Sdf.AssetPath) else repr(value)


def _main(arguments: list[str]) -> None:
    stage_file, *options = arguments
    stage = Usd.Stage.Open(stage_file)
    for name, value in zip(options[::2], options[1::2], strict=True):
        if name == "--mute":
            stage.MuteLayer(value)
        else:
            with Usd.EditContext(stage, stage.GetSessionLayer()):
                stage.GetPrimAtPath(value).GetVariantSet("look").SetVariantSelection("original")
    assert not [name for name in sys.modules if name.split(".")[0] == "usdsmoke"]
    print(json.dumps(_describe(stage)))


if __name__ == "__main__":
    _main(sys.argv[1:])
