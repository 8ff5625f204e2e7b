"""The look layer, and the root stage or the asset that puts it over the source.

- `look`: writes and checks the layers
- `records`: a Volume's result, and the names of the files
- `field_prims`: the prims that carry the result's fields
- `fields`: the attributes of these prims
- `extent`: the Volume's extent over time
- `attributes`: what a Volume and a layer record of the run
- `digests`: show whether a layer was edited
- `root`: the root stage; stage metadata
- `asset`: the asset with a variant for each look

New layers are written through Sdf. The source's layers and the session layer are only read.
"""

from usdsmoke.usd.look.asset import check_asset
from usdsmoke.usd.look.digests import (
    LAYER_HASH,
    RECORD_HASH,
    RECORD_KEY,
    layer_digest,
    record_digest,
)
from usdsmoke.usd.look.look import author_look, published_runs
from usdsmoke.usd.look.records import LookFiles, StylizedVolume, look_files

__all__ = [
    "LAYER_HASH",
    "RECORD_HASH",
    "RECORD_KEY",
    "LookFiles",
    "StylizedVolume",
    "author_look",
    "check_asset",
    "layer_digest",
    "look_files",
    "published_runs",
    "record_digest",
]
