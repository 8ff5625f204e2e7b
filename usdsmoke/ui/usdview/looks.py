"""The looks on an open stage: which there are, their records as text, and showing the next one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Sdf, Tf, Usd

from usdsmoke.audit import FoundRecord
from usdsmoke.base.errors import LayerError, StageError
from usdsmoke.base.naming import ORIGINAL, VARIANT_SET
from usdsmoke.ui.cli.record_text import provenance_text
from usdsmoke.usd import schema
from usdsmoke.usd.diagnostics import captured_diagnostics
from usdsmoke.usd.layer_record import read_record, record_values

# A muted layer belongs to nobody and would be gone, with edits that were not saved. What FindOrOpen
# gives keeps a layer alive; what stages give does not.
_HELD: dict[str, Sdf.Layer] = {}


@dataclass(frozen=True)
class Look:
    """A look layer that a stage is made of, muted or not."""

    layer: Sdf.Layer
    values: dict[str, str]  # the plain texts of its record
    muted: bool
    volume_paths: frozenset[Sdf.Path]  # where it styles Volumes, in its own namespace

    @property
    def run(self) -> str:
        """The run's id."""
        return self.values["run"]

    @property
    def created(self) -> str:
        """When the run was begun, UTC; "" where the record cannot be read."""
        try:
            return read_record(self.layer).created
        except LayerError:
            return ""


def find_looks(stage: Usd.Stage) -> list[Look]:
    """The stage's look layers, muted ones too, oldest first."""
    muted = set(stage.GetMutedLayers())
    layers = {layer.identifier: layer for layer in stage.GetUsedLayers(includeClipLayers=False)}
    for identifier in muted:
        layer = _HELD.get(identifier) or _open_layer(identifier)
        if layer:
            layers[identifier] = layer
    looks = []
    for identifier, layer in layers.items():
        values = record_values(layer)
        volume_paths = _styled_paths(layer) if values else frozenset()
        if volume_paths:
            looks.append(Look(layer, values, identifier in muted, volume_paths))
    return sorted(looks, key=lambda look: (look.created, look.run))


def looks_of(volumes: Sequence[Usd.Prim], looks: Sequence[Look]) -> list[Look]:
    """Those looks that style any of the Volumes, also through references."""
    paths = {path for volume in volumes for path in _composed_paths(volume)}
    return [look for look in looks if look.volume_paths & paths]


def shown_run(volume: Usd.Prim) -> str:
    """The id of the run whose result a Volume shows; "" where it shows its source."""
    attribute = volume.GetAttribute(schema.RUN)
    return str(attribute.Get() or "") if attribute else ""


def show_next(stage: Usd.Stage, volumes: Sequence[Usd.Prim]) -> str:
    """Show the next look of the Volumes, after the last the source, and so on; what is shown now.

    Where a Volume or a prim above it has the variant set ``look``, its selection is switched in the
    session layer, with that of the asset's other root prims. Otherwise look layers are muted and
    unmuted, which concerns all the Volumes they style. No file is touched, and no layer loses
    edits.

    Raises:
        StageError: there is no look to switch, it cannot be muted, or there is no session layer.
    """
    owners = [owner.GetPath() for volume in volumes if (owner := _variant_owner(volume))]
    if owners:
        return _switch_variants(stage, owners)
    looks = looks_of(volumes, find_looks(stage))
    if not looks:
        names = ", ".join(f"<{volume.GetPath()}>" for volume in volumes)
        raise StageError(
            f"there is no look of usdsmoke on {names}: neither a variant set "
            f'"{VARIANT_SET}" with a variant "{ORIGINAL}" nor a look layer. Open the stage that '
            "usdsmoke stylize wrote, or put its look layer over this one."
        )
    return _switch_layers(stage, volumes, looks)


def _switch_layers(stage: Usd.Stage, volumes: Sequence[Usd.Prim], looks: Sequence[Look]) -> str:
    if any(look.layer == stage.GetRootLayer() for look in looks):
        raise StageError(
            f"the look {stage.GetRootLayer().identifier} is the root layer, which cannot be "
            "muted. Open the root layer that was written beside it, NAME_look.usda."
        )
    runs = {shown_run(volume) for volume in volumes}
    shown = next((n for n, look in enumerate(looks) if not look.muted and look.run in runs), None)
    following = 0 if shown is None else shown + 1
    chosen = looks[following] if following < len(looks) else None
    hidden = [look.layer.identifier for look in looks if look is not chosen]
    _HELD.update({identifier: Sdf.Layer.FindOrOpen(identifier) for identifier in hidden})
    stage.MuteAndUnmuteLayers(hidden, [] if chosen is None else [chosen.layer.identifier])
    if chosen is None:
        return f"{ORIGINAL}: muted {', '.join(look.layer.GetDisplayName() for look in looks)}"
    _HELD.pop(chosen.layer.identifier, None)
    name = chosen.values.get("look", "") or "look"
    return f"{name}: {chosen.layer.GetDisplayName()}, run {chosen.run}"


