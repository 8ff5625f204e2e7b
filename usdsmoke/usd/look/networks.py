"""The shaders of a look's material for each renderer, as plain data.

All of them extinguish gamma_w * density, add ``emission`` as it is where there is one, and scatter
``albedo`` of the light that they take away, times the colour of the field ``scatter`` where there
is one: in a look's own frames none, unless it is made for lights. Storm scatters the luminance of
that colour: its shaders scatter one number.

Sources: OpenUSD's tests of Storm's volumes; MaterialX 1.39 ``stdlib_defs`` and ``pbrlib_defs``;
Arnold's reference of ``standard_volume`` and a public listing of its parameters; SideFX's of
``kma_volume``; Pixar's of ``PxrVolume``,
``PxrPrimvar``, ``PxrToFloat3`` and ``PxrRemap``, and hdPrman's fallback material. MaterialX and
``kma_volume`` count absorption per metre. USD's Material takes the place of MaterialX's
``volumematerial``, so the terminal is its ``volume`` node.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from pxr import Sdf

from usdsmoke.base.naming import EMISSION
from usdsmoke.usd.look import storm_shader

_TYPES = Sdf.ValueTypeNames


@dataclass(frozen=True)
class Varying:
    """A number, and its values by timeCode where it changes over time."""

    default: float
    samples: Mapping[float, float] = field(default_factory=dict)

    def scaled(self, factor: float) -> "Varying":
        """The same times a factor."""
        samples = {code: value * factor for code, value in self.samples.items()}
        return Varying(self.default * factor, samples)


@dataclass(frozen=True)
class Input:
    """An input of a shader: a value, or ``node.output`` of the shader it is connected to."""

    type_name: Sdf.ValueTypeName
    value: Any = None  # a Varying stands for its numbers
    source: str = ""


@dataclass(frozen=True)
class Node:
    """A shader of a network."""

    name: str
    shader: str  # info:id; "" for the glslfx file
    inputs: Mapping[str, Input]
    output: tuple[str, Sdf.ValueTypeName]


@dataclass(frozen=True)
class Smoke:
    """What the networks are made from."""

    density: str  # name of the relationship and of the grid
    extinction: Varying  # per unit of density, 1/(stage unit)
    albedo: Varying
    anisotropy: float  # mean cosine of scattering; Storm's own lights have no use for it
    stage_units: Varying  # in one unit of the Volume's own space
    meters_per_unit: float
    is_per_density: bool  # the emission is divided by density
    emits: bool = True  # whether there is an emission
    scatter: str = ""  # field of the scattering colour; "": white


@dataclass(frozen=True)
class Network:
    """Shaders for one renderer; the last one has the volume terminal."""

    context: str  # of the material's output: outputs:CONTEXT:volume
    nodes: tuple[Node, ...]


def network(target: str, smoke: Smoke) -> Network:
    """The network for one of ``layer.material_targets``."""
    return Network(_CONTEXTS[target], _MAKERS[target](smoke))


def _storm(smoke: Smoke) -> tuple[Node, ...]:
    names = {storm_shader.DENSITY: smoke.density}
    names |= {storm_shader.EMISSION: EMISSION} if smoke.emits else {}
    names |= {storm_shader.SCATTER: smoke.scatter} if smoke.scatter else {}
    readers: list[Node] = []
    volume: dict[str, Input] = {}
    for name, grid in names.items():
        kind, type_name = ("3", _TYPES.Float3) if len(readers) else ("", _TYPES.Float)
        readers.append(_reader(name, f"HwFieldReader_float{kind}", "fieldname", grid, "result"))
        volume[name] = Input(type_name, source=f"{name}.result")
    volume |= {
        storm_shader.EXTINCTION: Input(_TYPES.Float, smoke.extinction),
        storm_shader.ALBEDO: Input(_TYPES.Float, smoke.albedo),
        storm_shader.STAGE_UNITS: Input(_TYPES.Float, smoke.stage_units),
        storm_shader.PER_DENSITY: Input(_TYPES.Float, float(smoke.is_per_density)),
    }
    return (*readers, Node("volume", "", volume, ("volume", _TYPES.Token)))


def _materialx(smoke: Smoke) -> tuple[Node, ...]:
    rates, ends = _materialx_rates(smoke)
    found = list(rates)
    parts = {"vdf": Input(_TYPES.Token, source="vdf.out")}
    if "emission" in ends:
        edf = {"color": Input(_TYPES.Color3f, source=ends.pop("emission"))}
        found.append(Node("edf", "ND_uniform_edf", edf, ("out", _TYPES.Token)))
        parts["edf"] = Input(_TYPES.Token, source="edf.out")
    vdf = {name: Input(_TYPES.Float3, source=end) for name, end in ends.items()}
    vdf |= _uneven(smoke, "anisotropy")
    kind = "ND_anisotropic_vdf" if "scattering" in vdf else "ND_absorption_vdf"
    found.insert(len(rates), Node("vdf", kind, vdf, ("out", _TYPES.Token)))
    return (*found, Node("volume", "ND_volume", parts, ("out", _TYPES.Token)))


def _karma(smoke: Smoke) -> tuple[Node, ...]:
    rates, ends = _materialx_rates(smoke)
    types = {"emission": _TYPES.Color3f}
    inputs = {
        name: Input(types.get(name, _TYPES.Float3), source=ends[name])
        for name in sorted(ends, key=lambda name: name != "emission")
    }
    inputs |= _uneven(smoke, "anisotropy")
    return (*rates, Node("volume", "kma_volume", inputs, ("out", _TYPES.Token)))


def _arnold(smoke: Smoke) -> tuple[Node, ...]:
    """Its own defaults scatter half of the light and glow like a black body."""
    mode = "density" if smoke.is_per_density else "channel"
    inputs = {
        "density": Input(_TYPES.Float, smoke.extinction),
        "density_channel": Input(_TYPES.String, smoke.density),
        "scatter": Input(_TYPES.Float, smoke.albedo),
        "scatter_color": Input(_TYPES.Color3f, (1.0, 1.0, 1.0)),
        "emission_mode": Input(_TYPES.String, mode if smoke.emits else "none"),
    } | _uneven(smoke, "scatter_anisotropy")
    if smoke.scatter:
        inputs["scatter_color_channel"] = Input(_TYPES.String, smoke.scatter)
    if smoke.emits:
        inputs["emission"] = Input(_TYPES.Float, 1.0)
        inputs["emission_channel"] = Input(_TYPES.String, EMISSION)
    return (Node("volume", "arnold:standard_volume", inputs, ("out", _TYPES.Token)),)


def _renderman(smoke: Smoke) -> tuple[Node, ...]:
    """PxrRemap multiplies: with bias and gain at their defaults it maps [0, 1] to [0, gamma_w], and
    beyond that linearly, unless it clamps, which it does by default at both ends."""
    remap = {
        "inputRGB": Input(_TYPES.Color3f, source="grey.resultRGB"),
        "clampInput": Input(_TYPES.Int, 0),
        "clampOutput": Input(_TYPES.Int, 0),
        "outputMax": Input(_TYPES.Float, smoke.extinction),
    }
    grey: dict[str, Input] = {
        "inputRGB": Input(_TYPES.Color3f, (1.0, 1.0, 1.0)),
        "outputMax": Input(_TYPES.Float, smoke.albedo),
    }
    volume = {
        "densityFloat": Input(_TYPES.Float, source="extinction.resultR"),
        "diffuseColor": Input(_TYPES.Color3f, source="albedo.resultRGB"),
    }
    rgb = ("resultRGB", _TYPES.Color3f)
    number = {"input": Input(_TYPES.Float, source="density.resultF")}
    colours = []
    if smoke.emits:
        colours.append(_primvar("emission", EMISSION, "color", rgb))
        volume["emitColor"] = Input(_TYPES.Color3f, source="emission.resultRGB")
    if smoke.scatter:
        colours.append(_primvar("scatter", smoke.scatter, "color", rgb))
        grey["inputRGB"] = Input(_TYPES.Color3f, source="scatter.resultRGB")
    return (
        _primvar("density", smoke.density, "float", ("resultF", _TYPES.Float)),
        *colours,
        Node("grey", "PxrToFloat3", number, rgb),
        Node("extinction", "PxrRemap", remap, ("resultR", _TYPES.Float)),
        Node("albedo", "PxrRemap", grey, rgb),
        Node("volume", "PxrVolume", volume, ("bxdf_out", _TYPES.Token)),
    )


def _primvar(name: str, field_name: str, kind: str, output: tuple[str, Sdf.ValueTypeName]) -> Node:
    """RenderMan's reader of a grid."""
    inputs = {"varname": Input(_TYPES.String, field_name), "type": Input(_TYPES.String, kind)}
    return Node(name, "PxrPrimvar", inputs, output)


