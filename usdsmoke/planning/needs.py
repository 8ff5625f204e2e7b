"""What a run needs and what it leaves out, in sentences; each omission has a reason."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from usdsmoke.base.errors import count_text
from usdsmoke.base.naming import EMISSION
from usdsmoke.base.time_codes import format_time_code, name_time_codes
from usdsmoke.base.volume import FrameControls, StageSource
from usdsmoke.config.settings import Config
from usdsmoke.core.features.definition import learned_layers, oriented_layers
from usdsmoke.core.features.layers import content_layers, style_layers, vgg19_layers
from usdsmoke.core.sequence.controls import SETTINGS, are_independent, in_effect, step_iterations
from usdsmoke.core.smoke.schedule import has_one_view, pool_size, views_aside
from usdsmoke.planning.copied import REPLACED
from usdsmoke.planning.frames import is_split
from usdsmoke.planning.materials import lights_needed, lights_omitted, materials_needed
from usdsmoke.planning.networks import start_needed
from usdsmoke.planning.plan import FramePlan, Omission, VolumePlan
from usdsmoke.planning.visibility import invisible_parts
from usdsmoke.usd.schema import STYLE_API

Volumes = Sequence[VolumePlan]

_FEW_CUTS = 8
_MANY_LAYERS = 5  # of which only the first and the last are named
_COLUMN_SUMS = Omission(
    "transmittance along the rays of the shape step",
    "a grey picture is the opacity, which needs column sums only",
    expected=True,
)


def list_needed(config: Config, volumes: Volumes) -> tuple[str, ...]:
    """What will be read, computed and written, one sentence each."""
    # Read.
    needed = [
        f"density of <{volume.source.prim_path}> at {_time_codes(volume.frames)}"
        for volume in volumes
    ]
    needed += [volume.request_text for volume in volumes if volume.request_text]
    if n_velocity := sum(frame.velocity is not None for frame in _frames(volumes)):
        needed.append(f"velocity of {count_text(n_velocity, 'frame')}")
    if n_copied := sum(frame.copied is not None for frame in _frames(volumes)):
        needed.append(
            f"velocity copied into {count_text(n_copied, 'file')}, so that each frame is one file"
        )
    for moves, how in ((True, "moved with the density"), (False, "as they are")):
        chosen = [volume for volume in volumes if volume.moves_fields == moves]
        if copied := sorted({grid.name for frame in _frames(chosen) for grid in frame.others}):
            needed.append(f"copied {how}: {', '.join(copied)}")
    # Computed.
    groups = _by_config(volumes)
    for own, members in groups:
        where = _where(members, " for ") if len(groups) > 1 else ""
        needed += [f"{sentence}{where}" for sentence in _needed_by(own, members)]
    if n_coarse := sum(len(volume.coarse_frames) for volume in volumes):
        needed.append(f"one coarse step over {n_coarse} frames, which all windows start from")
    if n_twice := sum(len(volume.overlap_frames) for volume in volumes):
        needed.append(
            f"{count_text(n_twice, 'frame')} in two windows each, blended (windows.overlap)"
        )
    # Written.
    kind = "half" if config.grids.half else "float"
    coloured = next((own for own, _ in groups if "colour" in own.optimize.steps), config)
    needed.append(
        f"one VDB file per frame with {_grids_text(coloured)} ({kind}), and the "
        f"{config.layer.format} layer"
    )
    needed += materials_needed(volumes)
    return tuple(needed)


def list_omitted(source: StageSource, config: Config, volumes: Volumes) -> tuple[Omission, ...]:
    """What is left out, and why. Sentences name the Volumes if settings differ."""
    omitted = [Omission(f"Volume <{path}>", reason) for path, reason in source.omitted.items()]
    omitted += [Omission("frames", sentence) for sentence in source.missing]
    if config.layer.contact_sheet == 0:
        omitted.append(Omission("contact sheet", "layer.contact_sheet is 0"))
    omitted += lights_omitted(source, volumes)
    groups = _by_config(volumes) or [(config, [])]
    for own, members in groups:
        where = _where(members, " of ") if len(groups) > 1 else ""
        found = [
            *_omitted_steps(own),
            *_omitted_losses(own),
            *_omitted_strength(own, members),
            *_omitted_views(own, members),
            *_omitted_inputs(own, members),
        ]
        omitted += [replace(item, what=f"{item.what}{where}") for item in found]
    for volume in volumes:
        omitted += _omitted_of_volume(volume)
    return tuple(omitted)


def takes_effect(config: Config, volumes: Volumes) -> bool:
    """True if there is anything to optimise. Otherwise the result is the source."""
    controls = _controls(volumes) or [FrameControls()]
    return any(in_effect(config, own) for own in controls)


def unneeded_layers(config: Config) -> tuple[str, ...]:
    """The network's layers that are deeper than every layer in use.

    Style layers of weight 0 are not in use, nor are content layers without a content loss. Layers
    above one in use are evaluated on the way to it.

    Raises:
        ConfigError: unknown layers, or weights that do not fit them.
    """
    used = set(style_layers(config.features))
    if config.losses.content:
        used |= set(content_layers(config.features))
    vgg19 = config.features.network == "vgg19"
    kinds = (vgg19_layers(),) if vgg19 else (oriented_layers(), learned_layers())
    return tuple(name for kind in kinds for name in _deeper(kind, used))


def _by_config(volumes: Volumes) -> list[tuple[Config, list[VolumePlan]]]:
    """Volumes with equal settings together, in order."""
    groups: list[tuple[Config, list[VolumePlan]]] = []
    for volume in volumes:
        members = next((members for own, members in groups if own == volume.config), None)
        if members is None:
            groups.append((volume.config, [volume]))
        else:
            members.append(volume)
    return groups


def _frames(volumes: Volumes) -> list[FramePlan]:
    return [frame for volume in volumes for frame in volume.frames]


def _controls(volumes: Volumes) -> list[FrameControls]:
    return [frame.source.controls for frame in _frames(volumes)]


def _is_thin(frames: Iterable[FramePlan]) -> bool:
    """Whether there is smoke, and all of it is one voxel thick."""
    filled = [frame for frame in frames if not frame.is_empty]
    return bool(filled) and all(frame.size.is_thin for frame in filled)


def _time_codes(frames: Iterable[FramePlan]) -> str:
    return name_time_codes(frame.source.time_code for frame in frames)


def _where(volumes: Volumes, link: str) -> str:
    return link + ", ".join(f"<{volume.source.prim_path}>" for volume in volumes)


def _needed_by(config: Config, volumes: Volumes) -> list[str]:
    """What Volumes with the same settings need."""
    needed, frames = [], _frames(volumes)
    if n_masked := sum(frame.mask is not None for frame in frames):
        needed.append(
            f"mask {config.stage.mask} of {count_text(n_masked, 'frame')}, which scales the effect"
        )
    needed += _animated_settings(volumes)
    if takes_effect(config, volumes):
        if config.stage.motion == "estimate":
            needed.append("the motion of the smoke, estimated from neighbours (stage.motion)")
        layers = f" ({', '.join(config.features.layers)})" if config.features.layers else ""
        needed.append(f"features of the {config.features.network} network{layers}")
        n_views = pool_size(config.views, _is_thin(frames))
        count = count_text(min(config.views.count, n_views), "view")
        needed.append(f"{count} per iteration, drawn from {n_views}")
        if config.views.camera:
            needed.append(_camera_text(config, frames))
        needed += [*lights_needed(config, frames), *start_needed(config)]
        steps = ["colour"] if are_independent(config) else config.optimize.steps
        needed += [_step_text(step, config) for step in steps]
    has_gamma = all(frame.source.controls.gamma is not None for frame in frames)
    for step, is_set in (
        ("colour", has_gamma or config.optics.gamma is not None),
        ("shape", config.optics.gamma_shape is not None),
    ):
        if not is_set and step in config.optimize.steps:
            needed.append(f"extinction of the {step} step, measured on up to three frames")
    return needed


def _camera_text(config: Config, frames: Sequence[FramePlan]) -> str:
    count, is_thin = count_text(len(frames), "timeCode"), _is_thin(frames)
    text = f"the camera <{config.views.camera}> at {count}; views are around it"
    coarse, fine = (views_aside(config.views, is_coarse, is_thin) for is_coarse in (True, False))
    if coarse and "colour" in config.optimize.steps:
        n_views = pool_size(config.views, is_thin)
        text += (
            f", but {fine} of {n_views} of the colour step's (in coarse octaves {coarse}) are of "
        )
        text += "other sides; views.azimuth=12 leaves these out"
    return text


def _animated_settings(volumes: Volumes) -> list[str]:
    """The settings that frames have their own values for, a sentence each."""
    sentences = []
    for control, name in SETTINGS.items():
        found = [v for own in _controls(volumes) if (v := getattr(own, control)) is not None]
        if found:
            span = "" if control == "style_weights" else f", {min(found):g} to {max(found):g}"
            sentences.append(
                f"{name} per frame for {count_text(len(found), 'frame')}{span}, from the stage"
            )
    return sentences


def _step_text(step: str, config: Config) -> str:
    iterations = step_iterations(config, step)
    how = f"with {'/'.join(map(str, iterations))} iterations, coarse to fine"
    if step == "colour" and config.optimize.paints:
        how = f"with {sum(iterations)} iterations behind a network"
    what = f", which paints {' and '.join(config.painted)}" if step == "colour" else ""
    return f"{step} step {how}{what}"


def _grids_text(config: Config) -> str:
    """The grids of a result's file, as the end of a sentence."""
    if "colour" not in config.optimize.steps:
        return "density"
    colours = list(config.colour_grids)
    if config.layer.emission_mode == "perDensity" and colours[0] == EMISSION:
        colours[0] += " per density"
    names = ["density", *colours]
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _omitted_steps(config: Config) -> list[Omission]:
    steps, omitted = config.optimize.steps, []
    if "colour" not in steps:
        what = "RGB emission"
        if config.layer.scatter_colour or config.layer.split_rgb:
            what += " and what is made from it (layer.scatter_colour, layer.split_rgb)"
        omitted.append(Omission(what, "optimize.steps has no colour step"))
    why = "" if "shape" in steps else "optimize.steps has no shape step"
    if are_independent(config):
        why = "optimize.iterations is 0, and no network moves smoke"
    omitted.append(Omission("displacement of the density", why) if why else _COLUMN_SUMS)
    return omitted


