"""What it takes to carry one frame's displacement to the next, beside what comes out of it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from tests.fixtures.smoke_fixtures import frame_of, puff, smoke_of
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.fields import lattice as lattice_module
from usdsmoke.core.fields.lattice import surround
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.coherence import average_displacement, carry_displacement
from usdsmoke.core.sequence.start import start_displacement
from usdsmoke.core.sequence.transit import Transit
from usdsmoke.core.steps.move import effect_on, fade_of, near_smoke, smoke_box


class LargeTensors(TorchDispatchMode):
    """The operations of torch that make tensors of at least so many numbers; views do not."""

    def __init__(self, least: int) -> None:
        super().__init__()
        self.made: list[str] = []
        self._least = least

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None
    ) -> Any:
        found = func(*args, **(kwargs or {}))
        if isinstance(found, torch.Tensor) and not func.is_view:
            if found.numel() >= self._least:
                self.made.append(str(func))
        return found


def drifting(density: np.ndarray, speed: float, low: int) -> VolumeFrame:
    """A frame with one velocity in all of a box of 32 voxels, of which the first is ``low``."""
    values = np.full((32, 32, 32, 3), speed, np.float32)
    velocity = DenseField("v", values, (low, low, low), np.eye(4), (0.0, 0.0, 0.0))
    return replace(frame_of(density), velocity=velocity, velocity_to_stage=np.eye(4))


def test_a_carried_displacement_takes_no_box_of_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Velocity and displacement once each, channel by channel, and the result."""
    monkeypatch.setattr(lattice_module, "LATTICE_CHUNK", 500)
    density = puff(28)
    box = surround(smoke_of(density), 2)
    frame = drifting(density, 30.0, -2)
    before = Displacement(torch.rand(*box.shape, 3), box)
    with LargeTensors(3 * int(np.prod(box.shape))) as large:
        carried = carry_displacement(before, Transit(frame, 1 / 24), box)
    assert carried.shape == (*box.shape, 3)
    # for the velocity, the displacement channel by channel, the result
    assert len(large.made) == 3, large.made


def test_a_carried_displacement_keeps_what_is_small() -> None:
    """Half a voxel there and back: linear look-ups leave half of a wave of four voxels."""
    density = puff(28)
    box = surround(smoke_of(density), 2)
    frame = drifting(density, 0.5 * 24, -2)
    wave = torch.sin(torch.arange(box.shape[0]) * np.pi / 2)[:, None, None, None]
    before = Displacement(wave.expand(*box.shape, 3).contiguous().float(), box)
    transit = Transit(frame, 1 / 24)
    there = Displacement(carry_displacement(before, transit, box), box)
    back = carry_displacement(there, transit.reverse, box)
    inside = (slice(8, -8),) * 3
    change = (back[inside] - before.values[inside]).norm() / before.values[inside].norm()
    assert change < 0.15


def test_a_displacement_is_carried_to_where_smoke_can_be_moved() -> None:
    """What two voxels of drift bring; beyond, where there is no smoke, nothing is looked up."""
    density = puff(12)
    box = surround(smoke_of(density), 8)
    frame = drifting(density, 2.0 * 24, -8)
    before = Displacement(0.01 * torch.rand(*box.shape, 3), box)
    transit, there = Transit(frame, 1 / 24), box.fill(smoke_of(density))
    near = near_smoke(there, box, 1.0)
    everywhere = carry_displacement(before, transit, box)
    carried = start_displacement(before, None, transit, 1e6, box, near)
    assert torch.equal(carried[near], everywhere[near]) and not carried[~near].any()
    own = Displacement(torch.zeros_like(before.values), box)
    averaged = average_displacement(own, before, transit.reverse, 1.0, near).values
    assert torch.equal(averaged, carried)
    filled = torch.nonzero(there)
    low, high = filled.amin(0) - 3, filled.amax(0) + 4  # a fade of 1.2 voxels, and one for slopes
    assert not near[: low[0]].any() and not near[high[0] :].any()
    assert near[low[0]].any() and near[high[0] - 1].any()


@pytest.mark.parametrize(
    ("shape", "beyond"),
    [((12, 12, 12), False), ((120, 120, 2), True), ((90, 3, 3), False), ((40, 1, 40), False)],
    ids=["a cube", "a sheet", "a filament", "a slab"],
)
def test_smoke_can_be_moved_wherever_the_effect_is_not_0(
    shape: tuple[int, int, int], beyond: bool
) -> None:
    """The effect around a thin sheet reaches further the wider it is."""
    smoke = smoke_of(np.ones(shape, np.float32))
    fade = fade_of(smoke)
    lattice = surround(smoke, 20)
    density = lattice.fill(smoke)
    effect, near = effect_on(density, lattice, fade, None), near_smoke(density, lattice, fade)
    assert not (effect > 0)[~near].any() and (~near).any()
    assert near.sum() == np.prod(smoke_box(smoke, fade).shape)
    assert bool((effect[density == 0] > 0).any()) == beyond
