"""What a plan remarks on: nothing that is wrong, but what may surprise at the end of a run."""

from collections.abc import Sequence

from usdsmoke.base.errors import count_text
from usdsmoke.base.sections import ColourConfig
from usdsmoke.planning.materials import lights_remark
from usdsmoke.planning.plan import VolumePlan

# Times the default learning rate. On the example plume of 32 voxels 16 times it ends 6 % worse, 100
# times 21 % and 1000 times 134 %; the shape step's rate makes no difference (< 1 %).
EXTREME_RATE = 10.0


def list_remarks(volumes: Sequence[VolumePlan]) -> tuple[str, ...]:
    """Sentences about all Volumes, each once."""
    found: list[str] = []
    for volume in volumes:
        found += [*_part(volume), *_rate(volume), *lights_remark(volume.config, volume)]
    return tuple(dict.fromkeys(found))


def measured_on_part(volume: VolumePlan) -> bool:
    """Whether extinction and exposure are measured on some of a Volume's timeCodes."""
    optics = volume.config.optics
    is_open = optics.gamma is None or optics.gamma_shape is None
    return is_open and len(volume.frames) < len(volume.source.time_codes)


def _part(volume: VolumePlan) -> list[str]:
    if not measured_on_part(volume):
        return []
    n_all = count_text(len(volume.source.time_codes), "timeCode")
    return [
        f"extinction and exposure of <{volume.source.prim_path}> are measured on the "
        f"{len(volume.frames)} selected of {n_all}: another selection looks slightly different. "
        "To keep one look, make this result longer with the same command and more --frames, or "
        "set optics.gamma and optics.gamma_shape"
    ]


def _rate(volume: VolumePlan) -> list[str]:
    """A rate that no rule of the optimiser corrects: clipped colours never blow up."""
    config, usual = volume.config, ColourConfig().learning_rate
    rate = config.colour.learning_rate
    if "colour" not in config.optimize.steps or rate <= EXTREME_RATE * usual:
        return []
    return [
        f"colour.learning_rate={rate:g} is {rate / usual:.3g} times the default: a step goes from "
        f"one end of the range to the other. Set {usual:g}, or look closely at the result"
    ]
