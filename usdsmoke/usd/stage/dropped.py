"""What a stage names and USD does not use: layers, prims and offsets that composition drops."""

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
_LONGEST_REASON = 300  # characters: it may quote the line


def _kinds(*names: str) -> tuple[Pcp.ErrorType, ...]:
    """Those of Pcp's types that this version of OpenUSD has."""
    return tuple(getattr(Pcp, kind) for n in names if hasattr(Pcp, kind := f"ErrorType_{n}"))


_LAYERS = _kinds("InvalidAssetPath", "InvalidSublayerPath")
# Other errors of composition that may lose smoke or change its timing. Muted layers are not meant,
# nor what is told of targets, permissions and variants, which many sound stages have.
_OTHERS = _kinds(
    "ArcCycle",
    "InvalidPrimPath",
    "InvalidReferenceOffset",
    "InvalidSublayerOffset",
    "SublayerCycle",
    "UnresolvedPrimPath",
    "VariableExpressionError",
)


def dropped_opinions(stage: Usd.Stage) -> tuple[str, ...]:
    """A sentence without a full stop for each layer, prim and offset that composition drops.

    Layers are named relative to the stage's file; the others are told in OpenUSD's words.
    """
    if not hasattr(stage, "GetCompositionErrors"):
        return ()  # OpenUSD 24.05
    root = stage.GetRootLayer().realPath
    found: dict[str, str] = {}
    for error in stage.GetCompositionErrors():
        text = " ".join(str(error).split())
        if error.errorType in _LAYERS:
            match = _ERROR.fullmatch(str(error))
            name = match["file"] if match else text
            found.setdefault(name, _sentence(match, root) if match else text)
        elif error.errorType in _OTHERS:
            told = text.removesuffix(".")[:_LONGEST_REASON]
            found.setdefault(text, f"OpenUSD leaves out a part of the stage: {told}. Correct it")
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
