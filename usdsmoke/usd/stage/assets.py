"""Which file and grid a field prim shows at which timeCode, and whether that can be used."""

from collections.abc import Iterable, Sequence
from pathlib import PurePath

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from usdsmoke.base.errors import AssetNotResolved
from usdsmoke.base.time_codes import format_time_code, format_time_codes
from usdsmoke.base.volume import FieldSource
from usdsmoke.usd.asset_paths import vdb_problem

__all__ = ["check_assets", "field_source", "field_time_codes", "is_blocked"]


def field_time_codes(prim: Usd.Prim) -> list[float]:
    """Ascending timeCodes at which a field prim's grid may change; none when nothing is animated.

    They are the time samples of ``filePath``, and those of ``fieldName`` and ``fieldIndex`` at
    which their values differ from those before: a file can hold the grids of several timeCodes.
    """
    selectors = [prim.GetAttribute("fieldName"), prim.GetAttribute("fieldIndex")]
    file_codes = set(prim.GetAttribute("filePath").GetTimeSamples())
    selector_codes = sorted({code for item in selectors for code in item.GetTimeSamples()})
    shown = [tuple(item.Get(code) for item in selectors) for code in selector_codes]
    if not file_codes and len(set(shown)) < 2:
        return []
    changes = {
        code
        for n, code in enumerate(selector_codes)
        if (n and shown[n] != shown[n - 1]) or (n == 0 and not file_codes)
    }
    return sorted(file_codes | changes)


def is_blocked(prim: Usd.Prim, time_code: float) -> bool:
    """True when ``filePath`` has no value at ``time_code``: a gap in which nothing is shown."""
    return prim.GetAttribute("filePath").Get(time_code) is None


def field_source(
    relationship: str, prim: Usd.Prim, time_code: float, xforms: UsdGeom.XformCache
) -> FieldSource | None:
    """What a field prim shows at ``time_code``, files unchecked; None in a gap.

    Args:
        relationship: the Volume's name for the field, without ``field:``.
        prim: an OpenVDBAsset.
        time_code: any; time samples are held.
        xforms: a cache at ``time_code``.
    """
    asset = prim.GetAttribute("filePath").Get(time_code)
    if asset is None:
        return None
    return FieldSource(
        relationship=relationship,
        prim_path=str(prim.GetPath()),
        time_code=time_code,
        file_path=str(asset.resolvedPath),
        authored_path=str(asset.authoredPath),
        grid_name=prim.GetAttribute("fieldName").Get(time_code) or "",
        grid_index=prim.GetAttribute("fieldIndex").Get(time_code),
        field_to_stage=np.array(xforms.GetLocalToWorldTransform(prim), dtype=np.float64),
        data_type=prim.GetAttribute("fieldDataType").Get(time_code) or "",
        field_class=prim.GetAttribute("fieldClass").Get(time_code) or "",
    )


def check_assets(prim: Usd.Prim, sources: Sequence[FieldSource]) -> None:
    """Refuse a field whose files cannot be read from disk, naming every timeCode concerned.

    Raises:
        AssetNotResolved: a path is empty, Houdini's own, inside a package, a folder, or resolves to
            no file.
    """
    found = [(source, vdb_problem(source.authored_path, source.file_path)) for source in sources]
    problems = [(source, problem) for source, problem in found if problem]
    if not problems:
        return
    source, problem = problems[0]
    asset = f"@{source.authored_path}@, authored in {_authoring_layer(prim, source.time_code)}"
    raise AssetNotResolved(
        f"the filePath of <{source.prim_path}> at timeCode {format_time_code(source.time_code)} is "
        f"{asset}: {problem}{_also(source.time_code for source, _ in problems[1:])}"
    )


def _authoring_layer(prim: Usd.Prim, time_code: float) -> str:
    """File name of the layer that supplies ``filePath`` at ``time_code``."""
    for spec in prim.GetAttribute("filePath").GetPropertyStack(Usd.TimeCode(time_code)):
        if spec.HasInfo("timeSamples") or spec.HasInfo("default"):
            return _layer_name(spec.layer)
    return "no layer"


def _layer_name(layer: Sdf.Layer) -> str:
    return layer.identifier if layer.anonymous else str(PurePath(layer.realPath))


def _also(time_codes: Iterable[float]) -> str:
    codes = list(time_codes)
    return f" (the same trouble at timeCodes {format_time_codes(codes)})" if codes else ""
