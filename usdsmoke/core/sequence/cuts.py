"""Whether the velocity brings one frame's smoke to the next: jumps, and wrong velocities.

The density of a frame is compared with the one before, carried along: sum |a - b| / sum (a + b)
over the smoke of both, at half the resolution. In shots that flow it is 0.05 to 0.1, 0.15 if the
pattern only rests; for two plumes that have nothing to do with each other 0.45 to 0.65.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.errors import PlanError
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.sequence.motion import estimate_velocity
from usdsmoke.core.sequence.transit import Flow, Tracer, Transit
from usdsmoke.core.smoke.active import ActiveSmoke, coarsen, densify, sample_colours
from usdsmoke.core.smoke.levels import bounded, ranked
from usdsmoke.core.smoke.memory import run_on

UNLIKE = 0.4  # from this difference on the frames have nothing in common
ALIKE = 0.5  # of a cut's difference: less is left with another scale of the density
MOST_SMOKE = 0.9  # of the voxels
FAR_DENSER = 2.0  # times those: denser voxels count as much where a velocity is judged
LEAST = 0.005  # below this difference no other velocity is tried
DOUBTFUL = 0.1  # from this one on velocities in other units are, which take many steps
HELPFUL = 1.1  # so much better than without it: the velocity's unit is not doubted below
MOST_TRACED = 2**12  # voxels of each frame that are looked at
# Steps at other speeds than the velocity's own, at most. In another unit it would take hundreds, to
# places where there is no smoke; if that unit is right, smoke moves fewer voxels a frame.
FEW_STEPS = 32
# Than with another velocity: factors with the differences that tell. The second is for slow smoke,
# which a wrong velocity leaves behind only in the course of a shot.
TELLING = ((1.25, 0.02), (1.5, LEAST))
STILL_SHARE = 0.1  # of the smoke: where the velocity is 0 in more, that part is judged by itself
# From this difference on, and so many times that of the rest, it does not rest. Smoke that decays
# by a fifth in a frame has 0.11, but so has the rest.
STILL_OFF, STILL_TIMES = 0.1, 3.0
CLEARLY = 0.9  # of the difference without a velocity: only less than that speaks for another one
# A velocity that explains no more than this leaves is compared with an estimated motion, which has
# to be so many times better, and by so much. Noise in one place has 1.2, plumes 1.4 to 30.
BARELY, ESTIMATED_TIMES, ESTIMATED_MORE = 0.9, 1.4, 0.03
MOST_ESTIMATED = 2**16  # voxels in the box of each frame that a motion is estimated from


@dataclass(frozen=True)
class Passage:
    """How one frame's smoke comes out of the frame before."""

    difference: float  # of the densities, the earlier one carried along; 0 to 1
    doubt: str  # what is wrong with the velocity; "" if nothing is
    is_measured: bool = True  # False: the velocity is too fast to be followed
    remark: str = ""  # on a cut that another scale of the density explains; begins with a semicolon

    @property
    def is_cut(self) -> bool:
        """Whether nothing can be carried from frame to frame."""
        return self.difference >= UNLIKE


def judge_passage(
    before: ActiveSmoke,
    smoke: ActiveSmoke,
    transit: Transit,
    time_codes_per_second: float,
    unit: str = "second",
) -> Passage:
    """Compare a frame's density with the one before, carried along.

    Args:
        before, smoke: of both frames; some thousand of their voxels are looked at.
        transit: from the frame before.
        time_codes_per_second: what a velocity per frame is slower than one per second by.
        unit: ``stage.velocity_unit``, that the velocity was read in.
    """
    fine = bounded(before), bounded(smoke)
    before, smoke = map(coarsen, fine)
    traced = _Traced(before, smoke, transit)
    try:
        given = traced.difference(before, smoke)
    except PlanError as error:
        how = str(error).partition(";")[0]  # and by how many voxels
        cure = "Check its unit and for single wrong voxels, or set stage.motion=estimate."
        return Passage(1.0, f"{how}, too fast to be followed: the frame starts anew. {cure}", False)
    if given >= UNLIKE and (remark := _other_scale(before, smoke, traced, given)):
        return Passage(given, "", remark=remark)
    if given < LEAST or transit.mover.velocity is None or transit.seconds == 0:
        return Passage(given, "")
    doubt = _doubt(*_evened(before, smoke), traced, time_codes_per_second, unit)
    return Passage(given, doubt or _doubt_nothing_moves(*_evened(*fine), traced))


