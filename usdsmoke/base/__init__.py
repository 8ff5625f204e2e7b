"""What every other part uses: errors, settings, records, names, files, the machine.

Nothing here loads USD, OpenVDB or torch.

- ``errors``: every error that usdsmoke raises on purpose
- ``sections``: every setting with its default, limits and meaning
- ``setting_model``, ``settings``: what a setting is; all settings of a run, and which are explicit
- ``resolve``: settings from files, mappings and texts, in order of precedence
- ``presets``: settings files for a purpose
- ``volume``: records of Volumes, fields and frames
- ``storage``: pruning and 16-bit floats: what a file keeps of values
- ``frame_report``: what the core reports of a frame, and while it works
- ``record_format``, ``json_records``: digests, run ids and dates; records as JSON
- ``time_codes``, ``naming``: timeCodes and frame ranges; names of files, grids and paths
- ``publish``, ``locks``: files that appear whole or not at all; one process at a time
- ``machine``: processors, memory, disk, installed packages
"""
