"""What the looks on a stage were made with and from, as text."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pxr import Usd

from usdsmoke.audit import FoundRecord
from usdsmoke.base.errors import LayerError
from usdsmoke.ui.cli.record_text import provenance_text
from usdsmoke.ui.usdview.looks import Look, looks_of, shown_run
from usdsmoke.usd import schema

_AUTHORSHIP = "authorship:"
_SAID_BETTER = "inputs"  # of an authorship; the layer's record has it item by item


def look_text(volumes: Sequence[Usd.Prim], looks: Sequence[Look]) -> str:
    """The records of the Volumes' looks, and what the composed Volumes say of themselves.

    Only the layers are read; ``usdsmoke validate`` compares the files with them.

    Args:
        volumes: composed prims.
        looks: from ``find_looks``; those of other Volumes are left out.
    """
    blocks = [_volume_lines(volume) for volume in volumes]
    blocks += [_look_lines(look) for look in looks_of(volumes, looks)]
    return "\n\n".join("\n".join(lines) for lines in blocks)


def _volume_lines(volume: Usd.Prim) -> list[str]:
    run = shown_run(volume)
    lines = [f"Volume <{volume.GetPath()}>: {f'shows run {run}' if run else 'shows its source'}"]
    for name in (schema.EXTINCTION_PER_DENSITY, schema.EMISSION_MODE, schema.COLOR_SPACE):
        attribute = volume.GetAttribute(name)
        if attribute and attribute.HasAuthoredValue():
            lines.append(f"  {name}: {_plain(attribute.Get())}")
    for attribute in volume.GetAuthoredAttributes():
        if attribute.GetName().startswith(_AUTHORSHIP):
            instance, _, key = attribute.GetName().removeprefix(_AUTHORSHIP).partition(":")
            if key != _SAID_BETTER and attribute.HasAuthoredValue():
                lines.append(f"  {instance} {key}: {_plain(attribute.Get())}")
    return lines


def _look_lines(look: Look) -> list[str]:
    """The record as ``usdsmoke provenance`` prints it, from the layer as it is in memory."""
    place = Path(look.layer.realPath or look.layer.identifier)
    try:
        text = provenance_text(FoundRecord(place, place.parent, look.layer))
    except LayerError as error:
        text = str(error)
    heading = f"look {look.layer.GetDisplayName()}{' (muted)' * look.muted}"
    return [heading, *(f"  {line}" for line in text.splitlines())]


def _plain(value: Any) -> str:
    """A value on one line."""
    items = _items(value)
    if items is not None:
        return ", ".join(map(str, items))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _items(value: Any) -> list[Any] | None:
    """The items of a list or of one of USD's arrays; None for anything else."""
    if isinstance(value, (str, bytes)) or not hasattr(value, "__len__"):
        return None
    return list(value)