def _omitted_losses(config: Config) -> list[Omission]:
    omitted, losses = [], config.losses
    if losses.style == 0:
        omitted.append(Omission("style loss and features", "losses.style is 0"))
    omitted += [
        Omission(f"{name.replace('_', ' ')} loss", f"losses.{name} is 0", expected=True)
        for name in losses.BESIDE_STYLE
        if getattr(losses, name) == 0
    ]
    if config.features.network == "embedded":
        reason = "the embedded features need no file"
        omitted.append(Omission("VGG-19 parameters", reason, expected=True))
    if losses.style and (names := unneeded_layers(config)):
        what = ", ".join(names) if len(names) < _MANY_LAYERS else f"{names[0]} to {names[-1]}"
        reason = "no layer in use is as deep"
        omitted.append(Omission(f"network layers {what}", reason, expected=True))
    if config.optimize.tolerance > 0:
        omitted.append(
            Omission(
                "iterations after convergence",
                "an octave ends when its loss hardly decreases "
                f"(optimize.tolerance={config.optimize.tolerance:g})",
                expected=True,
            )
        )
    return omitted


def _deeper(names: tuple[str, ...], used: Iterable[str]) -> tuple[str, ...]:
    deepest = max((names.index(name) for name in used if name in names), default=-1)
    return names[deepest + 1 :]


