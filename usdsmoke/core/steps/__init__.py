"""The two optimisation steps of a frame, and the optimiser that both use.

- ``targets``: what a step works on: smoke, scene, and the loss of its pictures at every octave
- ``pictures``: the pictures that are compared: grey opacity, colours divided by their opacity
- ``shape``: the shape step: a displacement of the density
- ``motion``: what a potential moves, on blocks of voxels
- ``move``: the density moved by that displacement
- ``colour``: the colour step: colours of the voxels
- ``colour_rules``: what these are held to: hues of the style, detail, no speckle
- ``sharpen``: contrast between neighbouring voxels, raised by as much as the loss falls
- ``behind``: its iterations behind what a network has painted
- ``light_share``: what finished pictures show of lamps and of the style
- ``optimize``: Adam with rollbacks, for any objective
- ``loss_tail``: by how much a loss would still fall, from its history
"""
