"""Import a result of usdsmoke into Blender, with a material that shows the look in Cycles.

    blender -P examples/blender/import_look.py -- look/shot_look.usda
    BPY_PYTHON examples/blender/import_look.py look/shot_look.usda --render out.png --frame 3

Blender's own importer brings the Volumes without a material. This script builds one for each Volume
that has a look: extinction gamma_w * density, of which the albedo scatters, and emission. Cycles
measures lengths in the Volume's own space, so both are multiplied by
``usdSmoke:stageUnitsPerUnit``. Suns become as bright as on the stage, and a dome of one colour
becomes the world: Blender 5.0.1's importer makes suns four times as bright, and leaves domes out.
With ``--render`` one frame is drawn over black, square, through the stage's camera. Made for
Blender 5.0, whose Python has pxr.
"""

import argparse
import math
import os
import sys

import bpy

bpy.utils.expose_bundled_modules()  # pxr, OpenUSD as Blender was built with it
from pxr import Usd, UsdLux, UsdVol  # noqa: E402

EXTINCTION = "usdSmoke:extinctionPerDensity"
STAGE_UNITS = "usdSmoke:stageUnitsPerUnit"
EMISSION_MODE = "usdSmoke:emissionMode"
ALBEDO, SCATTER_FIELD = "usdSmoke:albedo", "usdSmoke:scatterField"

Look = tuple[float, float, bool, "float | str"]


def read_looks(stage_file: str, frame: float) -> dict[str, Look]:
    """By Volume name: gamma_w, stage units in a unit of the Volume, emission per density or not,
    and the albedo or the name of its field."""
    found = {}
    stage = Usd.Stage.Open(stage_file)
    for prim in stage.Traverse():
        if prim.IsA(UsdVol.Volume) and prim.HasAttribute(EXTINCTION):
            units = prim.GetAttribute(STAGE_UNITS).Get(frame)
            found[prim.GetName()] = (
                float(prim.GetAttribute(EXTINCTION).Get(frame)),
                1.0 if units is None else float(units),
                prim.GetAttribute(EMISSION_MODE).Get() == "perDensity",
                authored(prim, SCATTER_FIELD) or float(authored(prim, ALBEDO) or 0),
            )
    return found


def authored(prim: Usd.Prim, name: str) -> object:
    """An attribute's value; None where there is none."""
    attribute = prim.GetAttribute(name)
    return attribute.Get() if attribute else None


def make_material(
    gamma_w: float, units: float, per_density: bool, albedo: "float | str"
) -> "bpy.types.Material":
    """Absorption, scattering and emission as the look means them.

    Both of Cycles' shaders take the albedo as colour: one absorbs what it leaves, one scatters it.
    """
    material = bpy.data.materials.new("usdsmoke_look")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    density, emission = (nodes.new("ShaderNodeAttribute") for _ in range(2))
    density.attribute_name, emission.attribute_name = "density", "emission"
    extinction, strength = (nodes.new("ShaderNodeMath") for _ in range(2))
    for node, factor in ((extinction, gamma_w * units), (strength, units)):
        node.operation = "MULTIPLY"
        node.inputs[1].default_value = factor
    absorption, light = nodes.new("ShaderNodeVolumeAbsorption"), nodes.new("ShaderNodeEmission")
    absorption.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    both, output = nodes.new("ShaderNodeAddShader"), nodes.new("ShaderNodeOutputMaterial")
    links.new(density.outputs["Fac"], extinction.inputs[0])
    links.new(extinction.outputs[0], absorption.inputs["Density"])
    links.new(emission.outputs["Color"], light.inputs["Color"])
    if per_density:
        links.new(density.outputs["Fac"], strength.inputs[0])
    else:
        strength.inputs[0].default_value = 1.0
    links.new(strength.outputs[0], light.inputs["Strength"])
    links.new(_lit(material, absorption, extinction, albedo), both.inputs[0])
    links.new(light.outputs["Emission"], both.inputs[1])
    links.new(both.outputs[0], output.inputs["Volume"])
    return material


