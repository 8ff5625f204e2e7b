"""Opening a stage, with usdSmoke's own schema known to USD."""

import os

from pxr import Usd

from usdsmoke.usd.diagnostics import open_quietly
from usdsmoke.usd.schema import register_schema

__all__ = ["open_stage"]


def open_stage(file_path: str | os.PathLike[str]) -> Usd.Stage:
    """The composed stage of a .usda, .usdc, .usd or .usdz file, all payloads loaded.

    Raises:
        StageError: the file is missing, of no USD format, or cannot be parsed.
    """
    register_schema()  # the schema registry, built with the first stage, never looks again
    return open_quietly(os.fspath(file_path))