def _omitted_strength(config: Config, volumes: Volumes) -> list[Omission]:
    """Frames that are not optimised because their strength, and that of neighbours, is 0."""
    if config.losses.style == 0 and config.optimize.strength > 0:
        return []  # reported with the style loss
    if not takes_effect(config, volumes):
        reason = "optimize.strength is 0, so the result is the source"
        return [Omission("the optimisation", reason)]
    omitted = []
    for volume in volumes:
        still = [frame for frame in volume.frames if not frame.size.computed]
        if still:
            what = f"the optimisation at {_time_codes(still)}"
            reason = "optimize.strength is 0 there and next to it, so the result is the source"
            omitted.append(Omission(f"{what} of <{volume.source.prim_path}>", reason))
    return omitted


def _omitted_views(config: Config, volumes: Volumes) -> list[Omission]:
    omitted = []
    if has_one_view(config.views):
        omitted.append(Omission("other views", "views.azimuth and views.elevation are 0"))
    if not takes_effect(config, volumes):
        return omitted
    if not config.views.camera:
        reason = "views.camera is not set; views are around the up axis"
        return [*omitted, Omission("the shot's camera", reason, expected=True)]
    for volume in volumes:
        omitted += invisible_parts(config, volume)
    return omitted


def _omitted_inputs(config: Config, volumes: Volumes) -> list[Omission]:
    omitted, frames = [], _frames(volumes)
    if all(frame.velocity is None for frame in frames):
        is_still = all(len(volume.frames) == 1 for volume in volumes)
        expected = is_still or config.windows.size == 1 or are_independent(config)
        reason = _why_no_velocity(volumes, config)
        omitted.append(Omission("velocity grids", reason, expected))
    if all(frame.mask is None for frame in frames):
        expected = not config.stage.mask
        omitted.append(Omission("mask field", _why_no_mask(config, volumes), expected))
    return omitted


