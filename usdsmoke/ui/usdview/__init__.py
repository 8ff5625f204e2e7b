"""A plug-in for usdview: the menu *usdsmoke*.

`container` is what usdview loads, and the only module with Qt; it needs ``pxr.Usdviewq``, which
usd-core does not have. `actions` holds what the menu does, `volumes` and `looks` what it does it
to, `command_line` a text to copy. docs/look.md says how to install it.
"""

from pathlib import Path

__all__ = ["PLUGIN_FOLDER"]

PLUGIN_FOLDER = Path(__file__).resolve().parent  # holds plugInfo.json