def _uneven(smoke: Smoke, name: str) -> dict[str, Input]:
    """The input for the anisotropy; none where light is scattered to all sides, their default."""
    return {name: Input(_TYPES.Float, smoke.anisotropy)} if smoke.anisotropy else {}


def _materialx_rates(smoke: Smoke) -> tuple[list[Node], dict[str, str]]:
    """MaterialX nodes for absorption, scattering (where there is any) and emission, per metre.

    Returns:
        The nodes, and for each of the three the output that carries it.
    """
    nodes = [_reader("density", "ND_geompropvalue_float", "geomprop", smoke.density, "out")]
    if smoke.emits:
        nodes.append(_reader("emission", "ND_geompropvalue_color3", "geomprop", EMISSION, "out"))
    per_metre = 1 / smoke.meters_per_unit
    extinction = smoke.extinction.scaled(per_metre)
    if smoke.scatter:
        found, ends = _coloured_rates(smoke, extinction)
    else:
        found, ends = _even_rates(smoke, extinction)
    nodes += found
    if not smoke.emits:
        return nodes, ends
    light = {"in1": Input(_TYPES.Color3f, source="emission.out")}
    if smoke.is_per_density:
        nodes.append(_times_density("emission_rate", Varying(per_metre)))
        light["in2"] = Input(_TYPES.Float, source="emission_rate.out")
    else:
        light["in2"] = Input(_TYPES.Float, per_metre)
    nodes.append(Node("light", "ND_multiply_color3FA", light, ("out", _TYPES.Color3f)))
    return nodes, ends | {"emission": "light.out"}


