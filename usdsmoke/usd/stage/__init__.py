"""What a stage holds, as plain records.

- `opening`: opens a stage; its file, its layers, a prim by its path
- `originals`: the stage without the looks that it has
- `choice`: which Volumes are taken
- `volumes`: the Volumes to stylize, at which timeCodes
- `places`: what programs disagree on about a Volume's place
- `dropped`: what a stage names and OpenUSD leaves out
- `fields`: a Volume's field prims, and the file and grid of each at a timeCode
- `cameras`: the cameras of a shot
- `lights`: the lights that light a Volume
- `source`: the Volumes as a run takes them, with settings, cameras and lights of their own
- `composed`: what is visible at any timeCode
"""

from usdsmoke.usd.stage.cameras import read_camera
from usdsmoke.usd.stage.choice import hidden_volumes
from usdsmoke.usd.stage.composed import ComposedVolume, composed_volumes
from usdsmoke.usd.stage.lights import lit_by
from usdsmoke.usd.stage.opening import StageOrFile, layer_files, open_stage, stage_file
from usdsmoke.usd.stage.originals import open_look
from usdsmoke.usd.stage.source import read_source
from usdsmoke.usd.stage.volumes import find_volumes

__all__ = [
    "ComposedVolume",
    "StageOrFile",
    "composed_volumes",
    "find_volumes",
    "hidden_volumes",
    "layer_files",
    "lit_by",
    "open_look",
    "open_stage",
    "read_camera",
    "read_source",
    "stage_file",
]