def _evened(before: ActiveSmoke, smoke: ActiveSmoke) -> tuple[ActiveSmoke, ActiveSmoke]:
    """Both without the excess of what is far denser than most of the frame before.

    Velocities are judged by all smoke: a dense nozzle rests where its smoke flows on.
    """
    level = FAR_DENSER * ranked(before.density, MOST_SMOKE)
    one, other = (replace(s, density=s.density.clamp(max=level)) for s in (before, smoke))
    return one, other


def _doubt(
    before: ActiveSmoke,
    smoke: ActiveSmoke,
    traced: "_Traced",
    time_codes_per_second: float,
    unit: str,
) -> str:
    """What is wrong with the velocity, and what to do; "" if nothing is."""
    if doubt := _doubt_rest(before, smoke, traced):
        return doubt

    def difference(times: float) -> float:
        try:
            return traced.difference(before, smoke, times)
        except PlanError:  # too fast to be traced
            return 1.0

    given, rest = difference(1.0), difference(0.0)
    factors = {"against": -1.0, "at half the speed": 0.5, "at twice the speed": 2.0}
    if given >= DOUBTFUL or rest < HELPFUL * given:
        factors |= {"per frame": time_codes_per_second, "per second": 1 / time_codes_per_second}
    tries = [partial(difference, factor) for factor in factors.values()]
    found = dict(zip(factors, run_on(smoke.ijk.device, tries), strict=True))
    best = min(found, key=lambda name: found[name])
    least = min(rest, found[best])
    if not any(given > max(ratio * least, least + more) for ratio, more in TELLING):
        return ""
    if found[best] > CLEARLY * rest:
        cure = "without any. Check its unit and direction, or set stage.motion=estimate"
    elif best == "against":
        cure = "against it. Check the direction in which the program wrote it"
    elif best.startswith("at ") or best.endswith(unit):
        cure = f"with {factors[best]:.3g} times of it. Check the program that wrote it"
    else:
        cure = f"with {factors[best]:.3g} times of it, as if it were {best}. Check its unit"
        cure += f", stage.velocity_unit={best.removeprefix('per ')}"
    return f"the densities do not move by the velocity: they agree better {cure}."


def _other_scale(before: ActiveSmoke, smoke: ActiveSmoke, traced: "_Traced", given: float) -> str:
    """What to say of frames that differ by a factor of their density alone; "" of others."""
    times = float(smoke.density.double().sum() / before.density.double().sum())
    scaled = replace(before, density=before.density * times)
    if not traced.difference(scaled, smoke) < ALIKE * given:
        return ""
    return (
        f"; it agrees with {times:.2g} times that density. If its brightness should not blink, "
        "write all frames with one scale of the density"
    )


def _doubt_rest(before: ActiveSmoke, smoke: ActiveSmoke, traced: "_Traced") -> str:
    """What is wrong where the velocity is 0 in a part of the smoke that does not rest; "" if none.

    So is a velocity grid that was pruned, or cut off, more than the smoke.
    """
    (_, resting), (_, moving) = traced.at(0.0), traced.at(1.0)
    is_still, own = (resting == moving).all(1), _some(before).density.double()
    share = float(own[is_still].sum() / own.sum())
    if not STILL_SHARE < share < 1:  # 1: it is no velocity at all
        return ""
    there = _density_at(smoke, resting)

    def off(chosen: Tensor, other: Tensor) -> float:
        return float((own - other)[chosen].abs().sum() / (own + other)[chosen].sum())

    found = off(is_still, there)
    if found < max(STILL_OFF, STILL_TIMES * off(~is_still, _density_at(smoke, moving))):
        return ""
    return (
        f"the velocity is 0 in {share:.0%} of the smoke, which does not rest there: {found:.0%} of "
        "it is elsewhere in the next frame. Write the velocity wherever there is smoke, or set "
        "stage.motion=estimate."
    )


