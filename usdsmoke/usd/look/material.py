"""A material that shows the look, bound to its Volume.

The material lies below the Volume, so that every arc that brings the Volume brings it too. Each
renderer has an output of its own: Storm takes the first of its contexts that has one, and a shader
in the output for all would reach renderers that cannot read it.

A frame that is not stylized has density alone. There the material is smoke as Storm draws it
without any: extinction 1 per density, and an albedo of 0.18.
"""

from collections.abc import Mapping

from pxr import Sdf, Usd, UsdGeom

from usdsmoke.base.naming import EMISSION
from usdsmoke.config.run_sections import LayerConfig
from usdsmoke.usd.look.networks import Input, Network, Node, Smoke, Varying, network
from usdsmoke.usd.look.records import StylizedVolume, shader_name
from usdsmoke.usd.materials import BINDING, purposes_to_bind
from usdsmoke.usd.units import stage_units_over_time

_TYPES = Sdf.ValueTypeNames
_NAME = "look_material"
_SOURCE_ASSET = ":sourceAsset"  # end of the name of a shader's attribute that names its file
_FALLBACK_EXTINCTION, _FALLBACK_ALBEDO = 1.0, 0.18  # of Storm's shader without a material


def author_material(
    volume_spec: Sdf.PrimSpec,
    prim: Usd.Prim,
    volume: StylizedVolume,
    config: LayerConfig,
) -> None:
    """Author the material below the Volume, and bind the Volume to it."""
    layer = volume_spec.layer
    path = _material_path(prim)
    spec = _define(layer, path, "Material")
    smoke = _smoke(prim, volume)
    shader = f"./{shader_name(config)}"
    for target in config.material_targets:
        _author_network(spec, network(target, smoke), shader)
    schemas = volume_spec.GetInfo("apiSchemas")
    schemas.prependedItems = [*schemas.prependedItems, "MaterialBindingAPI"]
    volume_spec.SetInfo("apiSchemas", schemas)
    for name in (BINDING, *(f"{BINDING}:{purpose}" for purpose in purposes_to_bind(prim))):
        _bind(volume_spec, name, [path])


def shader_files(layer: Sdf.Layer) -> list[str]:
    """The files of shaders that materials of a layer name, as they are authored, each once."""
    found = dict[str, None]()

    def visit(path: Sdf.Path) -> None:
        if path.IsPropertyPath() and path.name.endswith(_SOURCE_ASSET):
            value = layer.GetAttributeAtPath(path).default
            if isinstance(value, Sdf.AssetPath) and value.path:
                found[value.path] = None

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return list(found)


def keep_binding(volume_spec: Sdf.PrimSpec, prim: Usd.Prim) -> None:
    """Repeat the source's own binding, so that no earlier look's is left."""
    relationship = prim.GetRelationship(BINDING)
    _bind(volume_spec, BINDING, list(relationship.GetTargets()) if relationship else [])


def _bind(volume_spec: Sdf.PrimSpec, name: str, targets: list[Sdf.Path]) -> None:
    relationship = Sdf.RelationshipSpec(volume_spec, name, custom=False)
    if targets:
        relationship.targetPathList.explicitItems = targets
    else:
        relationship.targetPathList.ClearEditsAndMakeExplicit()


def _material_path(prim: Usd.Prim) -> Sdf.Path:
    path, number = prim.GetPath().AppendChild(_NAME), 2
    while prim.GetStage().GetPrimAtPath(path):
        path, number = prim.GetPath().AppendChild(f"{_NAME}_{number}"), number + 1
    return path


def _smoke(prim: Usd.Prim, volume: StylizedVolume) -> Smoke:
    """The material's numbers at all timeCodes."""
    codes = volume.source.time_codes if volume.source.animated else ()
    ours = {code: volume.frame_at(code) is not None for code in codes}
    extinctions = {
        code: volume.extinction_samples.get(code, volume.extinction_per_density)
        if ours[code]
        else _FALLBACK_EXTINCTION
        for code in codes
    }
    albedo = 1.0 if volume.scatter_field else volume.albedo  # of the field's colour
    albedos = {code: albedo if ours[code] else _FALLBACK_ALBEDO for code in codes}
    first = volume.first_frame.time_code
    return Smoke(
        density=volume.source.density,
        extinction=_varying(volume.extinction_per_density, extinctions),
        albedo=_varying(albedo, albedos),
        anisotropy=volume.anisotropy,
        stage_units=Varying(*stage_units_over_time(prim, first, codes)),
        meters_per_unit=UsdGeom.GetStageMetersPerUnit(prim.GetStage()),
        is_per_density=volume.emission_mode == "perDensity",
        emits=EMISSION in volume.grids,
        scatter=volume.scatter_field,
    )


def _varying(default: float, samples: Mapping[float, float]) -> Varying:
    """Without samples where all of them are the default."""
    return Varying(default, samples if any(v != default for v in samples.values()) else {})


def _author_network(material: Sdf.PrimSpec, found: Network, shader_file: str) -> None:
    paths = {}
    for node in found.nodes:
        paths[node.name] = material.path.AppendChild(f"{found.context}_{node.name}")
        _author_node(material.layer, paths, node, shader_file)
    last = found.nodes[-1]
    output = Sdf.AttributeSpec(material, f"outputs:{found.context}:volume", _TYPES.Token)
    output.connectionPathList.explicitItems = [_output_path(paths, f"{last.name}.{last.output[0]}")]


def _author_node(
    layer: Sdf.Layer, paths: Mapping[str, Sdf.Path], node: Node, shader_file: str
) -> None:
    spec = _define(layer, paths[node.name], "Shader")
    if node.shader:
        info = {"info:id": (_TYPES.Token, node.shader)}
    else:
        info = {
            "info:implementationSource": (_TYPES.Token, "sourceAsset"),
            f"info:glslfx{_SOURCE_ASSET}": (_TYPES.Asset, Sdf.AssetPath(shader_file)),
        }
    for name, (type_name, value) in info.items():
        Sdf.AttributeSpec(spec, name, type_name, Sdf.VariabilityUniform).default = value
    for name, item in node.inputs.items():
        _author_input(spec, name, item, paths)
    Sdf.AttributeSpec(spec, f"outputs:{node.output[0]}", node.output[1])


def _author_input(
    spec: Sdf.PrimSpec, name: str, item: Input, paths: Mapping[str, Sdf.Path]
) -> None:
    attribute = Sdf.AttributeSpec(spec, f"inputs:{name}", item.type_name)
    if item.source:
        attribute.connectionPathList.explicitItems = [_output_path(paths, item.source)]
    elif isinstance(item.value, Varying):
        attribute.default = item.value.default
        for code, value in sorted(item.value.samples.items()):
            spec.layer.SetTimeSample(attribute.path, code, value)
    else:
        attribute.default = item.value


def _output_path(paths: Mapping[str, Sdf.Path], source: str) -> Sdf.Path:
    name, _, output = source.partition(".")
    return paths[name].AppendProperty(f"outputs:{output}")


def _define(layer: Sdf.Layer, path: Sdf.Path, type_name: str) -> Sdf.PrimSpec:
    spec = Sdf.CreatePrimInLayer(layer, path)
    spec.specifier = Sdf.SpecifierDef
    spec.typeName = type_name
    return spec
