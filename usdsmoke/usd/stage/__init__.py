"""What a stage holds, as plain records.

- `opening`: opens a stage; its file, its layers, a prim by its path
- `originals`: the stage without the looks that it has
- `choice`: which Volumes are taken
- `volumes`: the Volumes to stylize, at which timeCodes
- `places`: what programs disagree on about a Volume's place
- `unopened`: the layers that cannot be opened
- `fields`: a Volume's field prims, and the file and grid of each at a timeCode
- `cameras`: the cameras of a shot
- `lights`: the lights that light a Volume
- `composed`: what is visible at any timeCode
"""

from usdsmoke.usd.stage.cameras import read_camera, seen_through
from usdsmoke.usd.stage.composed import ComposedVolume, composed_volumes
from usdsmoke.usd.stage.opening import StageOrFile, layer_files, open_stage, stage_file
from usdsmoke.usd.stage.originals import check_originals, open_original, open_source
from usdsmoke.usd.stage.volumes import find_volumes

__all__ = [
    "ComposedVolume",
    "StageOrFile",
    "check_originals",
    "composed_volumes",
    "find_volumes",
    "layer_files",
    "open_original",
    "open_source",
    "open_stage",
    "read_camera",
    "seen_through",
    "stage_file",
]
