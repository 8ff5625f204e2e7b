"""Draw a result in Cycles with emission and absorption alone, which is the model it was made for.

    CLIENTS_VENV/bin/python benchmarks/cycles_emission.py STAGE OUT.png --extinction GAMMA_W \\
        [--light perDensity] [--channels] [--light Cd]

Runs in a Python that has Blender as a module (bpy 5) and not in the project's own environment. The
shader is what a lighter would build by hand: Volume Absorption in black, its density the grid
``density`` times gamma_w, plus Emission with the grid ``emission``; no lamp, a black world. An
emission per density (``layer.emission_mode``) is multiplied by the density first; with
``--channels`` it is put together from the grids of floats (``layer.split_rgb``). A scattering
colour (``layer.scatter_colour``) is shown by a Principled Volume under a white sun.
"""

import argparse
import os
import sys

import bpy

__all__ = ["main", "make_material", "make_scattering"]


def make_material(
    extinction: float, per_density: bool = False, channels: bool = False
) -> "bpy.types.Material":
    """The volume material: sigma = extinction * density, emission as the file means it.

    Args:
        extinction: gamma_w.
        per_density: the file's emission is to be multiplied by density.
        channels: take the emission from ``emission_r``, ``emission_g`` and ``emission_b``.
    """
    material = bpy.data.materials.new("usdsmoke")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    density = nodes.new("ShaderNodeAttribute")
    density.attribute_name = "density"
    light = _joined(material) if channels else _attribute(material, "emission").outputs["Color"]
    if per_density:
        times = nodes.new("ShaderNodeVectorMath")
        times.operation = "MULTIPLY"
        links.new(light, times.inputs[0])
        links.new(density.outputs["Fac"], times.inputs[1])
        light = times.outputs["Vector"]
    sigma = nodes.new("ShaderNodeMath")
    sigma.operation = "MULTIPLY"
    sigma.inputs[1].default_value = extinction
    absorb, emit = nodes.new("ShaderNodeVolumeAbsorption"), nodes.new("ShaderNodeEmission")
    absorb.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    both, output = nodes.new("ShaderNodeAddShader"), nodes.new("ShaderNodeOutputMaterial")
    links.new(density.outputs["Fac"], sigma.inputs[0])
    links.new(sigma.outputs[0], absorb.inputs["Density"])
    links.new(light, emit.inputs["Color"])
    links.new(absorb.outputs["Volume"], both.inputs[0])
    links.new(emit.outputs["Emission"], both.inputs[1])
    links.new(both.outputs[0], output.inputs["Volume"])
    return material


def make_scattering(extinction: float, name: str) -> "bpy.types.Material":
    """A Principled Volume whose scattering colour is the grid ``name``."""
    material = bpy.data.materials.new("usdsmoke")
    nodes = material.node_tree.nodes
    nodes.clear()
    shader, output = (
        nodes.new(kind) for kind in ("ShaderNodeVolumePrincipled", "ShaderNodeOutputMaterial")
    )
    shader.inputs["Density"].default_value = extinction
    shader.inputs["Density Attribute"].default_value = "density"
    shader.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    shader.inputs["Color Attribute"].default_value = name
    material.node_tree.links.new(shader.outputs["Volume"], output.inputs["Volume"])
    return material


def _attribute(material: "bpy.types.Material", name: str) -> "bpy.types.Node":
    node = material.node_tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = name
    return node


def _joined(material: "bpy.types.Material") -> "bpy.types.NodeSocket":
    """The emission from its three grids of floats."""
    join = material.node_tree.nodes.new("ShaderNodeCombineXYZ")
    for place, part in enumerate("rgb"):
        channel = _attribute(material, f"emission_{part}")
        material.node_tree.links.new(channel.outputs["Fac"], join.inputs[place])
    return join.outputs["Vector"]


def main() -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("stage")
    parser.add_argument("out", help="PNG")
    parser.add_argument("--extinction", type=float, default=1.0, help="gamma_w of the result")
    parser.add_argument(
        "--light", default="absolute", choices=("absolute", "perDensity", "Cd", "color")
    )
    parser.add_argument("--channels", action="store_true", help="read the grids of floats")
    parser.add_argument("--camera", default="", help="prim path; default: the first camera")
    parser.add_argument("--frame", type=int, default=1)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--samples", type=int, default=64)
    options = parser.parse_args()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=os.path.abspath(options.stage), import_volumes=True)
    scene = bpy.context.scene
    scene.frame_set(options.frame)
    wanted = options.camera.rstrip("/").rsplit("/", 1)[-1]
    cameras = [o for o in bpy.data.objects if o.type == "CAMERA" and wanted in ("", o.name)]
    volumes = [o for o in bpy.data.objects if o.type == "VOLUME"]
    if not cameras or not volumes:
        print(
            f"{options.stage} gives {len(volumes)} volumes and {len(cameras)} cameras named "
            f"{wanted!r}; wanted one of each; name another with --camera",
            file=sys.stderr,
        )
        return 1
    for volume in volumes:
        volume.data.materials.clear()
        volume.data.materials.append(_chosen_material(options))
        print(f"volume {volume.name} shows {_shown_file(volume)}")
    scene.camera = cameras[0]
    _set_render(scene, options.size, options.samples)
    if options.light in ("Cd", "color"):
        _add_sun(scene)
    scene.render.filepath = os.path.abspath(options.out)
    bpy.ops.render.render(write_still=True)
    return 0


def _shown_file(volume: "bpy.types.Object") -> str:
    """The file that Blender reads for this frame; empty when there is none."""
    grids = volume.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.grids
    grids.load()
    return str(grids.frame_filepath) if grids.is_loaded else ""


def _chosen_material(options: argparse.Namespace) -> "bpy.types.Material":
    if options.light in ("Cd", "color"):
        return make_scattering(options.extinction, options.light)
    return make_material(options.extinction, options.light == "perDensity", options.channels)


def _add_sun(scene: "bpy.types.Scene") -> None:
    """A sun from the left, above and behind the camera, and a grey sky."""
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 8.0, (0.9, 0.0, -0.7)
    scene.collection.objects.link(sun)
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.2, 0.2, 0.2, 1.0)


def _set_render(scene: "bpy.types.Scene", size: int, samples: int) -> None:
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples = "CPU", samples
    scene.cycles.use_denoising = False
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage, scene.render.dither_intensity = 100, 0.0
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    scene.view_settings.view_transform = "Standard"
    scene.world = bpy.data.worlds.new("black")
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.0, 0.0, 0.0, 1.0)


if __name__ == "__main__":
    sys.exit(main())
