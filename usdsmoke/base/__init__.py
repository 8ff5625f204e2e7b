"""What every other part uses: errors, records, names, files, the machine.

Nothing here loads USD, OpenVDB or torch.

- ``errors``: every error that usdsmoke raises on purpose
- ``volume``: records of Volumes, fields and frames
- ``boxes``: the box around several fields, and a field's values in another box
- ``storage``: 16-bit floats: what a file keeps of values
- ``frame_report``: what the core reports of a frame, and while it works
- ``record_format``, ``json_records``: digests, run ids and dates; records as JSON
- ``time_codes``, ``naming``: timeCodes and frame ranges; names of files, grids and paths
- ``publish``, ``locks``: files that appear whole or not at all; one process at a time
- ``machine``: processors, memory, disk, installed packages
"""
