"""USD's tokens for what a grid holds: ``fieldDataType`` and ``fieldClass`` of an OpenVDBAsset."""

from usdsmoke.vdb.header import GridHeader

# By the type of a grid's values; the second token is that of 16-bit floats.
DATA_TYPES = {
    "float": ("float", "half"),
    "double": ("double",),
    "int32": ("int",),
    "int64": ("int64",),
    "bool": ("bool",),
    "mask": ("mask",),
    "string": ("string",),
    "vec3s": ("float3", "half3"),
    "vec3d": ("double3",),
    "vec3i": ("int3",),
}
GRID_CLASSES = {"levelSet": "level set", "fogVolume": "fog volume", "staggered": "staggered"}


def data_type(grid: GridHeader) -> str | None:
    """The ``fieldDataType`` of a grid; None where USD has none."""
    tokens = DATA_TYPES.get(grid.value_type, ())
    if not tokens:
        return None
    return tokens[-1] if grid.half else tokens[0]


def field_class(grid: GridHeader) -> str:
    """The ``fieldClass`` of a grid."""
    return next((t for t, meant in GRID_CLASSES.items() if meant == grid.grid_class), "unknown")
