"""Training of the network that paints smoke, on a few frames of a shot.

- ``canvas``: smoke that is painted, the loss of its pictures, and whether a network suits it
- ``orthogonal``: the steps of its optimiser
- ``train``: the training
- ``frames``: the frames of a shot that it is trained on, or tried on
"""