def _switch_variants(stage: Usd.Stage, owners: Sequence[Sdf.Path]) -> str:
    session = stage.GetSessionLayer()
    if session is None:
        raise StageError(
            "this stage has no session layer, so a look cannot be chosen without editing files. "
            "Open it in usdview."
        )
    switched: dict[Sdf.Path, str] = {}
    for path in owners:
        owner = stage.GetPrimAtPath(path)
        if path in switched or not owner:
            continue
        chosen = _next_variant(owner)
        prims = [prim for prim in _switched_together(owner) if chosen in _variants(prim)]
        switched.update({prim.GetPath(): chosen for prim in prims})
        with Sdf.ChangeBlock():
            for prim in prims:
                spec = Sdf.CreatePrimInLayer(session, prim.GetPath())
                spec.variantSelections[VARIANT_SET] = chosen
    return "; ".join(f"{chosen}: variant of <{path}>" for path, chosen in switched.items())


def _next_variant(prim: Usd.Prim) -> str:
    names = [ORIGINAL, *(name for name in _variants(prim) if name != ORIGINAL)]
    now = prim.GetVariantSet(VARIANT_SET).GetVariantSelection()
    return names[((names.index(now) if now in names else 0) + 1) % len(names)]


def _switched_together(owner: Usd.Prim) -> list[Usd.Prim]:
    """A prim with looks and its neighbours that the same asset gives theirs.

    An asset of several root prims has the same looks on each: one look is all of them.
    """
    made = _variant_sites(owner)
    neighbours = [prim for prim in owner.GetParent().GetChildren() if prim != owner]
    assets = {layer for layer, _ in made}
    return [owner] + [
        prim
        for prim in neighbours
        if (sites := _variant_sites(prim)) - made and assets & {layer for layer, _ in sites}
    ]


def _variant_sites(prim: Usd.Prim) -> set[tuple[Sdf.Layer, Sdf.Path]]:
    """Where the looks of a prim are authored; none where it has no such variants."""
    if ORIGINAL not in _variants(prim):
        return set()
    return {
        (spec.layer, spec.path) for spec in prim.GetPrimStack() if VARIANT_SET in spec.variantSets
    }


def _variants(prim: Usd.Prim) -> list[str]:
    return list(prim.GetVariantSet(VARIANT_SET).GetVariantNames())


def _variant_owner(volume: Usd.Prim) -> Usd.Prim | None:
    """The Volume or the nearest prim above it that has looks as variants and can be authored."""
    prim = volume
    while prim and not prim.IsPseudoRoot():
        if not prim.IsInstanceProxy() and ORIGINAL in _variants(prim):
            return prim
        prim = prim.GetParent()
    return None


def _open_layer(identifier: str) -> Sdf.Layer | None:
    """A layer that may have no file any more, or a damaged one."""
    with captured_diagnostics():
        try:
            return Sdf.Layer.FindOrOpen(identifier)
        except Tf.ErrorException:
            return None


def _styled_paths(layer: Sdf.Layer) -> frozenset[Sdf.Path]:
    """Prims that carry the look's API schema, without the variants they may stand in."""
    found = set()

    def visit(path: Sdf.Path) -> None:
        if not (path.IsPrimPath() or path.IsPrimVariantSelectionPath()):
            return
        spec = layer.GetPrimAtPath(path)
        if spec and spec.HasInfo("apiSchemas"):
            if schema.LOOK_API in spec.GetInfo("apiSchemas").GetAddedOrExplicitItems():
                found.add(path.StripAllVariantSelections())

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return frozenset(found)


def _composed_paths(prim: Usd.Prim) -> set[Sdf.Path]:
    """Where the layers that a prim is composed of may have opinions on it."""
    paths, waiting = set(), [prim.GetPrimIndex().rootNode]
    if prim.IsInstanceProxy():
        waiting = [prim.GetPrimInPrototype().GetPrimIndex().rootNode]
    while waiting:
        node = waiting.pop()
        paths.add(node.path.StripAllVariantSelections())
        waiting += list(node.children)
    return paths


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
