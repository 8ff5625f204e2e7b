"""The settings of each frame, which frames are computed, and the octaves that windows share.

No torch here, because the plan uses it.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.naming import EMISSION
from usdsmoke.base.storage import check_half
from usdsmoke.base.volume import DenseField, FrameControls, VolumeSource
from usdsmoke.config.look_sections import ColourConfig
from usdsmoke.config.setting_model import extra_of
from usdsmoke.config.settings import Config, declared_settings, style_shares
from usdsmoke.core.smoke.schedule import (
    OCTAVE_SCALE,
    network_iterations,
    octave_iterations,
    warm_iterations,
)

BRIGHTEST = 2.54  # times white, of what a voxel emits: ``core.smoke.srgb.BRIGHTEST``, linear
# The dotted name of a setting by the field of ``FrameControls`` that stands for it.
SETTINGS = {
    extra["control"]: name
    for name, field in declared_settings().items()
    if "control" in (extra := extra_of(field))
}


def frame_config(
    config: Config, controls: FrameControls, time_code: float, n_styles: int | None = None
) -> Config:
    """The settings of one frame; the run's own object where it has no controls.

    Args:
        config: of the run.
        controls: what is not None stands in place of the run's.
        time_code: of the frame, for messages.
        n_styles: style images, to check their weights by; None leaves those unchecked.

    Raises:
        ConfigError: a value out of the setting's range, or not one weight for each style image, or
            none above 0; the message names the timeCode.
    """
    values = {
        name: value
        for control, name in SETTINGS.items()
        if (value := getattr(controls, control)) is not None
    }
    if not values:
        return config
    try:
        own = config.with_values(values)
        if n_styles is not None and controls.style_weights is not None:
            style_shares(own.style, n_styles)
    except ConfigError as error:
        raise ConfigError(f"at timeCode {time_code:g}: {error}") from None
    return own


def check_controls(volume: VolumeSource, config: Config, n_styles: int) -> None:
    """Refuse controls that a frame cannot be computed with, before anything is read.

    Args:
        volume: all of its frames are looked at.
        config: the Volume's settings.
        n_styles: its style images.

    Raises:
        ConfigError: see ``frame_config``; the message names the Volume too.
    """
    for frame in volume.frames:
        try:
            frame_config(config, frame.controls, frame.time_code, n_styles)
        except ConfigError as error:
            raise ConfigError(f"Volume <{volume.prim_path}>: {error}") from None


def in_effect(config: Config, controls: FrameControls) -> bool:
    """Whether the effect is to be seen in a frame: otherwise the source is given back."""
    strength = config.optimize.strength if controls.strength is None else controls.strength
    return config.losses.style > 0 and strength > 0


def frames_ahead(config: Config, controls: Iterable[FrameControls]) -> int:
    """On how many frames after it a frame's coarse start depends at most.

    Its colours are averaged with the next frame's. Those are painted on density that is averaged
    with the one after it, and where that one has a strength of 0, it is left out or not for the
    strength of a third.

    Args:
        controls: of all frames.
    """
    steps = config.optimize.steps
    n_painted = "colour" in steps and config.colour.smoothing > 0
    n_moved = "shape" in steps and config.shape.smoothing > 0
    n_unseen = not all(in_effect(config, own) for own in controls)
    return int(n_painted) + int(n_moved) + int(n_unseen)


def is_computed(effect: Sequence[bool]) -> list[bool]:
    """Which frames of a sequence are optimised: those in effect, and the ones next to them.

    >>> is_computed([False, False, False, True, True])
    [False, False, True, True, True]

    A frame of strength 0 is the source whatever is computed for it, but beside a frame that takes
    effect it begins or ends its chain: a fade then starts from a result, not from nothing.

    Args:
        effect: from ``in_effect``, by frame.
    """
    padded = [False, *effect, False]
    return [any(padded[n : n + 3]) for n in range(len(effect))]


def without_network(config: Config) -> Config:
    """The settings with frames that start from noise and from neighbours.

    Where the network would have painted them alone, or left nothing but the finest octave to do,
    they get the configured or the default iterations of all octaves: from noise, fewer are of no
    use.
    """
    optimize, colour = config.optimize, config.colour
    if len(colour.iterations) > 1 and not any(colour.iterations[:-1]):
        colour = colour.replace(iterations=ColourConfig().iterations)
    own = optimize.replace(start="", iterations=optimize.iterations or None)
    return config.replace(optimize=own, colour=colour)


def step_iterations(
    config: Config, step: str, is_warm: bool = False, n_voxels: int = 0
) -> list[int]:
    """Iterations of a frame's step per octave, coarse to fine.

    Args:
        config: of the frame.
        step: "shape" or "colour".
        is_warm: whether the frame starts from its neighbour's result.
        n_voxels: of its smoke, where a network may paint it: see ``network_iterations``.
    """
    octaves = octave_iterations(getattr(config, step).iterations, config.optimize.iterations)
    if is_warm:
        return warm_iterations(octaves, config.windows.warm_iterations)
    if step == "colour" and config.optimize.start:
        return network_iterations(octaves, n_voxels)
    return octaves


def check_storable(density: DenseField, time_code: float, gamma_w: float, config: Config) -> None:
    """Refuse floats that cannot hold what a frame will have: of 32 bits, or of 16 if asked for.

    Args:
        density: of the frame, as it will be stylized.
        gamma_w: its extinction per density, 1/stage unit.
        config: of the frame.

    Raises:
        ConfigError: see ``check_half``; or the emission is too bright.
    """
    densest = float(density.values.max(initial=0.0))
    brightest = brightest_emission(densest, gamma_w, config)
    if config.grids.half:
        check_half(time_code, densest, brightest)
    if not brightest <= np.finfo(np.float32).max:
        raise ConfigError(
            f"the emission at timeCode {time_code:g} reaches up to {brightest:.3g}, which 32-bit "
            "floats cannot hold. Raise optics.exposure, lower optics.gamma, or scale the Volume."
        )


def brightest_emission(densest: float, gamma_w: float, config: Config) -> float:
    """The largest number that the emission's grid may hold; 0 where a frame gets no emission.

    Args:
        densest: the frame's largest density.
        gamma_w: extinction per density, 1/stage unit.
        config: of the frame.
    """
    if EMISSION not in config.painted:
        return 0.0
    exposure = 2.0 ** (config.optics.exposure or 0.0)
    per_density = BRIGHTEST * gamma_w * config.optimize.strength / exposure
    return per_density if config.layer.emission_mode == "perDensity" else per_density * densest


def network_alone(config: Config) -> bool:
    """Whether frames are what a network paints, each by itself."""
    return config.optimize.paints and not any(step_iterations(config, "colour"))


def are_independent(config: Config) -> bool:
    """Whether no frame has anything from another one: nothing is moved, carried or blended."""
    moves = "shape" in config.optimize.steps and any(step_iterations(config, "shape"))
    return network_alone(config) and not moves


def fine_octaves(config: Config) -> int:
    """The octaves of a step that follow the shared coarse step; 0 where windows share none."""
    n_octaves = [len(getattr(config, step).iterations) for step in config.optimize.steps]
    # every step keeps one octave at least for the windows, and one that has no more shares none
    n_fine = max(min(n_octaves) - config.windows.shared_octaves, 1)
    return n_fine if n_fine < min(n_octaves) else 0


def coarse_factor(config: Config) -> int:
    """How many times larger the voxels of the shared coarse step are; 1 when there is none."""
    return OCTAVE_SCALE ** fine_octaves(config)
