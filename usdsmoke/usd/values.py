"""Attribute values and asset paths, read alike from every supported version of OpenUSD."""

from typing import Any

from pxr import Sdf, Usd


def value_at(attribute: Usd.Attribute, time_code: float | Usd.TimeCode) -> Any:
    """An attribute's value; None where it has none or is blocked.

    Before 26.03, OpenUSD returns the ``Sdf.ValueBlock`` itself between two blocked time samples.
    """
    value = attribute.Get(time_code)
    return None if isinstance(value, Sdf.ValueBlock) else value


def authored_path(asset: Sdf.AssetPath) -> str:
    """The path as the layer spells it. Before 25.05, OpenUSD only keeps an expression's value."""
    return str(getattr(asset, "authoredPath", asset.path))
