"""USD in: a stage's composed values as plain records. Nothing is read from disk but USD.

`opening` opens a stage, `volumes` chooses the Volumes and their timeCodes, `fields` follows a
Volume's relationships to its field prims, `assets` says which file and grid those show when,
`cameras` reads a shot's camera, `shown` tells what is to be seen at any timeCode.
"""

from usdsmoke.base.time_codes import parse_frames
from usdsmoke.usd.stage.cameras import read_camera, seen_through
from usdsmoke.usd.stage.composed import open_original, shown_volumes
from usdsmoke.usd.stage.opening import StageOrFile, layer_files, open_stage, stage_file
from usdsmoke.usd.stage.originals import check_originals, open_source
from usdsmoke.usd.stage.volumes import find_volumes

__all__ = [
    "StageOrFile",
    "check_originals",
    "find_volumes",
    "layer_files",
    "open_original",
    "open_source",
    "open_stage",
    "parse_frames",
    "read_camera",
    "seen_through",
    "shown_volumes",
    "stage_file",
]
