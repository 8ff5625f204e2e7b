"""Everything that the golden runs read, made from code: stages, VDB files, images, a network."""

import importlib
import importlib.util
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import numpy as np
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol, Vt

__all__ = ["N_PLUME_FRAMES", "make_inputs", "openvdb"]

PROJECT = Path(__file__).resolve().parents[2]
N_PLUME_FRAMES = 3
N_FRAMES = 3
VOXEL = 0.1
SHAPE = (13, 17, 11)
FIELDS = {  # name: data type, class, role
    "density": ("float", "fogVolume", "None"),
    "vel": ("float3", "unknown", "Vector"),
    "fade": ("float", "unknown", "None"),
}


def openvdb() -> ModuleType:
    """OpenVDB's own Python module under either of its names."""
    found = importlib.util.find_spec("openvdb")
    return importlib.import_module("openvdb" if found else "pyopenvdb")


def make_inputs(folder: Path) -> None:
    """Write the plume of the example and the small stages into ``folder``."""
    simulate_plume(folder)
    for code in range(1, N_FRAMES + 1):
        density, velocity = puff(code)
        write_grids(folder / f"smoke.{code:04d}.vdb", density=density, vel=velocity)
    density, velocity = puff(1, (24, 20, 1))
    velocity[..., 2] = 0.0
    write_grids(folder / "slab.vdb", density=density, vel=velocity)
    damaged = puff(2)[0]
    damaged[6, 8, 5], damaged[5, 8, 5] = np.nan, np.inf
    write_grids(folder / "damaged.vdb", active=True, density=damaged)
    write_mask(folder / "fade.vdb")
    write_styles(folder)
    write_network(folder / "network.pth")
    write_shot(folder / "shot.usda", {"density": "./smoke.{:04d}.vdb", "vel": "./smoke.{:04d}.vdb"})
    write_shot(folder / "still.usda", {"density": "./smoke.{:04d}.vdb"})
    write_shot(folder / "slab.usda", {"density": "./slab.vdb", "vel": "./slab.vdb"})
    write_shot(folder / "damaged.usda", {"density": "./damaged.vdb"})
    write_request(folder / "request.usda")
    write_turned(folder / "turned.usda")


