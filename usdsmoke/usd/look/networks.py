"""The shaders of a look's material for each renderer, as plain data.

All of them extinguish gamma_w * density, add ``emission`` as it is, and scatter ``albedo`` of the
light that they take away: in a look's own frames none, unless it is made for the stage's lights.

Sources: OpenUSD's tests of Storm's volumes; MaterialX 1.39 ``stdlib_defs`` and ``pbrlib_defs``;
Arnold's reference of ``standard_volume``; SideFX's of ``kma_volume``; Pixar's of ``PxrVolume``,
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


@dataclass(frozen=True)
class Network:
    """Shaders for one renderer; the last one has the volume terminal."""

    context: str  # of the material's output: outputs:CONTEXT:volume
    nodes: tuple[Node, ...]


def network(target: str, smoke: Smoke) -> Network:
    """The network for one of ``layer.material_targets``."""
    return Network(_CONTEXTS[target], _MAKERS[target](smoke))


def _storm(smoke: Smoke) -> tuple[Node, ...]:
    readers = [
        _reader("density", "HwFieldReader_float", "fieldname", smoke.density, "result"),
        _reader("emission", "HwFieldReader_float3", "fieldname", EMISSION, "result"),
    ]
    volume = {
        storm_shader.DENSITY: Input(_TYPES.Float, source="density.result"),
        storm_shader.EMISSION: Input(_TYPES.Float3, source="emission.result"),
        storm_shader.EXTINCTION: Input(_TYPES.Float, smoke.extinction),
        storm_shader.ALBEDO: Input(_TYPES.Float, smoke.albedo),
        storm_shader.STAGE_UNITS: Input(_TYPES.Float, smoke.stage_units),
        storm_shader.PER_DENSITY: Input(_TYPES.Float, float(smoke.is_per_density)),
    }
    return (*readers, Node("volume", "", volume, ("volume", _TYPES.Token)))


def _materialx(smoke: Smoke) -> tuple[Node, ...]:
    rates, ends = _materialx_rates(smoke)
    edf = {"color": Input(_TYPES.Color3f, source=ends.pop("emission"))}
    vdf = {name: Input(_TYPES.Float3, source=end) for name, end in ends.items()}
    vdf |= _uneven(smoke, "anisotropy")
    kind = "ND_anisotropic_vdf" if "scattering" in vdf else "ND_absorption_vdf"
    parts = {name: Input(_TYPES.Token, source=f"{name}.out") for name in ("vdf", "edf")}
    return (
        *rates,
        Node("vdf", kind, vdf, ("out", _TYPES.Token)),
        Node("edf", "ND_uniform_edf", edf, ("out", _TYPES.Token)),
        Node("volume", "ND_volume", parts, ("out", _TYPES.Token)),
    )


def _karma(smoke: Smoke) -> tuple[Node, ...]:
    rates, ends = _materialx_rates(smoke)
    inputs = {"emission": Input(_TYPES.Color3f, source=ends.pop("emission"))}
    inputs |= {name: Input(_TYPES.Float3, source=end) for name, end in ends.items()}
    inputs |= _uneven(smoke, "anisotropy")
    return (*rates, Node("volume", "kma_volume", inputs, ("out", _TYPES.Token)))


def _arnold(smoke: Smoke) -> tuple[Node, ...]:
    inputs = {
        "density": Input(_TYPES.Float, smoke.extinction),
        "density_channel": Input(_TYPES.String, smoke.density),
        "scatter": Input(_TYPES.Float, smoke.albedo),
        "emission_mode": Input(_TYPES.String, "density" if smoke.is_per_density else "channel"),
        "emission": Input(_TYPES.Float, 1.0),
        "emission_channel": Input(_TYPES.String, EMISSION),
    } | _uneven(smoke, "scatter_anisotropy")
    return (Node("volume", "arnold:standard_volume", inputs, ("out", _TYPES.Token)),)


def _renderman(smoke: Smoke) -> tuple[Node, ...]:
    """PxrRemap multiplies: with bias and gain at their defaults it maps [0, 1] to [0, gamma_w], and
    beyond that linearly."""
    remap = {
        "inputRGB": Input(_TYPES.Color3f, source="grey.resultRGB"),
        "clampInput": Input(_TYPES.Int, 0),
        "outputMax": Input(_TYPES.Float, smoke.extinction),
    }
    grey = {
        "inputRGB": Input(_TYPES.Color3f, (1.0, 1.0, 1.0)),
        "outputMax": Input(_TYPES.Float, smoke.albedo),
    }
    volume = {
        "densityFloat": Input(_TYPES.Float, source="extinction.resultR"),
        "emitColor": Input(_TYPES.Color3f, source="emission.resultRGB"),
        "diffuseColor": Input(_TYPES.Color3f, source="albedo.resultRGB"),
    }
    rgb = ("resultRGB", _TYPES.Color3f)
    number = {"input": Input(_TYPES.Float, source="density.resultF")}
    return (
        _primvar("density", smoke.density, "float", ("resultF", _TYPES.Float)),
        _primvar("emission", EMISSION, "color", rgb),
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
    nodes = [
        _reader("density", "ND_geompropvalue_float", "geomprop", smoke.density, "out"),
        _reader("emission", "ND_geompropvalue_color3", "geomprop", EMISSION, "out"),
    ]
    per_metre = 1 / smoke.meters_per_unit
    extinction = smoke.extinction.scaled(per_metre)
    scattering = _product(extinction, smoke.albedo)
    rates = {"absorption": _difference(extinction, scattering)}
    if scattering != Varying(0.0):
        rates["scattering"] = scattering
    ends = {}
    for name, rate in rates.items():
        vector = {"in": Input(_TYPES.Float, source=f"{name}_rate.out")}
        nodes += [
            _times_density(f"{name}_rate", rate),
            Node(name, "ND_convert_float_vector3", vector, ("out", _TYPES.Float3)),
        ]
        ends[name] = f"{name}.out"
    light = {"in1": Input(_TYPES.Color3f, source="emission.out")}
    if smoke.is_per_density:
        nodes.append(_times_density("emission_rate", Varying(per_metre)))
        light["in2"] = Input(_TYPES.Float, source="emission_rate.out")
    else:
        light["in2"] = Input(_TYPES.Float, per_metre)
    nodes.append(Node("light", "ND_multiply_color3FA", light, ("out", _TYPES.Color3f)))
    return nodes, ends | {"emission": "light.out"}


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