def _doubt_nothing_moves(before: ActiveSmoke, smoke: ActiveSmoke, traced: "_Traced") -> str:
    """What is wrong with a velocity that explains nothing while the smoke moves; "" if it rests.

    Another scale of the density is no motion, nor is smoke that comes, goes or diffuses: a motion
    is estimated, and has to explain far more than rest does.
    """
    times = float(smoke.density.double().sum() / before.density.double().sum())
    before = replace(before, density=before.density * times)
    coarse, transit = (coarsen(before), coarsen(smoke)), traced.transit
    rest = traced.difference(*coarse, 0.0)
    if rest < ESTIMATED_MORE or traced.difference(*coarse) < BARELY * rest:
        return ""
    # Both at rest in the earlier frame's Volume, which carries them further.
    undone = np.eye(4) if transit.ride is None else np.linalg.inv(transit.ride)
    earlier, later = _as_frame(before, np.eye(4)), _as_frame(smoke, undone)
    try:
        found = estimate_velocity(later, earlier, -transit.seconds)
        mover = replace(transit.mover, velocity=found, velocity_to_stage=np.eye(4))
        moved = _Traced(*coarse, replace(transit, mover=mover)).difference(*coarse)
    except PlanError:  # the estimate ran away
        return ""
    if rest < max(ESTIMATED_TIMES * moved, moved + ESTIMATED_MORE):
        return ""
    return (
        f"the smoke moves, but not by its velocity, which is 0 or next to it: {rest:.0%} of it is "
        f"elsewhere in the next frame, {moved:.0%} when an estimated motion carries it. Write the "
        "velocity of the smoke, or set stage.motion=estimate."
    )


def _as_frame(smoke: ActiveSmoke, to_stage: np.ndarray) -> VolumeFrame:
    """The smoke in a box of its own, of a resolution that is estimated from in a moment."""
    while np.prod(np.subtract(*smoke.box[::-1]) + 1.0) > MOST_ESTIMATED:
        smoke = coarsen(smoke)
    low, high = smoke.box
    start = torch.as_tensor(low, device=smoke.ijk.device)
    dense = densify(smoke.ijk, smoke.density[:, None], start, high - low + 1)
    first = (int(low[0]), int(low[1]), int(low[2]))
    values = dense[..., 0].cpu().numpy()
    return VolumeFrame(0.0, DenseField("density", values, first, smoke.index_to_stage), to_stage)


class _Traced:
    """Where some voxels of two frames come from and go to, at the velocity and at other speeds.

    Args:
        before, smoke: of both frames; their densities do not matter.
        transit: from the frame before.
    """

    def __init__(self, before: ActiveSmoke, smoke: ActiveSmoke, transit: Transit) -> None:
        self.transit, device = transit, smoke.ijk.device
        self._places = _some(smoke).positions, _some(before).positions
        flow = Flow.of(transit.mover, device)  # one for both ways
        self._tracers = [Tracer(way, flow, device) for way in (transit, transit.reverse)]
        self._known: dict[float, tuple[Tensor, Tensor]] = {}

    def at(self, times: float) -> tuple[Tensor, Tensor]:
        """Origins of the later frame's voxels, and where those of the frame before go to.

        Args:
            times: of the velocity.

        Raises:
            PlanError: too fast to be traced.
        """
        if times not in self._known:
            most = None if times == 1 else FEW_STEPS
            origins, ends = (
                tracer(places, times, most)
                for tracer, places in zip(self._tracers, self._places, strict=True)
            )
            self._known[times] = origins, ends
        return self._known[times]

    def difference(self, before: ActiveSmoke, smoke: ActiveSmoke, times: float = 1.0) -> float:
        """Of the densities of both frames, at ``times`` the velocity.

        Args:
            before, smoke: on the voxels that were traced.
            times: of the velocity.

        Raises:
            PlanError: too fast to be traced.
        """
        origins, ends = self.at(times)
        off = total = 0.0
        pairs = ((smoke, _density_at(before, origins)), (before, _density_at(smoke, ends)))
        for whole, other in pairs:
            own = _some(whole).density.double()
            share = len(whole.ijk) / len(own)
            off += share * float((own - other).abs().sum())
            total += share * float((own + other).sum())
        return off / total


def _some(smoke: ActiveSmoke) -> ActiveSmoke:
    chosen = torch.zeros(len(smoke.ijk), dtype=torch.bool, device=smoke.ijk.device)
    chosen[:: max(1, len(smoke.ijk) // MOST_TRACED)] = True
    return smoke.take(chosen)


def _density_at(smoke: ActiveSmoke, positions: Tensor) -> Tensor:
    """The density at points, [N] float64; 0 outside."""
    found, near = sample_colours(smoke, smoke.density[:, None], positions)
    return (found * near)[:, 0].double()
