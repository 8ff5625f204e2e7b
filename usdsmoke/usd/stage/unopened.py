"""Layers that a stage names and USD cannot open: what they hold is missing from the stage."""

import os
import re
from pathlib import Path

from pxr import Pcp, Usd

from usdsmoke.base.naming import relative_asset_path

# In OpenUSD's words: "Could not open asset @FILE@ for payload introduced by @LAYER@</prim> --
# REASON." and "Could not load sublayer @FILE@ of layer @LAYER@ -- REASON; skipping."
_ERROR = re.compile(
    r"Could not (?:open asset|load sublayer) @(?P<file>.+?)@ "
    r"(?:for (?P<arc>\w+) introduced by @.*?@(?P<prim><.*?>)|of layer @.*?@)"
    r"(?: -- (?P<reason>.*?))?(?:; skipping)?[\s.]*",
    re.DOTALL,
)
_LONGEST_REASON = 160  # characters: it may quote the line


def unopened_layers(stage: Usd.Stage) -> tuple[str, ...]:
    """A sentence without a full stop for each layer that is missing or not valid.

    Layers are named relative to the stage's file. Muted layers are not meant.
    """
    if not hasattr(stage, "GetCompositionErrors"):
        return ()  # OpenUSD 24.05
    kinds = (Pcp.ErrorType_InvalidAssetPath, Pcp.ErrorType_InvalidSublayerPath)
    texts = [str(error) for error in stage.GetCompositionErrors() if error.errorType in kinds]
    root = stage.GetRootLayer().realPath
    found: dict[str, str] = {}
    for text in texts:
        match = _ERROR.fullmatch(text)
        name = match["file"] if match else text
        found.setdefault(name, _sentence(match, root) if match else " ".join(text.split()))
    return tuple(found.values())


def _sentence(match: re.Match[str], root: str) -> str:
    file, arc = match["file"], "a sublayer"
    if match["arc"]:
        arc = f"a {match['arc']} of {match['prim']}"
    name = file
    if root and os.path.isabs(file):
        name = relative_asset_path(file, Path(root).parent)
    if not match["reason"]:
        why = "there is no such file. Check the path"
    else:
        reason = re.sub(rf"{re.escape(file)}:(\d+):\d+: ", r"line \1: ", match["reason"])
        reason = " ".join(reason.replace(file, name).split())[:_LONGEST_REASON]
        why = f"{reason}. Correct it, or export it again"
    return f"the layer {name}, {arc}, cannot be opened: {why}. The rest is used without it"
