"""Where the smoke of one frame is in its neighbour: by its velocity and by its Volume's motion."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.sample import sample_linear, share_of_flat
from usdsmoke.core.fields.transport import backtrace, check_finite, choose_substeps
from usdsmoke.core.smoke.memory import CHUNK_ROWS, chunks, share_rows

TRACED_AT_ONCE = 2**15  # points; half as many take longer each


@dataclass(frozen=True)
class Transit:
    """The way from a source frame to a target frame, its neighbour.

    The smoke goes with the earlier frame's velocity within its Volume, and with the Volume: what
    the transforms on the stage do to the Volume between the frames, they do to the pattern.
    """

    mover: VolumeFrame  # the earlier of the two frames
    seconds: float  # that its velocity is followed for; negative against the velocity
    ride: np.ndarray | None = None  # [4 4] stage to stage, by the Volume's motion; None: it rests
    backwards: bool = False  # the earlier frame is the target

    @property
    def reverse(self) -> "Transit":
        """The way back."""
        return replace(self, backwards=not self.backwards)

    def origins(self, positions: Tensor) -> Tensor:
        """Where in the source frame the smoke at points of the target frame is, [N 3].

        Args:
            positions: [N 3] float64, stage space.

        Raises:
            NonFiniteError, PlanError: see ``Tracer``.
        """
        return self.tracer(positions.device)(positions)

    def tracer(self, device: torch.device) -> "Tracer":
        """``origins`` for many sets of points on one device; the velocity is prepared once.

        Raises:
            NonFiniteError: the velocity holds NaN or infinity.
        """
        return Tracer(self, device)

    def turn(self, vectors: Tensor) -> Tensor:
        """Vectors [... 3] of the source frame as the Volume's motion leaves them in the target."""
        if self.ride is None:
            return vectors
        matrix = np.linalg.inv(self.stage_motion[:3, :3])
        return vectors @ torch.as_tensor(matrix, dtype=vectors.dtype, device=vectors.device)

    @property
    def stage_motion(self) -> np.ndarray:
        """[4 4] of the Volume, from the target to the source, where there is a ride."""
        assert self.ride is not None
        return self.ride if self.backwards else np.linalg.inv(self.ride)


def ride_between(earlier: VolumeFrame, later: VolumeFrame) -> np.ndarray | None:
    """What the motion of the density's place does to a point of the stage, [4 4]; None at rest."""
    if np.array_equal(earlier.density_to_stage, later.density_to_stage):
        return None
    return np.asarray(np.linalg.inv(earlier.density_to_stage) @ later.density_to_stage)


class Tracer:
    """Where smoke comes from along a transit; its velocity is prepared for many look-ups.

    Beyond its box the velocity is that of the border. But one plane of voxels moves only the smoke
    in it, unless the smoke is a slab itself. Without a velocity, smoke rests in its Volume.

    Args:
        transit: the way.
        device: of the points.

    Raises:
        NonFiniteError: the velocity holds NaN or infinity.
    """

    def __init__(self, transit: Transit, device: torch.device) -> None:
        self._goes_back = transit.backwards
        self._seconds = -transit.seconds if transit.backwards else transit.seconds
        self._ride = self._rates = None
        if transit.ride is not None:
            self._ride = torch.as_tensor(transit.stage_motion, device=device)
        frame, velocity = transit.mover, transit.mover.velocity
        if velocity is None or velocity.is_empty or frame.velocity_to_stage is None:
            return
        index_to_stage = velocity.index_to_world @ np.asarray(frame.velocity_to_stage, float)
        self._forth, self._back = (
            torch.as_tensor(matrix, device=device)
            for matrix in (index_to_stage, np.linalg.inv(index_to_stage))
        )
        self._rates = rates = _voxels_per_second(velocity, device)
        self._low = torch.tensor(velocity.ijk_min, dtype=torch.float64, device=device)
        check_finite(rates, "velocity")
        self._extremes = torch.stack(rates.aminmax())
        self._ends = 1 in rates.shape[:3] and 1 not in frame.density.values.shape

    def __call__(
        self, positions: Tensor, times: float = 1.0, most_steps: int | None = None
    ) -> Tensor:
        """Where the smoke at points comes from, [N 3] float64; threads share the points.

        Mid-point steps, as many as a CFL number of 1 needs. Places are in double precision, the
        velocity between them is looked up in single precision.

        Args:
            positions: [N 3] float64, stage space.
            times: of its velocity, that the smoke goes with.
            most_steps: no more are taken, however fast it is.

        Raises:
            PlanError: the velocity is too fast for its unit to be right.
        """
        if self._ride is None and self._rates is None:
            return positions
        found = torch.empty_like(positions)

        def follow(part: slice) -> None:
            found[part] = self._follow(positions[part], times, most_steps)

        share_rows(follow, len(positions), TRACED_AT_ONCE, positions.device)
        return found

    def _follow(self, positions: Tensor, times: float, most_steps: int | None) -> Tensor:
        if self._ride is None:
            return self._flow(positions, times, most_steps)
        matrix, offset = self._ride[:3, :3], self._ride[3, :3]
        if self._goes_back:
            return self._flow(positions, times, most_steps) @ matrix + offset
        return self._flow(positions @ matrix + offset, times, most_steps)

    def _flow(self, positions: Tensor, times: float, most_steps: int | None) -> Tensor:
        """By the frame's own velocity, within its Volume."""
        rates, seconds = self._rates, times * self._seconds
        if rates is None:
            return positions
        n_steps = choose_substeps(self._extremes, seconds)
        if most_steps is not None:
            n_steps = min(n_steps, most_steps)

        def rate_at(place: Tensor) -> Tensor:
            return sample_linear(rates, place.to(rates.dtype), boundary="nearest")

        start = positions @ self._back[:3, :3] + self._back[3, :3] - self._low
        place = backtrace(rate_at, start, seconds, n_steps)
        if self._ends:
            place = torch.lerp(start, place, share_of_flat(rates.shape, start)[:, None])
        return (place + self._low) @ self._forth[:3, :3] + self._forth[3, :3]


def _voxels_per_second(velocity: DenseField, device: torch.device) -> Tensor:
    """[I J K 3] float32 from grid world units per second; planar, because it is sampled often."""
    to_index = torch.as_tensor(np.linalg.inv(velocity.index_to_world[:3, :3]))
    given = torch.from_numpy(velocity.values).view(-1, 3)
    rates = torch.empty((3, len(given)), dtype=torch.float32, device=device)
    for part in chunks(len(given), CHUNK_ROWS, given.device):
        rates[:, part] = (given[part].double() @ to_index).T.to(device)
    return rates.view(3, *velocity.values.shape[:3]).movedim(0, -1)
