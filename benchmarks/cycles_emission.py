"""Draw a result in Cycles with emission and absorption alone, which is the model it was made for.

    CLIENTS_VENV/bin/python benchmarks/cycles_emission.py STAGE OUT.png --extinction GAMMA_W

Runs in a Python that has Blender as a module (bpy 5) and not in the project's own environment. The
shader is what a lighter would build by hand: Volume Absorption in black, its density the grid
``density`` times gamma_w, plus Emission with the grid ``emission``; no lamp, a black world.
"""

import argparse
import os
import sys

import bpy

__all__ = ["main", "make_material"]


def make_material(extinction: float) -> "bpy.types.Material":
    """The volume material: sigma = extinction * density, emission as it stands in the file."""
    material = bpy.data.materials.new("usdsmoke")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    density, emission = (nodes.new("ShaderNodeAttribute") for _ in range(2))
    density.attribute_name, emission.attribute_name = "density", "emission"
    sigma = nodes.new("ShaderNodeMath")
    sigma.operation = "MULTIPLY"
    sigma.inputs[1].default_value = extinction
    absorb, emit = nodes.new("ShaderNodeVolumeAbsorption"), nodes.new("ShaderNodeEmission")
    absorb.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    both, output = nodes.new("ShaderNodeAddShader"), nodes.new("ShaderNodeOutputMaterial")
    links.new(density.outputs["Fac"], sigma.inputs[0])
    links.new(sigma.outputs[0], absorb.inputs["Density"])
    links.new(emission.outputs["Color"], emit.inputs["Color"])
    links.new(absorb.outputs["Volume"], both.inputs[0])
    links.new(emit.outputs["Emission"], both.inputs[1])
    links.new(both.outputs[0], output.inputs["Volume"])
    return material


def main() -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("stage")
    parser.add_argument("out", help="PNG")
    parser.add_argument("--extinction", type=float, default=1.0, help="gamma_w of the result")
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
        volume.data.materials.append(make_material(options.extinction))
    scene.camera = cameras[0]
    _set_render(scene, options.size, options.samples)
    scene.render.filepath = os.path.abspath(options.out)
    bpy.ops.render.render(write_still=True)
    return 0


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
