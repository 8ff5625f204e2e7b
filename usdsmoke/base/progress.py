"""What the core tells the outside while it works; printing it is somebody else's business."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """One iteration of one step on one frame."""

    step: str  # "shape" or "colour"
    time_code: float
    frame: int  # 0-based, within the window
    n_frames: int  # of the window
    octave: int  # 0-based, coarse to fine
    n_octaves: int
    iteration: int  # 0-based, over all octaves of this step and frame
    n_iterations: int  # of this step and frame
    loss: float


ProgressCallback = Callable[[Progress], None]
