"""Optics and cameras.

- ``optics``: emission and absorption along a ray
- ``cameras``: orthographic and perspective views; numpy only
- ``frustum``: what a shot's camera can see; numpy only
- ``visibility``: the part of the smoke that a camera sees, and the user's mask
- ``footprint``: the points in a voxel that it is splatted at
- ``project``: voxels splatted on pixels, a sparse linear map
- ``lighting``: the stage's light, scattered by the smoke; ``bounces``: more than once
- ``joined``: smoke in large voxels, seen from all sides
- ``grazing``: marks that are seen at grazing angles only, smoothed
- ``occlusion``: how dark smoke is in the grooves between lumps
- ``dark_areas``: large dark areas, lifted with the marks in them
- ``shadows``: how much of a distant light arrives at a point
- ``column_depths``: columns of smoke along pixels: what the thick ones have, and what keeps it
- ``scene``: what all frames share: extinction, exposure, pixel size
"""
