"""The fixed numbers that the embedded features are made of, and a hash of them; without torch.

Every change of a number changes all results. Increase ``REVISION`` for a change of the method that
changes no number.
"""

import hashlib
import json

REVISION = 1

# Oriented filters
N_LEVELS = 4
N_ORIENTATIONS = 8
FREQUENCIES = (0.35, 0.2, 0.1)  # cycles per pixel
SIZE = 7  # of a filter, pixels
ENVELOPE_SHARE = 0.25  # standard deviation of a filter's envelope, of SIZE
ENERGY_FLOOR = 1e-3  # beneath the root of the local energy
BINOMIAL = (1.0, 4.0, 6.0, 4.0, 1.0)  # low-pass between levels, before it is divided by its sum
COLOUR_FLOOR = 1e-2  # variance that whitening adds

# Learned filters, one entry for each layer
N_FILTERS = (64, 96, 128, 160)
PATCH_SIZES = (5, 3, 3, 3)
N_PATCHES = (20000, 8000, 8000, 8000)
N_CLUSTERINGS = (12, 10, 10, 10)  # iterations of k-means
N_AXES = 64  # principal axes of patches that are clustered
N_FOR_AXES = 4000  # patches that these are taken of, evenly spaced
WHITENING_FLOOR = 0.02  # of the largest eigenvalue
DEVIATION_SHARE = 0.1  # of the largest deviation: a floor for that of a filter's response
COLOUR_RELATIVE = 0.1  # of the largest eigenvalue of the colours

# Only styles of (nearly) one colour are below these. Any picture differs from such a style by
# hundreds of its deviations, and three or more layers of that overflow float32.
LEAST_VARIANCE = 1e-4  # of colour
LEAST_POWER = 0.1  # variance of all patches; pictures have 50 and more
LEAST_DEVIATION = 0.05  # of a filter's response; pictures have 0.4 and more


def embedded_hash() -> str:
    """SHA-256, 64 hexadecimal digits, of all numbers of this module with their names."""
    numbers = {name: value for name, value in globals().items() if name.isupper()}
    return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()


def oriented_layers() -> tuple[str, ...]:
    """Names of the oriented filters' layers, finest first."""
    return tuple(f"oriented{level + 1}" for level in range(N_LEVELS))


def learned_layers() -> tuple[str, ...]:
    """Names of the learned filters' layers, shallow to deep; the first is whitened colour."""
    return tuple(f"learned{depth}" for depth in range(len(N_FILTERS) + 1))


def default_layers() -> tuple[str, ...]:
    """The style layers when none are named: all but the deepest of either kind."""
    return oriented_layers()[:-1] + learned_layers()[:-1]