def simulate_plume(folder: Path) -> None:
    """The example's plume at a third of its size."""
    script = [sys.executable, str(PROJECT / "examples/plume/simulate.py"), str(folder)]
    options = ["--frames", str(N_PLUME_FRAMES), "--resolution", "22"]
    done = subprocess.run([*script, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def puff(code: int, shape: tuple[int, int, int] = SHAPE) -> tuple[np.ndarray, np.ndarray]:
    """Density [i j k] and velocity [i j k 3] of a puff that rises and turns.

    Args:
        code: the frame; the puff rises by a voxel in each.
        shape: voxels along each axis.
    """
    axes = [np.arange(n) - 0.5 * (n - 1) for n in shape]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    lifted = y - (code - 2)
    radii = [0.34 * n + 0.5 for n in shape]
    distance = (x / radii[0]) ** 2 + (lifted / radii[1]) ** 2 + (z / radii[2]) ** 2
    ripples = np.sin(1.1 * x + 0.3 * code) * np.sin(0.9 * lifted) + 0.5 * np.cos(1.3 * z - 0.4 * x)
    grain = np.random.default_rng(code).random(shape)
    density = np.exp(-distance) * (1.0 + 0.4 * ripples + 0.2 * grain) - 0.25
    velocity = np.stack([-0.4 * z - 0.1 * x, 2.4 + 0.1 * x, 0.4 * x], axis=-1)
    return np.maximum(density, 0.0).astype(np.float32), velocity.astype(np.float32)


def write_grids(file_path: Path, active: bool = False, **fields: np.ndarray) -> None:
    """Write arrays as grids by name; ``active`` sets each voxel by itself, NaN too."""
    binding = openvdb()
    grids = []
    for name, values in fields.items():
        grid = binding.Vec3SGrid() if values.ndim == 4 else binding.FloatGrid()
        if active:
            accessor = grid.getAccessor()
            for place in np.ndindex(values.shape):
                accessor.setValueOn(place, float(values[place]))
        else:
            grid.copyFromArray(np.ascontiguousarray(values))
        grid.name = name
        grid.gridClass = "fog volume" if name == "density" else "unknown"
        grid.transform = binding.createLinearTransform(voxelSize=VOXEL)
        grids.append(grid)
    binding.write(str(file_path), grids=grids)


def write_mask(file_path: Path) -> None:
    """A mask on a coarser lattice of its own, with a slope along x."""
    binding = openvdb()
    values = np.linspace(0.0, 1.0, 6 * 8 * 5, dtype=np.float32).reshape(6, 8, 5)
    grid = binding.FloatGrid()
    grid.copyFromArray(values, ijk=(-1, 0, 0))
    grid.name = "fade"
    grid.transform = binding.createLinearTransform(voxelSize=2.7 * VOXEL)
    binding.write(str(file_path), grids=[grid])


def write_styles(folder: Path) -> None:
    """Two pictures with structure in several directions and colours."""
    y, x = np.mgrid[:40, :52]
    waves = [np.sin(x / 3 + y / 5), np.sin(y / 2.5), np.cos(x / 4 - y / 2)]
    pixels = np.clip(128 + 120 * np.stack(waves, -1), 0, 255).astype(np.uint8)
    Image.fromarray(pixels).save(folder / "style.png")
    Image.fromarray(np.ascontiguousarray(pixels[::-1, ::2, ::-1])).save(folder / "other.png")


def write_network(file_path: Path) -> None:
    """A file shaped like VGG-19's with seeded weights; deep layers are one number stored once."""
    import torch

    random = np.random.default_rng(19)
    tensors, index, n_in = {}, 0, 3
    for width, count in ((64, 2), (128, 2), (256, 4), (512, 4), (512, 4)):
        for _ in range(count):
            shape = (width, n_in, 3, 3)
            weight = torch.full((1, 1, 1, 1), 1e-3).expand(shape)
            if n_in <= 128:
                scale = (2 / (9 * n_in)) ** 0.5
                weight = torch.from_numpy((scale * random.standard_normal(shape)).astype("f4"))
            tensors[f"features.{index}.weight"] = weight
            bias = 0.1 * random.standard_normal(width)
            tensors[f"features.{index}.bias"] = torch.from_numpy(bias.astype("f4"))
            index, n_in = index + 2, width
        index += 1  # the pooling
    torch.save(tensors, file_path)


def _stage(file_path: Path, up_axis: str = "Y", unit: float = 1.0) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(file_path))
    UsdGeom.SetStageUpAxis(stage, up_axis)
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    stage.SetTimeCodesPerSecond(24)
    stage.SetFramesPerSecond(24)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(N_FRAMES)
    return stage


def write_shot(file_path: Path, files: Mapping[str, str]) -> None:
    """A stage with the Volume /shot/smoke and the camera /shot/camera.

    Args:
        file_path: the stage to write.
        files: file by field; with ``{`` in it one file a frame. There is a mask beside them.
    """
    stage = _stage(file_path)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/shot").GetPrim())
    volume = UsdVol.Volume.Define(stage, "/shot/smoke")
    box = [Gf.Vec3f(-1.0, -1.0, -1.0), Gf.Vec3f(3.0, 3.0, 3.0)]
    volume.CreateExtentAttr(Vt.Vec3fArray(box))
    for name, pattern in {**files, "fade": "./fade.vdb"}.items():
        data_type, field_class, role = FIELDS[name]
        field = UsdVol.OpenVDBAsset.Define(stage, f"/shot/smoke/{name}")
        volume.CreateFieldRelationship(name, field.GetPath())
        field.CreateFieldNameAttr(name)
        field.CreateFieldDataTypeAttr(data_type)
        field.CreateFieldClassAttr(field_class)
        field.CreateVectorDataRoleHintAttr(role)
        attribute = field.CreateFilePathAttr(Sdf.AssetPath(pattern.format(1)))
        for code in range(1, N_FRAMES + 1) if "{" in pattern else ():
            attribute.Set(Sdf.AssetPath(pattern.format(code)), code)
    camera = UsdGeom.Camera.Define(stage, "/shot/camera")
    place = camera.AddTranslateOp()  # it looks at the middle of a puff from the side, and moves
    place.Set(Gf.Vec3d(0.9, 0.9, 4.0), 1)
    place.Set(Gf.Vec3d(1.1, 0.9, 4.0), N_FRAMES)
    camera.AddRotateYOp().Set(12.0)
    camera.CreateFocalLengthAttr(60.0)
    camera.CreateHorizontalApertureAttr(24.0)
    camera.CreateVerticalApertureAttr(16.0)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.1, 100.0))
    stage.GetRootLayer().Save()


def write_request(file_path: Path) -> None:
    """The shot with a style, settings and an animated strength that its prim asks for."""
    stage = _stage(file_path)
    prim = stage.DefinePrim("/shot")
    stage.SetDefaultPrim(prim)
    prim.GetReferences().AddReference("./shot.usda")
    smoke = stage.OverridePrim("/shot/smoke")
    smoke.AddAppliedSchema("UsdSmokeStyleAPI")
    types = Sdf.ValueTypeNames
    for name, kind, value in (
        ("styleImages", types.AssetArray, [Sdf.AssetPath("./style.png"), "./other.png"]),
        ("styleWeights", types.DoubleArray, [0.75, 0.25]),
        ("seed", types.Int64, 5),
        ("shapeIterations", types.IntArray, [1, 2]),
        ("strength", types.Double, {1: 0.5, N_FRAMES: 1.0}),
        ("gamma", types.Double, {1: 1.0, N_FRAMES: 3.0}),
    ):
        attribute = smoke.CreateAttribute(f"usdSmoke:request:{name}", kind, custom=False)
        if isinstance(value, dict):
            for code, number in value.items():
                attribute.Set(number, code)
        else:
            attribute.Set(value)
    stage.GetRootLayer().Save()


def write_turned(file_path: Path) -> None:
    """Two Volumes by reference on a Z-up stage in centimetres, turned, scaled and retimed."""
    stage = _stage(file_path, "Z", 0.01)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/set").GetPrim())
    for number, name in enumerate(("near", "far")):
        group = UsdGeom.Xform.Define(stage, f"/set/{name}")
        group.AddTranslateOp().Set(Gf.Vec3d(-30.0 * number, 5.0, 2.0))
        group.AddRotateXYZOp().Set(Gf.Vec3f(90.0, 0.0, 25.0 + 40.0 * number))
        group.AddScaleOp().Set(Gf.Vec3f(10.0, 10.0, 12.0))
        offset = Sdf.LayerOffset(float(number), 1.0)
        group.GetPrim().GetReferences().AddReference("./shot.usda", "/shot", offset)
    stage.GetRootLayer().Save()
