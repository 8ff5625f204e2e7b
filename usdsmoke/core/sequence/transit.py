"""Where the smoke of one frame is in its neighbour: by its velocity and by its Volume's motion."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields.sample import sample_linear, share_of_flat
from usdsmoke.core.fields.transport import backtrace, check_finite, choose_substeps
from usdsmoke.core.smoke.memory import CHUNK_ROWS, chunks, share_rows

TRACED_AT_ONCE = 2**15  # points; with half as many, each point takes longer


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
            NonFiniteError: the velocity holds NaN or infinity.
            PlanError: it is too fast for its unit to be right.
        """
        return self.tracer(positions.device)(positions)

    def tracer(self, device: torch.device) -> "Tracer":
        """``origins`` for many sets of points on one device; the velocity is prepared once.

        Raises:
            NonFiniteError: the velocity holds NaN or infinity.
        """
        return Tracer(self, Flow.of(self.mover, device), device)

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
    """Where smoke comes from along a transit.

    Args:
        transit: the way.
        flow: of the transit's mover; None: smoke rests in its Volume.
        device: of the points.
    """

    def __init__(self, transit: Transit, flow: "Flow | None", device: torch.device) -> None:
        self._flow, self._goes_back = flow, transit.backwards
        self._seconds = -transit.seconds if transit.backwards else transit.seconds
        self._ride = None
        if transit.ride is not None:
            self._ride = torch.as_tensor(transit.stage_motion, device=device)

    def __call__(
        self, positions: Tensor, times: float = 1.0, most_steps: int | None = None
    ) -> Tensor:
        """Where the smoke at points comes from, [N 3] float64; threads share the points.

        Args:
            positions: [N 3] float64, stage space.
            times: of its velocity, that the smoke goes with.
            most_steps: no more are taken, however fast it is; None: as many as it needs.

        Raises:
            PlanError: the velocity is too fast for its unit to be right.
        """
        flow, ride = self._flow, self._ride
        if flow is None and ride is None:
            return positions
        seconds = times * self._seconds
        n_steps = 0 if flow is None else flow.n_steps(seconds)
        if most_steps is not None:
            n_steps = min(n_steps, most_steps)
        found = torch.empty_like(positions)

        def follow(part: slice) -> None:
            place = positions[part]
            if ride is not None and not self._goes_back:
                place = place @ ride[:3, :3] + ride[3, :3]
            if flow is not None:
                place = flow.follow(place, seconds, n_steps)
            if ride is not None and self._goes_back:
                place = place @ ride[:3, :3] + ride[3, :3]
            found[part] = place

        share_rows(follow, len(positions), TRACED_AT_ONCE, positions.device)
        return found


class Flow:
    """The velocity of a frame within its Volume, laid out for many look-ups.

    Beyond its box the velocity is that of the border. But one plane of voxels moves only the smoke
    in it, unless the smoke is a slab itself.

    Args:
        velocity: [I J K 3], grid world units per second.
        index_to_stage: [4 4].
        moves_all: whether one plane of voxels moves all smoke.
        device: of the points.

    Raises:
        NonFiniteError: the velocity holds NaN or infinity.
    """

    def __init__(
        self, velocity: DenseField, index_to_stage: np.ndarray, moves_all: bool,
        device: torch.device,
    ) -> None:  # fmt: skip
        self._forth, self._back = (
            torch.as_tensor(matrix, device=device)
            for matrix in (index_to_stage, np.linalg.inv(index_to_stage))
        )
        self._rates = rates = _voxels_per_second(velocity, device)
        self._low = torch.tensor(velocity.ijk_min, dtype=torch.float64, device=device)
        self._extremes = torch.stack(rates.aminmax())
        self._ends = 1 in rates.shape[:3] and not moves_all

    @classmethod
    def of(cls, frame: VolumeFrame, device: torch.device) -> "Flow | None":
        """Of a frame; None where it has no velocity."""
        velocity = frame.velocity
        if velocity is None or velocity.is_empty or frame.velocity_to_stage is None:
            return None
        index_to_stage = velocity.index_to_world @ np.asarray(frame.velocity_to_stage, float)
        return cls(velocity, index_to_stage, 1 in frame.density.values.shape, device)

    def n_steps(self, seconds: float) -> int:
        """As many as a CFL number of 1 needs.

        Raises:
            PlanError: the velocity is too fast for its unit to be right.
        """
        return choose_substeps(self._extremes, seconds)

    def follow(self, positions: Tensor, seconds: float, n_steps: int) -> Tensor:
        """Where smoke at points [N 3] float64 was ``seconds`` ago, by mid-point steps.

        Places are followed in double precision. A look-up rounds them to single precision, counted
        from the velocity's box. Where the velocity is 0, all numbers of seconds give the same bits.
        """
        start = positions @ self._back[:3, :3] + self._back[3, :3] - self._low
        place = backtrace(self._rate_at, start, seconds, n_steps)
        if self._ends:
            share = share_of_flat(self._rates.shape, start)
            place = torch.lerp(start, place, share[:, None])
        return (place + self._low) @ self._forth[:3, :3] + self._forth[3, :3]

    def _rate_at(self, place: Tensor) -> Tensor:
        return sample_linear(self._rates, place.to(self._rates.dtype), boundary="nearest")


def _voxels_per_second(velocity: DenseField, device: torch.device) -> Tensor:
    """[I J K 3] float32 from grid world units per second; planar, because it is sampled often."""
    to_index = torch.as_tensor(np.linalg.inv(velocity.index_to_world[:3, :3]))
    given = torch.from_numpy(velocity.values).view(-1, 3)
    check_finite(given, "velocity")
    most = torch.finfo(torch.float32).max  # a single wild voxel is too fast, not infinite
    rates = torch.empty((3, len(given)), dtype=torch.float32, device=device)
    for part in chunks(len(given), CHUNK_ROWS, given.device):
        rates[:, part] = (given[part].double() @ to_index).clamp(-most, most).T.to(device)
    return rates.view(3, *velocity.values.shape[:3]).movedim(0, -1)
