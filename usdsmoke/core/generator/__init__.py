"""A small network that paints smoke in one pass.

``definition`` and ``weights`` need no torch: planning reads them.

- ``definition``: octaves, channels and parameters
- ``levels``: the octaves of a frame's voxels, with their neighbours
- ``convolution``: sums over neighbours, and their gradients
- ``network``: colours from density and noise
- ``weights``: files of parameters
"""
