"""USD stages in and out.

- `stage`: stages as they are opened; `look`: the layers of a result
- `rules`: what `validate` checks
- `schema`: the names of usdsmoke's schemas, and their registration
- `crates`: crate files looked at in a process with limits
- `diagnostics`: OpenUSD's warnings and errors as messages
- `layer_record`: the record of a run in a look layer, and its digests
- `field_tokens`: USD's tokens for what a grid holds
- `field_samples`: a Volume's fields, and the file and grid that each shows at a time
- `values`: attribute values, alike in every version of OpenUSD; asset paths
- `volume_requests`, `request_values`: style requests on prims
- `volume_settings`: the settings of each Volume, and where each comes from
- `materials`: the materials that a Volume is bound to, and what they read
- `units`: what one unit of a Volume's space is on its stage
- `gate`: findings of a look apart from those of its source
- `source_stage`: a stage made from bare VDB files
- `inspect`: everything that a stage holds, as one report
"""