def _even_rates(smoke: Smoke, extinction: Varying) -> tuple[list[Node], dict[str, str]]:
    """Absorption and scattering (where there is any) by one number a voxel."""
    scattering = _product(extinction, smoke.albedo)
    rates = {"absorption": _difference(extinction, scattering)}
    if scattering != Varying(0.0):
        rates["scattering"] = scattering
    nodes, ends = [], {}
    for name, rate in rates.items():
        vector = {"in": Input(_TYPES.Float, source=f"{name}_rate.out")}
        nodes += [
            _times_density(f"{name}_rate", rate),
            Node(name, "ND_convert_float_vector3", vector, ("out", _TYPES.Float3)),
        ]
        ends[name] = f"{name}.out"
    return nodes, ends


def _coloured_rates(smoke: Smoke, extinction: Varying) -> tuple[list[Node], dict[str, str]]:
    """Scattering by the field's colour, and what is left of the extinction as absorption."""
    vector = ("out", _TYPES.Float3)
    colour = {"in": Input(_TYPES.Color3f, source="scatter.out")}
    whole = {"in": Input(_TYPES.Float, source="extinction_rate.out")}
    share = {
        "in1": Input(_TYPES.Float3, source="albedo.out"),
        "in2": Input(_TYPES.Float, source="extinction_rate.out"),
    }
    rest = {
        "in1": Input(_TYPES.Float3, source="extinction.out"),
        "in2": Input(_TYPES.Float3, source="scattering.out"),
    }
    nodes = [
        _reader("scatter", "ND_geompropvalue_color3", "geomprop", smoke.scatter, "out"),
        _times_density("extinction_rate", extinction),
        Node("extinction", "ND_convert_float_vector3", whole, vector),
        Node("albedo", "ND_convert_color3_vector3", colour, vector),
        Node("scattering", "ND_multiply_vector3FA", share, vector),
        Node("absorption", "ND_subtract_vector3", rest, vector),
    ]
    return nodes, {"absorption": "absorption.out", "scattering": "scattering.out"}


def _times_density(name: str, factor: Varying) -> Node:
    inputs = {
        "in1": Input(_TYPES.Float, source="density.out"),
        "in2": Input(_TYPES.Float, factor),
    }
    return Node(name, "ND_multiply_float", inputs, ("out", _TYPES.Float))


_READ = {
    "HwFieldReader_float": (_TYPES.Token, _TYPES.Float),
    "HwFieldReader_float3": (_TYPES.Token, _TYPES.Float3),
    "ND_geompropvalue_float": (_TYPES.String, _TYPES.Float),
    "ND_geompropvalue_color3": (_TYPES.String, _TYPES.Color3f),
}  # types of the field's name and of its value


def _reader(name: str, shader: str, input_name: str, field_name: str, output: str) -> Node:
    name_type, value_type = _READ[shader]
    return Node(name, shader, {input_name: Input(name_type, field_name)}, (output, value_type))


def _product(one: Varying, other: Varying) -> Varying:
    return _combined(one, other, lambda a, b: a * b)


def _difference(one: Varying, other: Varying) -> Varying:
    return _combined(one, other, lambda a, b: a - b)


def _combined(one: Varying, other: Varying, rule: Callable[[float, float], float]) -> Varying:
    samples = {
        code: rule(one.samples.get(code, one.default), other.samples.get(code, other.default))
        for code in sorted({*one.samples, *other.samples})
    }
    return Varying(rule(one.default, other.default), samples)


_CONTEXTS = {
    "glslfx": "glslfx",
    "mtlx": "mtlx",
    "arnold": "arnold",
    "karma": "kma",
    "renderman": "ri",
}
_MAKERS: Mapping[str, Callable[[Smoke], tuple[Node, ...]]] = {
    "glslfx": _storm,
    "mtlx": _materialx,
    "arnold": _arnold,
    "karma": _karma,
    "renderman": _renderman,
}