def _lit(
    material: "bpy.types.Material",
    absorption: "bpy.types.Node",
    extinction: "bpy.types.Node",
    albedo: "float | str",
) -> "bpy.types.NodeSocket":
    """The absorption, and beside it scattering where there is an albedo."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    if not albedo:
        return absorption.outputs["Volume"]
    scatter, inside = nodes.new("ShaderNodeVolumeScatter"), nodes.new("ShaderNodeAddShader")
    links.new(extinction.outputs[0], scatter.inputs["Density"])
    for node in (absorption, scatter):
        if isinstance(albedo, str):
            colour = nodes.new("ShaderNodeAttribute")
            colour.attribute_name = albedo
            links.new(colour.outputs["Color"], node.inputs["Color"])
        else:
            node.inputs["Color"].default_value = (albedo, albedo, albedo, 1.0)
        links.new(node.outputs["Volume"], inside.inputs[node == scatter])
    return inside.outputs[0]


def import_look(stage_file: str, frame: int) -> list[str]:
    """Import a stage with its light; the names of the Volumes that have got a material."""
    looks = read_looks(stage_file, frame)
    bpy.ops.wm.usd_import(filepath=os.path.abspath(stage_file), import_volumes=True)
    bpy.context.scene.frame_set(frame)
    bpy.context.scene.view_settings.view_transform = "Standard"
    done = []
    for item in bpy.data.objects:
        name = item.name.partition(".")[0]
        if item.type == "VOLUME" and name in looks:
            item.data.materials.clear()
            item.data.materials.append(make_material(*looks[name]))
            done.append(item.name)
    set_lights(stage_file, frame)
    return done


def set_lights(stage_file: str, frame: float) -> None:
    """Lamps and the world as bright as the stage's distant lights and domes without a texture."""
    sky, stage = [0.0, 0.0, 0.0], Usd.Stage.Open(stage_file)
    lamps = {item.name: item.data for item in bpy.data.objects if item.type == "LIGHT"}
    for prim in stage.Traverse():
        light = UsdLux.LightAPI(prim)
        if prim.GetTypeName() not in ("DistantLight", "DomeLight"):
            continue
        strength = light.GetIntensityAttr().Get(frame) * 2 ** light.GetExposureAttr().Get(frame)
        colour = list(light.GetColorAttr().Get(frame))
        if light.GetEnableColorTemperatureAttr().Get(frame):
            kelvin = light.GetColorTemperatureAttr().Get(frame)
            tint = UsdLux.BlackbodyTemperatureAsRgb(kelvin)
            colour = [a * b for a, b in zip(colour, tint, strict=True)]
        if prim.GetTypeName() == "DomeLight":
            if not UsdLux.DomeLight(prim).GetTextureFileAttr().Get(frame):
                sky = [old + strength * new for old, new in zip(sky, colour, strict=True)]
            continue
        angle = math.radians(UsdLux.DistantLight(prim).GetAngleAttr().Get(frame))
        if angle and not light.GetNormalizeAttr().Get(frame):
            strength *= math.pi * math.sin(angle / 2) ** 2
        if prim.GetName() in lamps:  # the strength of a sun is its irradiance
            lamps[prim.GetName()].energy, lamps[prim.GetName()].color = strength, colour
    world = bpy.context.scene.world = bpy.data.worlds.new("sky")
    world.node_tree.nodes["Background"].inputs[0].default_value = (*sky, 1.0)


def render(out: str, size: int, samples: int) -> None:
    """One square picture over black."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples = "CPU", samples
    scene.cycles.use_denoising = False
    scene.cycles.volume_bounces = 0
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage, scene.render.dither_intensity = 100, 0.0
    scene.render.image_settings.color_mode = "RGB"
    scene.render.film_transparent = True  # the sky lights, and is not seen
    scene.camera = next(item for item in bpy.data.objects if item.type == "CAMERA")
    scene.render.filepath = os.path.abspath(out)
    bpy.ops.render.render(write_still=True)


def main() -> int:
    """Run the command line; the exit code."""
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("stage")
    parser.add_argument("--frame", type=int, default=1)
    parser.add_argument("--render", metavar="OUT.png", help="draw the frame; needs a camera")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--samples", type=int, default=64)
    options = parser.parse_args(words)
    if options.render:
        bpy.ops.wm.read_factory_settings(use_empty=True)
    done = import_look(options.stage, options.frame)
    print(f"materials for {', '.join(done) or 'no Volume'}")
    if options.render:
        render(options.render, options.size, options.samples)
    return 0 if done else 1


if __name__ == "__main__":
    sys.exit(main())
