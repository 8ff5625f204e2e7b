"""What settings that change from frame to frame mean for a plan, in sentences."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from usdsmoke.base.config import Config
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.base.volume import FrameControls
from usdsmoke.core.smoke.controls import SETTINGS, in_effect

if TYPE_CHECKING:
    from usdsmoke.planning.plan import VolumePlan

__all__ = ["controls_needed", "controls_omitted", "takes_effect"]


def takes_effect(config: Config, volumes: Sequence["VolumePlan"]) -> bool:
    """Whether there is anything to optimise: otherwise the source is given back.

    Args:
        config: of these Volumes; without any frame it alone counts.
        volumes: whose frames may have a strength of their own.
    """
    controls = _controls(volumes) or [FrameControls()]
    return any(in_effect(config, own) for own in controls)


def controls_needed(volumes: Sequence["VolumePlan"]) -> list[str]:
    """The settings that frames have values of their own for, a sentence each."""
    sentences = []
    for name, (section, key) in SETTINGS.items():
        values = [getattr(own, name) for own in _controls(volumes)]
        found = [value for value in values if value is not None]
        if found:
            span = "" if name == "style_weights" else f", {min(found):g} to {max(found):g}"
            count = f"{len(found)} frame{'' if len(found) == 1 else 's'}"
            sentences.append(f"{section}.{key} by frame, from the stage, for {count}{span}")
    return sentences


def controls_omitted(config: Config, volumes: Sequence["VolumePlan"]) -> list[tuple[str, str]]:
    """What is not optimised, and why: all of it, or frames that no frame in effect is next to."""
    if config.losses.style == 0 and config.optimize.strength > 0:
        return []  # said of the style already
    if not takes_effect(config, volumes):
        return [("the optimisation", "optimize.strength is 0: the source is given back")]
    omitted = []
    for volume in volumes:
        codes = [frame.source.time_code for frame in volume.frames if not frame.size.computed]
        if codes:
            what = f"the optimisation at timeCodes {format_time_codes(codes)}"
            reason = "optimize.strength is 0 there and beside: the source is given back"
            omitted.append((f"{what} of <{volume.source.prim_path}>", reason))
    return omitted


def _controls(volumes: Sequence["VolumePlan"]) -> list[FrameControls]:
    return [frame.source.controls for volume in volumes for frame in volume.frames]
