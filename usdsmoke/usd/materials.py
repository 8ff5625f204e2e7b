"""Which material a Volume is bound to, and which of its volume shaders read a look's colours.

A material may have a volume shader for each render context, such as ``outputs:arnold:volume``. A
shader reads a grid where one of its inputs names it: by its own value, or by that of an input of
the material or of a node graph that it is connected to. In Storm an input that is connected to no
``HwFieldReader`` is a number, whatever its name.
"""

import re
from collections.abc import Collection, Iterator
from typing import Any

from pxr import Usd, UsdShade

from usdsmoke.base.naming import COLOUR_CHANNELS, COLOUR_VECTORS
from usdsmoke.base.volume import BoundMaterial
from usdsmoke.config.run_sections import LayerConfig
from usdsmoke.usd.diagnostics import captured_diagnostics
from usdsmoke.usd.layer_record import record_values

BINDING = "material:binding"
_COLLECTION = f"{BINDING}:collection"
_VOLUME = "volume"  # a terminal of a material: outputs:volume, outputs:arnold:volume
_NAME = re.compile(r"[\w:]+")
# Inputs that name grids, such as HwFieldReader's fieldname, MaterialX's geomprop, Arnold's
# emission_channel, RenderMan's varname, MoonRay's emission_grid.
_NAMES_GRID = re.compile(r"field|channel|geomprop|primvar|varname|grid|attr", re.IGNORECASE)
_INPUT = "inputs:"
_ARNOLD = "arnold:standard_volume"
_SAME_OPACITY = 2.0  # times the extinction: less may be a choice
ALL_RENDERERS = "renderers"  # of ``hiding_words``
_RENDERERS = {
    "": "renderers without a shader of their own",
    "glslfx": "Storm",
    "mtlx": "MaterialX",
    "arnold": "Arnold",
    "kma": "Karma",
    "ri": "RenderMan",
}


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
        path, shaders = str(material.GetPath()), _volume_shaders(material)
        readers = {context: _colours_read(prims) for context, prims in shaders.items()}
        multiplies = tuple(name for name, prims in shaders.items() if _multiplies(prims))
        weaker = _is_weaker(relationship, volume)
        numbers = {name: _density(prims) for name, prims in shaders.items()}
        densities = {name: number for name, number in numbers.items() if number is not None}
        is_of_look = any(record_values(spec.layer) for spec in material.GetPrim().GetPrimStack())
        found[path] = BoundMaterial(path, readers, weaker, multiplies, densities, is_of_look)
    return tuple(found.values())


def binds_material(config: LayerConfig, has_colour: bool, bound: tuple[BoundMaterial, ...]) -> bool:
    """Whether a look binds a material of its own.

    Args:
        has_colour: False for a look of density alone, which every material shows.
        bound: the materials that the source has bound. That of an earlier look, which is stylized
            once more, is made for other numbers.
    """
    if not has_colour or config.material == "none":
        return False
    if not all(material.can_replace for material in bound):
        return False
    theirs = [material for material in bound if material.readers and not material.is_of_look]
    return config.material == "replace" or not theirs


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
    """A bound material that reads none of ``colours`` in a context; None if there is none."""
    hiding = (material for material in find_materials(volume) if material.hidden_in(colours))
    return next(hiding, None)


def hiding_words(material: BoundMaterial, colours: Collection[str]) -> tuple[str, str]:
    """What a material that hides a look does, and the renderers that do not show it.

    These are ``ALL_RENDERERS`` where the material has no shader that reads the look.

    >>> some = BoundMaterial("/m", {"glslfx": (), "arnold": ("emission",)}, True)
    >>> hiding_words(some, ["emission"])
    ('reads no emission in its shader for Storm (outputs:glslfx:volume)', 'Storm')
    >>> hiding_words(BoundMaterial("/m", {"": ()}, True), ["emission"])
    ('reads no emission', 'renderers')
    """
    contexts, text = material.hidden_in(colours), f"reads no {' or '.join(colours)}"
    if len(contexts) >= len(material.readers):
        return text, ALL_RENDERERS
    names = " and ".join(_RENDERERS.get(context, context) for context in contexts)
    outputs = ", ".join(":".join(filter(None, ("outputs", c, _VOLUME))) for c in contexts)
    shaders = "shader" if len(contexts) == 1 else "shaders"
    return f"{text} in its {shaders} for {names} ({outputs})", names


def brightness_words(material: BoundMaterial, emission_mode: str) -> str:
    """That renderers show a look of ``layer.emission_mode`` too dark or bright; "" where none do.

    >>> brightness_words(BoundMaterial("/m", {}, True, ("arnold",)), "absolute")
    'the material </m> multiplies the emission by the density in Arnold. Stylize with \
--emission-mode perDensity, or set emission_mode to channel'
    """
    if emission_mode != "absolute" or not material.multiplies:
        return ""
    names = " and ".join(_RENDERERS.get(name, name) for name in material.multiplies)
    return (
        f"the material <{material.prim_path}> multiplies the emission by the density in {names}. "
        "Stylize with --emission-mode perDensity, or set emission_mode to channel"
    )


