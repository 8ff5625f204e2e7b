"""What a plan remarks on: nothing that is wrong, but what may surprise at the end of a run."""

from collections.abc import Sequence

from usdsmoke.base.errors import count_text
from usdsmoke.base.sections import ColourConfig, ShapeConfig
from usdsmoke.planning.plan import VolumePlan

EXTREME_RATE = 8.0  # times the default learning rate; measured: strokes tear from about there


def list_remarks(volumes: Sequence[VolumePlan]) -> tuple[str, ...]:
    """Sentences about all Volumes, each once."""
    found = [text for volume in volumes for text in (*_part(volume), *_rates(volume))]
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
        "To keep one look, stylize all of them once and then parts with --frames in the same "
        "folder, or set optics.gamma and optics.gamma_shape"
    ]


def _rates(volume: VolumePlan) -> list[str]:
    config, texts = volume.config, []
    for step, section in (("shape", ShapeConfig), ("colour", ColourConfig)):
        usual = section().learning_rate
        rate = getattr(config, step).learning_rate
        if step in config.optimize.steps and rate > EXTREME_RATE * usual:
            texts.append(
                f"{step}.learning_rate={rate:g} is {rate / usual:.3g} times the default: a step "
                f"goes from one end of the range to the other. Set {usual:g}, or look closely at "
                "the result"
            )
    return texts
