"""The look layer, and the root layer or the asset that puts it over the source.

- `look`: writes and checks the layers
- `records`: a Volume's result, and the names of the files
- `fields`: the prims that carry the result's fields
- `extent`: the Volume's extent over time
- `material`: the material that shows the look, and its binding
- `networks`: the material's shaders for each renderer
- `storm_shader`: the volume shader for Hydra Storm
- `attributes`: what a Volume records of the run
- `root`: the root layer, and the asset with a variant for each look
- `checks`: what is refused before anything is computed

New layers are written through Sdf. The source's layers and the session layer are only read.
"""

from usdsmoke.usd.look.attributes import result_hashes
from usdsmoke.usd.look.checks import check_root_file, check_search_paths
from usdsmoke.usd.look.look import author_look, published_runs, shader_hashes
from usdsmoke.usd.look.material import shader_files
from usdsmoke.usd.look.records import LookFiles, StylizedVolume, look_files
from usdsmoke.usd.look.root import check_asset, copy_stage_metadata

__all__ = [
    "LookFiles",
    "StylizedVolume",
    "author_look",
    "check_asset",
    "check_root_file",
    "check_search_paths",
    "copy_stage_metadata",
    "look_files",
    "published_runs",
    "result_hashes",
    "shader_files",
    "shader_hashes",
]
