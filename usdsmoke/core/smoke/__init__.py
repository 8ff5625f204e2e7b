"""Smoke as tensors.

- ``active``: the voxels that hold smoke, and the same smoke at half the resolution
- ``device``: where the core computes, and what decides its bits
- ``field_checks``: what of a frame's fields cannot be used, or was replaced
- ``levels``: what counts as ordinary density, whatever the densest voxels hold
- ``memory``: long tensors in chunks, lazy lists, sums whose graph is freed term by term
- ``noise``: white noise as a function of voxel, channel and seed
- ``replay``: losses that a GPU records once and computes again and again
- ``schedule``: iterations of each octave, number of views; without torch
- ``spread``: colours for voxels of which too little is known, from those around them
- ``srgb``: colour spaces
- ``tasks``: work shared among threads, with the same bits for any number of them; without torch
- ``thicken``: thin smoke made more opaque
- ``voxels``: the voxels that hold smoke, as numpy arrays
"""
