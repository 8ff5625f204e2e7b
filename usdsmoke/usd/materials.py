"""Which material a Volume is bound to, and whether its volume shader reads a look's colours."""

import re
from collections.abc import Collection, Iterator

from pxr import Usd, UsdShade

from usdsmoke.base.naming import COLOUR_CHANNELS, COLOUR_VECTORS
from usdsmoke.base.sections import LayerConfig
from usdsmoke.base.volume import BoundMaterial
from usdsmoke.usd.diagnostics import captured_diagnostics

BINDING = "material:binding"
_COLLECTION = f"{BINDING}:collection"
_VOLUME = "volume"  # a terminal of a material: outputs:volume, outputs:arnold:volume
_NAME = re.compile(r"[\w:]+")


def find_materials(volume: Usd.Prim) -> tuple[BoundMaterial, ...]:
    """The materials that a Volume is bound to, one for each purpose.

    Bindings of ancestors and of collections count, as UsdShade resolves them.
    """
    binding = UsdShade.MaterialBindingAPI(volume)
    found: dict[str, BoundMaterial] = {}
    with captured_diagnostics():  # a missing MaterialBindingAPI is said by a validator
        bound = [binding.ComputeBoundMaterial(name) for name in binding.GetMaterialPurposes()]
    for material, relationship in bound:
        if not material or not relationship or str(material.GetPath()) in found:
            continue
        shaders = list(_volume_shaders(material))
        path = str(material.GetPath())
        can_replace = _is_weaker(relationship, volume)
        found[path] = BoundMaterial(path, _colours_read(shaders), can_replace, bool(shaders))
    return tuple(found.values())


def binds_material(config: LayerConfig, has_colour: bool, bound: tuple[BoundMaterial, ...]) -> bool:
    """Whether a look binds a material of its own.

    Args:
        has_colour: False for a look of density alone, which every material shows.
        bound: the materials that the source has bound.
    """
    if not has_colour or config.material == "none":
        return False
    if not all(material.can_replace for material in bound):
        return False
    return config.material == "replace" or not any(material.has_volume for material in bound)


def purposes_to_bind(volume: Usd.Prim) -> list[str]:
    """The purposes, such as ``full``, with a binding of their own here or above.

    UsdShade asks for them before bindings for all purposes, also those of a Volume itself.
    """
    found = []
    binding = UsdShade.MaterialBindingAPI(volume)
    with captured_diagnostics():
        for purpose in filter(None, binding.GetMaterialPurposes()):
            direct, collection = f"{BINDING}:{purpose}", f"{_COLLECTION}:{purpose}:"
            _, relationship = binding.ComputeBoundMaterial(purpose)
            name = relationship.GetName() if relationship else ""
            if volume.HasRelationship(direct) or name == direct or name.startswith(collection):
                found.append(str(purpose))
    return found


def hiding_material(volume: Usd.Prim, colours: Collection[str]) -> BoundMaterial | None:
    """A bound material that reads none of ``colours`` for Volumes; None if there is none."""
    hiding = (material for material in find_materials(volume) if material.hides(colours))
    return next(hiding, None)


def _is_weaker(relationship: Usd.Relationship, volume: Usd.Prim) -> bool:
    """True if a binding on the Volume itself, in a stronger layer, wins over this one."""
    if relationship.GetPrim() == volume:
        return not relationship.GetName().startswith(_COLLECTION)
    strength = UsdShade.MaterialBindingAPI.GetMaterialBindingStrength(relationship)
    return bool(strength != UsdShade.Tokens.strongerThanDescendants)


def _volume_shaders(material: UsdShade.Material) -> Iterator[Usd.Prim]:
    """The shaders and node graphs behind the volume terminals of all render contexts."""
    to_visit = [
        output.GetAttr() for output in material.GetOutputs() if _is_volume(output.GetBaseName())
    ]
    seen = set()
    while to_visit:
        for path in to_visit.pop().GetConnections():
            prim = material.GetPrim().GetStage().GetPrimAtPath(path.GetPrimPath())
            if not prim or prim in seen or prim == material.GetPrim():
                continue
            seen.add(prim)
            yield prim
            to_visit += [item for item in prim.GetAttributes() if item.HasAuthoredConnections()]


def _is_volume(base_name: str) -> bool:
    """
    >>> _is_volume("arnold:volume"), _is_volume("surface")
    (True, False)
    """
    return base_name.rpartition(":")[2] == _VOLUME


def _colours_read(shaders: Collection[Usd.Prim]) -> tuple[str, ...]:
    """The colour grids of looks that texts on the shaders name, in whatever input."""
    texts = [
        value
        for prim in shaders
        for attribute in prim.GetAttributes()
        if isinstance(value := attribute.Get(), str)
    ]
    words = {word for text in texts for word in _NAME.findall(text)}
    return tuple(name for name in (*COLOUR_VECTORS, *COLOUR_CHANNELS) if name in words)
