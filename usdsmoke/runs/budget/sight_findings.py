"""Whether a shot's camera sees the smoke that it looks at."""

from collections.abc import Iterator

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.runs.budget.finding import Finding
from usdsmoke.runs.budget.rows import RESOLUTION

CLOSE = 0.1  # of the picture, behind smoke of which a voxel is too large to show strokes
CLIPPED = 0.01  # of the mass in the picture


def find_sight(name: str, report: FrameReport) -> Iterator[Finding]:
    """Whether smoke right before the camera, or its clipping planes, leave a picture of it.

    Args:
        name: of the frame's file.
        report: of a frame that is stylized.
    """
    sight = report.sight
    if sight is None:
        return
    if sight.close > CLOSE:
        yield Finding(
            name,
            RESOLUTION.name,
            f"{sight.close:.0%} of the camera's picture shows voxels that are wider than an eighth "
            "of it, so strokes do not fit: the camera is inside the smoke, touches it, or shows "
            "very little of it",
            "Move the camera, let its near clipping plane (clippingRange) cut this smoke off, or "
            "set a lower optics.gamma",
        )
    if sight.clipped > CLIPPED:
        yield Finding(
            name,
            RESOLUTION.name,
            f"the camera's clipping planes cut off {sight.clipped:.0%} of the smoke in its "
            "picture, which is not stylized",
            "Change the camera's clippingRange if this smoke should be visible",
        )
