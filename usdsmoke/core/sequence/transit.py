"""Where the smoke of one frame is in its neighbour: by its velocity and by its Volume's motion."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.sample import sample_linear, share_of_flat
from usdsmoke.core.fields.transport import backtrace, choose_substeps
from usdsmoke.core.smoke.memory import CHUNK_ROWS, chunks


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
            NonFiniteError, PlanError: see ``tracer``.
        """
        return self.tracer(positions.device)(positions)

    def tracer(self, device: torch.device) -> Callable[[Tensor], Tensor]:
        """``origins`` for many sets of points on one device; the velocity is prepared once.

        Mid-point steps, as many as a CFL number of 1 needs. Without a velocity, smoke rests in its
        Volume.

        Raises:
            NonFiniteError: the velocity holds NaN or infinity.
            PlanError: it is too fast for its unit to be right.
        """
        flow = _flow_tracer(self.mover, -self.seconds if self.backwards else self.seconds, device)
        if self.ride is None:
            return flow
        matrix = torch.as_tensor(self._stage_motion, device=device)

        def ride(positions: Tensor) -> Tensor:
            return positions @ matrix[:3, :3] + matrix[3, :3]

        if self.backwards:
            return lambda positions: ride(flow(positions))
        return lambda positions: flow(ride(positions))

    def turn(self, vectors: Tensor) -> Tensor:
        """Vectors [... 3] of the source frame as the Volume's motion leaves them in the target."""
        if self.ride is None:
            return vectors
        matrix = np.linalg.inv(self._stage_motion[:3, :3])
        return vectors @ torch.as_tensor(matrix, dtype=vectors.dtype, device=vectors.device)

    @property
    def _stage_motion(self) -> np.ndarray:
        """From the target to the source."""
        assert self.ride is not None
        return self.ride if self.backwards else np.linalg.inv(self.ride)


def ride_between(earlier: VolumeFrame, later: VolumeFrame) -> np.ndarray | None:
    """What the motion of the density's place does to a point of the stage, [4 4]; None at rest."""
    if np.array_equal(earlier.density_to_stage, later.density_to_stage):
        return None
    return np.asarray(np.linalg.inv(earlier.density_to_stage) @ later.density_to_stage)


def _flow_tracer(
    frame: VolumeFrame, seconds: float, device: torch.device
) -> Callable[[Tensor], Tensor]:
    """Where smoke was ``seconds`` ago by the frame's own velocity; negative looks ahead.

    Beyond its box the velocity is that of the border. But one plane of voxels moves only the smoke
    in it, unless the smoke is a slab itself.
    """
    velocity = frame.velocity
    if velocity is None or velocity.is_empty or frame.velocity_to_stage is None:
        return lambda positions: positions
    index_to_stage = velocity.index_to_world @ np.asarray(frame.velocity_to_stage, float)
    forth, back = (
        torch.as_tensor(matrix, device=device)
        for matrix in (index_to_stage, np.linalg.inv(index_to_stage))
    )
    rates = _voxels_per_second(velocity, device)
    low = torch.tensor(velocity.ijk_min, dtype=torch.float64, device=device)
    n_substeps = choose_substeps(rates, seconds)

    def rate_at(place: Tensor) -> Tensor:
        return sample_linear(rates, place, boundary="nearest")

    ends = 1 in rates.shape[:3] and 1 not in frame.density.values.shape

    def trace(positions: Tensor) -> Tensor:
        start = positions @ back[:3, :3] + back[3, :3] - low
        place = backtrace(rate_at, start, seconds, n_substeps)
        if ends:
            place = torch.lerp(start, place, share_of_flat(rates.shape, start)[:, None])
        return (place + low) @ forth[:3, :3] + forth[3, :3]

    return trace


def _voxels_per_second(velocity: DenseField, device: torch.device) -> Tensor:
    """[I J K 3] float64 from grid world units per second; planar, because it is sampled often."""
    to_index = torch.as_tensor(np.linalg.inv(velocity.index_to_world[:3, :3]))
    given = torch.from_numpy(velocity.values).view(-1, 3)
    rates = torch.empty((3, len(given)), dtype=torch.float64, device=device)
    for part in chunks(len(given), CHUNK_ROWS, given.device):
        rates[:, part] = (given[part].double() @ to_index).T.to(device)
    return rates.view(3, *velocity.values.shape[:3]).movedim(0, -1)
