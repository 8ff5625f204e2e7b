"""usdsmoke stylizes the smoke of a USD stage after an example image and writes a new look layer.

    >>> import usdsmoke
    >>> usdsmoke.__version__
    '0.2.0.dev0'

    usdsmoke.inspect("shot.usda")                                     what is on the stage
    usdsmoke.plan("shot.usda", style="fire.png")                      what a run would do and cost
    usdsmoke.stylize("shot.usda", style="fire.png", output="look")    the run
    usdsmoke.train("shot.usda", "fire.png", "fire.safetensors")       a network that runs start from
    usdsmoke.preview("look/shot_look.usda", "look.png")               a picture of the result
    usdsmoke.validate("look/shot_look.usda")                          whether the result is sound
    usdsmoke.provenance("look/look.usda")                             how it was made
    usdsmoke.verify("look/look.usda")                                 what has changed since
    usdsmoke.rerun("look/look.usda", output="again")                  make it again
    usdsmoke.report("shot.usda", "fire.png", "report")                what settings gain and cost
    usdsmoke.settings()                                               every setting, explained

Stages are paths or open ``Usd.Stage`` objects. ``settings`` is a mapping such as
``{"optimize.iterations": 3}`` or ``{"optimize": {"iterations": 3}}``, a YAML file, or a list of
these. Errors derive from ``UsdSmokeError``.

Importing this package loads nothing heavy: each public name is looked up when it is first used.
It tells USD where its schemas are, so that stages opened afterwards know UsdSmokeStyleAPI.
"""

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from usdsmoke.audit import provenance as provenance
    from usdsmoke.audit import rerun as rerun
    from usdsmoke.audit import verify as verify
    from usdsmoke.base.errors import UsdSmokeError as UsdSmokeError
    from usdsmoke.config.resolve import settings as settings
    from usdsmoke.config.settings import Config as Config
    from usdsmoke.pictures.preview import preview as preview
    from usdsmoke.pipeline import plan as plan
    from usdsmoke.pipeline import stylize as stylize
    from usdsmoke.runs.train import train as train
    from usdsmoke.usd.inspect import inspect as inspect
    from usdsmoke.usd.rules import validate as validate
    from usdsmoke.work_precision import make_report as report

__all__ = [
    "Config",
    "UsdSmokeError",
    "__version__",
    "inspect",
    "plan",
    "preview",
    "provenance",
    "report",
    "rerun",
    "settings",
    "stylize",
    "train",
    "validate",
    "verify",
]

__version__ = "0.2.0.dev0"

# public name: module, name in it
_HOME = {
    "Config": ("config.settings", "Config"),
    "UsdSmokeError": ("base.errors", "UsdSmokeError"),
    "inspect": ("usd.inspect", "inspect"),
    "plan": ("pipeline", "plan"),
    "preview": ("pictures.preview", "preview"),
    "provenance": ("audit", "provenance"),
    "report": ("work_precision", "make_report"),
    "rerun": ("audit", "rerun"),
    "settings": ("config.resolve", "settings"),
    "stylize": ("pipeline", "stylize"),
    "train": ("runs.train", "train"),
    "validate": ("usd.rules", "validate"),
    "verify": ("audit", "verify"),
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _HOME[name]
    try:
        return getattr(importlib.import_module(f"{__name__}.{module}"), attribute)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith(__name__):
            raise
        from usdsmoke.base.machine import missing_package

        raise missing_package(error.name) from None


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})


def _announce_schemas() -> None:
    """Through the environment as long as USD is not loaded, which reads it then."""
    folder = os.path.join(os.path.dirname(os.path.abspath(__file__)), "plugin")
    if "pxr.Tf" in sys.modules:
        importlib.import_module("pxr.Plug").Registry().RegisterPlugins(folder)
        return
    folders = os.environ.get("PXR_PLUGINPATH_NAME", "").split(os.pathsep)
    if folder not in folders:
        os.environ["PXR_PLUGINPATH_NAME"] = os.pathsep.join([*filter(None, folders), folder])


_announce_schemas()
