"""USD out: one override layer with the whole look, and a thin root stage with it over the source.

`look` is the way through; `field_prims` decides which prims carry the result's fields, `fields`
writes their opinions, `extent` the Volume's bounds, `marks` what was run, `root` the stage to open,
`asset` the one with a variant for each look, `reach` what a reference leaves behind.
Opinions go to new layers through Sdf; the source's layers and the session layer are only read.
"""

from usdsmoke.usd.look.asset import check_asset
from usdsmoke.usd.look.look import author_look, published_runs
from usdsmoke.usd.look.records import LookFiles, StylizedVolume, look_files

__all__ = [
    "LookFiles",
    "StylizedVolume",
    "author_look",
    "check_asset",
    "look_files",
    "published_runs",
]
