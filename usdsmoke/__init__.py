"""usdsmoke stylizes the smoke of a USD stage after an example image and writes a new look layer.

    >>> import usdsmoke
    >>> usdsmoke.__version__
    '0.1.0'

    usdsmoke.inspect("shot.usda")                                     what is on the stage
    usdsmoke.stylize("shot.usda", style="fire.png", output="look")    the main job
    usdsmoke.preview("look/shot_look.usda", "look.png")               what it looks like
    usdsmoke.validate("look/look.usda")                               is the result sound
    usdsmoke.verify("look/look.usda")                                 what has changed since
    usdsmoke.rerun("look/look.usda", output="again")                  the same once more
    usdsmoke.settings()                                               every setting, explained

Importing this package loads nothing heavy: each public name is looked up when it is first used.
It tells USD where its schemas are, so that stages opened afterwards know UsdSmokeStyleAPI.
"""

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from usdsmoke.audit.rerun import rerun
    from usdsmoke.audit.verify import verify
    from usdsmoke.base.errors import UsdSmokeError
    from usdsmoke.base.resolve import resolve_config, settings
    from usdsmoke.base.settings import Config
    from usdsmoke.farm.dask import stylize_on_cluster
    from usdsmoke.farm.openjd import submit
    from usdsmoke.pictures.preview import preview
    from usdsmoke.pipeline import Request, assemble, run_coarse, run_window, stylize
    from usdsmoke.usd.inspect import inspect
    from usdsmoke.usd.rules import validate

__all__ = [
    "Config",
    "Request",
    "UsdSmokeError",
    "__version__",
    "assemble",
    "inspect",
    "preview",
    "rerun",
    "resolve_config",
    "run_coarse",
    "run_window",
    "settings",
    "stylize",
    "stylize_on_cluster",
    "submit",
    "validate",
    "verify",
]

__version__ = "0.1.0"

_HOME = {
    "Config": "usdsmoke.base.settings",
    "Request": "usdsmoke.pipeline",
    "UsdSmokeError": "usdsmoke.base.errors",
    "assemble": "usdsmoke.pipeline",
    "inspect": "usdsmoke.usd.inspect",
    "preview": "usdsmoke.pictures.preview",
    "rerun": "usdsmoke.audit.rerun",
    "resolve_config": "usdsmoke.base.resolve",
    "run_coarse": "usdsmoke.pipeline",
    "run_window": "usdsmoke.pipeline",
    "settings": "usdsmoke.base.resolve",
    "stylize": "usdsmoke.pipeline",
    "stylize_on_cluster": "usdsmoke.farm.dask",
    "submit": "usdsmoke.farm.openjd",
    "validate": "usdsmoke.usd.rules",
    "verify": "usdsmoke.audit.verify",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


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
