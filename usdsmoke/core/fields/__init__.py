"""Operators on fields, with exact adjoints.

- ``gather``: weighted sums of voxels around positions, the kernel of interpolation
- ``sample``: linear and cubic interpolation
- ``transport``: warps by a displacement, back-traces along a velocity, correction of mass
- ``richardson``: errors estimated from results with 2 and 4 times the step
- ``warp_error``: the error of a transported field, from its voxels
- ``lattice``: a dense box around the smoke
- ``resample``: upsampling, smoothing, smaller voxels
- ``sparse_map``: sparse linear maps between nodes of lattices
- ``sparse_image``: the sparse linear map from voxels to the pixels of a view
- ``pyramid``: coefficient pyramids, on the nodes that have an effect
- ``displacement``: displacements of potentials, on a box or at chosen voxels; clamped lengths
- ``flow``: the displacement of a velocity that is followed for a unit of time
- ``folding``: where a displacement folds space or reads smoke unevenly
- ``potential``: a potential or displacement with its box, and the fade at the smoke's border
"""