def opacity_words(material: BoundMaterial, extinction: float) -> str:
    """That a renderer shows a look with another opacity than it was made for; "" where none does.

    Args:
        extinction: that the look is made for, in the renderer's unit of length, per density.

    >>> opacity_words(BoundMaterial("/m", {}, True, densities={"arnold": 1.0}), 67.6)
    'the material </m> multiplies the density by 1 in Arnold, and the look is made for 67.6. Set \
inputs:density of its shader to 67.6'
    """
    for name, number in material.densities.items() if extinction > 0 else ():
        if not extinction / _SAME_OPACITY <= number <= extinction * _SAME_OPACITY:
            return (
                f"the material <{material.prim_path}> multiplies the density by {number:.4g} in "
                f"{_RENDERERS.get(name, name)}, and the look is made for {extinction:.4g}. Set "
                f"inputs:density of its shader to {extinction:.4g}"
            )
    return ""


def hiding_advice(can_replace: bool) -> str:
    """What makes a hidden look seen, as a sentence without its full stop.

    Args:
        can_replace: see ``BoundMaterial``.
    """
    if can_replace:
        return "Stylize with --set layer.material=replace, or let the material read it"
    return "Bind another material there: this binding is stronger than any on the Volume"


def _is_weaker(relationship: Usd.Relationship, volume: Usd.Prim) -> bool:
    """True if a binding on the Volume itself, in a stronger layer, wins over this one."""
    if relationship.GetPrim() == volume:
        return not relationship.GetName().startswith(_COLLECTION)
    strength = UsdShade.MaterialBindingAPI.GetMaterialBindingStrength(relationship)
    return bool(strength != UsdShade.Tokens.strongerThanDescendants)


def _volume_shaders(material: UsdShade.Material) -> dict[str, list[Usd.Prim]]:
    """The shaders of each context with a volume shader of its own."""
    found = {}
    for output in material.GetOutputs():
        context, _, terminal = output.GetBaseName().rpartition(":")
        shaders = list(_shaders_behind(output.GetAttr())) if terminal == _VOLUME else []
        if shaders:
            found[context] = shaders
    return found


def _multiplies(shaders: Collection[Usd.Prim]) -> bool:
    """Whether a shader that reads a colour multiplies it by the density, as Arnold's can."""
    return bool(_colours_read(shaders)) and any(_mode(prim) == "density" for prim in shaders)


def _density(shaders: Collection[Usd.Prim]) -> float | None:
    """By what Arnold's shader multiplies the density; None where that is not known."""
    ours = [prim for prim in shaders if _token(prim, "info:id") == _ARNOLD]
    if not ours or not _colours_read(shaders):
        return None
    attribute = ours[0].GetAttribute("inputs:density")
    if not attribute or not (attribute.HasAuthoredValue() or attribute.HasAuthoredConnections()):
        return 1.0
    value = _value(attribute)
    return float(value) if isinstance(value, float | int) else None


def _mode(shader: Usd.Prim) -> str:
    """Arnold's emission mode; "" where it is not authored."""
    return _token(shader, "inputs:emission_mode")


def _token(shader: Usd.Prim, name: str) -> str:
    attribute = shader.GetAttribute(name)
    return _text(attribute) if attribute else ""


def _shaders_behind(terminal: Usd.Attribute) -> Iterator[Usd.Prim]:
    """The shaders of a network, through node graphs and through inputs of the material."""
    stage, to_visit, seen = terminal.GetStage(), [terminal], set()
    while to_visit:
        for path in to_visit.pop().GetConnections():
            prim = stage.GetPrimAtPath(path.GetPrimPath())
            place = path if prim and prim.IsA(UsdShade.NodeGraph) else path.GetPrimPath()
            if not prim or place in seen:
                continue
            seen.add(place)
            if place == path:  # of a graph or a material this one way alone
                to_visit += filter(None, [stage.GetAttributeAtPath(path)])
                continue
            yield prim
            to_visit += [item for item in prim.GetAttributes() if item.HasAuthoredConnections()]


def _colours_read(shaders: Collection[Usd.Prim]) -> tuple[str, ...]:
    """The colour grids of looks that inputs of shaders name."""
    texts = [
        _text(attribute)
        for prim in shaders
        for attribute in prim.GetAttributes()
        if _names_grid(prim, attribute.GetName())
    ]
    words = {word for text in texts for word in _NAME.findall(text)}
    return tuple(name for name in (*COLOUR_VECTORS, *COLOUR_CHANNELS) if name in words)


def _names_grid(shader: Usd.Prim, attribute: str) -> bool:
    name = attribute.removeprefix(_INPUT)
    if name == attribute or not _NAMES_GRID.search(name):
        return False
    weight = shader.GetAttribute("inputs:emission")  # Arnold's
    is_off = _mode(shader) == "none" or (weight and weight.Get() == 0)
    return not (name == "emission_channel" and is_off)


def _text(attribute: Usd.Attribute) -> str:
    value = _value(attribute)
    return value if isinstance(value, str) else ""


def _value(attribute: Usd.Attribute) -> Any:
    """What an input has, maybe by way of other inputs; None where a shader makes it."""
    stage, seen = attribute.GetStage(), set()
    while (paths := attribute.GetConnections()) and paths[0] not in seen:
        source = stage.GetAttributeAtPath(paths[0])
        if not source or not source.GetName().startswith(_INPUT):
            return None
        seen.add(paths[0])
        attribute = source
    return attribute.Get()