def _why_no_velocity(volumes: Volumes, config: Config) -> str:
    if len(_frames(volumes)) == 1:
        return "there is only one frame"
    if are_independent(config):
        return "a network paints each frame by itself"
    if config.stage.motion == "estimate":
        return "the motion is estimated instead (stage.motion)"
    if config.windows.size == 1:
        return "windows.size is 1, so no frame starts from another"
    if all(len(window.time_codes) == 1 for volume in volumes for window in volume.windows):
        return "no two frames share a window"
    if any(is_split(volume.source, frame.source) for volume in volumes for frame in volume.frames):
        return "its components are in several files. Merge them into one file per frame"
    return (
        "none found, so the pattern stays in place unless stage.motion=estimate. The smoke moves "
        "without it; grids of unusual names are named with stage.velocity"
    )


def _why_no_mask(config: Config, volumes: Volumes) -> str:
    if not config.stage.mask:
        return "stage.mask is not set"
    if takes_effect(config, volumes):
        return "every frame is empty"
    return "there is no effect to scale"


def _omitted_of_volume(volume: VolumePlan) -> list[Omission]:
    """What one Volume's stage values and headers leave out."""
    found: list[tuple[str, str]] = []
    if ignored := volume.source.request.ignored:
        reason = f"{STYLE_API} is not applied to the prim; apply it to use them"
        found.append((", ".join(ignored), reason))
    ours = {*volume.config.colour_grids} & {*volume.source.other_fields}
    found += [(f"field {name}", REPLACED) for name in sorted(ours)]
    if others := [name for name in volume.source.other_fields if name not in ours]:
        what = f"{'field' if len(others) == 1 else 'fields'} {', '.join(others)}"
        found.append((what, "not used; stays in the source's files (layer.copy_fields)"))
    if volume.beside:
        what = f"{'grid' if len(volume.beside) == 1 else 'grids'} {', '.join(volume.beside)}"
        found.append((what, "in the density's file; layer.copy_fields=[all] copies it too"))
    found += [(f"the copy of {name}", reason) for name, reason in volume.not_copied.items()]
    if volume.cuts and volume.config.windows.size > 1:
        found.append(("coherence over cuts", _cuts_text(volume.cuts)))
    if empty := [frame for frame in volume.frames if frame.is_empty]:
        what = f"pictures and features at {_time_codes(empty)}"
        found.append((what, "the frames are empty"))
    filled = volume.filled
    if filled and all(1 in frame.size.box for frame in filled):
        found.append(("everything three-dimensional", "the volume is one voxel thick"))
    n_box = sum(frame.size.box[0] * frame.size.box[1] * frame.size.box[2] for frame in filled)
    n_active = sum(frame.size.active_voxels for frame in filled)
    where = f"of <{volume.source.prim_path}>"
    omitted = [Omission(f"{what} {where}", reason) for what, reason in found]
    if n_box > n_active:
        what = f"{1 - n_active / n_box:.0%} of the bounding boxes {where}"
        reason = "these voxels are empty; only active ones are projected and optimised"
        omitted.append(Omission(what, reason, expected=True))
    return omitted


def _cuts_text(cuts: Sequence[tuple[float, float]]) -> str:
    places = [" and ".join(map(format_time_code, cut)) for cut in cuts[:_FEW_CUTS]]
    more = [f"{len(cuts) - _FEW_CUTS} more places"] if len(cuts) > _FEW_CUTS else []
    return (
        f"the sequence is cut between timeCodes {', '.join([*places, *more])}: these steps are "
        "longer than two frames and than twice the usual step"
    )
