"""VDB files in, dense arrays out, and back. OpenVDB runs in a guarded worker process only.

- ``header``: what a file says about itself, parsed without OpenVDB
- ``read``: grids as dense arrays, found by name and checked
- ``store``: keeps the grids that were read, so that no file is decoded twice
- ``velocity``: the velocity under its usual names, at voxel centres
- ``write``: one file of a frame, read back and compared
- ``child``, ``worker``: both ends of the guarded process
- ``binding``: finding OpenVDB's Python module
- ``content_hash``, ``boxes``: facts about a dense field
- ``written``: whether a file of a result still holds what a record promises
- ``blend``, ``colour_grids``: the grids of a result
"""
