"""Pictures by rays, without a gradient: for previews, contact sheets and error estimates.

- ``media``: fields as rays read them
- ``segments``, ``cells``, ``columns``: rays cut at voxels, in any direction and along an axis
- ``march``: pictures by ray marching
"""
