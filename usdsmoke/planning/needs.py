"""What a run needs and what it leaves out, in sentences, each omission with its reason."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from usdsmoke.base.config import Config
from usdsmoke.base.naming import colour_names
from usdsmoke.base.time_codes import format_time_code, format_time_codes
from usdsmoke.base.volume import StageSource
from usdsmoke.core.smoke.schedule import octave_iterations
from usdsmoke.planning.camera_needs import camera_needed, camera_omitted
from usdsmoke.planning.control_needs import controls_needed, controls_omitted, takes_effect
from usdsmoke.planning.estimate import n_different_views
from usdsmoke.planning.loss_needs import losses_omitted

if TYPE_CHECKING:
    from usdsmoke.planning.plan import FramePlan, VolumePlan

__all__ = ["Omission", "list_needed", "list_omitted"]

_FEW_CUTS = 8


@dataclass(frozen=True)
class Omission:
    """Something that is not read, computed or written."""

    what: str
    reason: str


def list_needed(config: Config, volumes: Sequence["VolumePlan"]) -> tuple[str, ...]:
    """What will be read, computed and written, one sentence each.

    Args:
        config: the run's settings.
        volumes: with settings of their own; sentences tell for which Volumes where these differ.
    """
    needed = [
        f"density of <{volume.source.prim_path}> at timeCodes "
        f"{format_time_codes(frame.source.time_code for frame in volume.frames)}"
        for volume in volumes
    ]
    needed += _describe_requests(volumes)
    with_velocity = [frame for frame in _frames(volumes) if frame.velocity]
    if with_velocity:
        needed.append(f"velocity of {len(with_velocity)} frames")
    if n_copied := sum(frame.copied is not None for frame in _frames(volumes)):
        needed.append(f"velocity copied into {n_copied} files, so that a frame is one file")
    groups = _by_config(volumes)
    for own, members in groups:
        where = _where(members, " for ") if len(groups) > 1 else ""
        needed += [f"{sentence}{where}" for sentence in _needed_by(own, members)]
    needed += _describe_windows(volumes)
    kind = "half" if config.grids.half else "float"
    coloured = next((own for own, _ in groups if "colour" in own.optimize.steps), config)
    needed.append(
        f"one VDB file a frame with {_describe_grids(coloured)} ({kind}), and the "
        f"{config.layer.format} layer"
    )
    return tuple(needed)


def list_omitted(
    source: StageSource, config: Config, volumes: Sequence["VolumePlan"]
) -> tuple[Omission, ...]:
    """What is left out, and why; of which Volumes, where their settings differ."""
    omitted = [Omission(f"Volume <{path}>", reason) for path, reason in source.omitted.items()]
    groups = _by_config(volumes) or [(config, [])]
    for own, members in groups:
        where = _where(members, " of ") if len(groups) > 1 else ""
        omitted += [
            Omission(f"{omission.what}{where}", omission.reason)
            for omission in _omitted_by(own, members)
        ]
    for volume in volumes:
        omitted += _omitted_of_volume(volume)
    return tuple(omitted)


def _by_config(volumes: Sequence["VolumePlan"]) -> list[tuple[Config, list["VolumePlan"]]]:
    """Volumes of equal settings together, in order."""
    groups: list[tuple[Config, list[VolumePlan]]] = []
    for volume in volumes:
        members = next((members for own, members in groups if own == volume.config), None)
        if members is None:
            groups.append((volume.config, [volume]))
        else:
            members.append(volume)
    return groups


def _where(volumes: Sequence["VolumePlan"], link: str) -> str:
    return link + ", ".join(f"<{volume.source.prim_path}>" for volume in volumes)


def _describe_requests(volumes: Sequence["VolumePlan"]) -> list[str]:
    """What prims ask for themselves and get."""
    sentences = []
    for volume in volumes:
        request = volume.source.request
        names = sorted(f"{section}.{key}" for section, v in request.settings.items() for key in v)
        names = [*(["style images"] if request.styles else []), *names]
        if names:
            sentences.append(f"what <{volume.source.prim_path}> asks for: {', '.join(names)}")
    return sentences


def _needed_by(config: Config, volumes: Sequence["VolumePlan"]) -> list[str]:
    """What Volumes of one configuration need."""
    needed = []
    if n_masked := sum(frame.mask is not None for frame in _frames(volumes)):
        needed.append(
            f"mask {config.stage.mask} of {n_masked} frame{'' if n_masked == 1 else 's'}, which "
            "scales the effect"
        )
    needed += controls_needed(volumes)
    optimizes = takes_effect(config, volumes)
    if config.stage.motion == "estimate" and optimizes:
        needed.append("the smoke's motion, estimated from neighbouring frames (stage.motion)")
    if optimizes:
        layers = f" ({', '.join(config.features.layers)})" if config.features.layers else ""
        needed.append(f"features of the {config.features.network} network{layers}")
        n_views = n_different_views(config.views)
        count = min(config.views.count, n_views)
        needed.append(f"{count} view{'' if count == 1 else 's'} an iteration, drawn from {n_views}")
        needed += camera_needed(config, volumes)
        needed += [_describe_step(step, config) for step in config.optimize.steps]
    controlled = all(frame.source.controls.gamma is not None for frame in _frames(volumes))
    for step, is_set in (
        ("colour", controlled or config.optics.gamma is not None),
        ("shape", config.optics.gamma_shape is not None),
    ):
        if not is_set and step in config.optimize.steps:
            needed.append(
                f"extinction of the {step} step, measured on up to three frames of the shot"
            )
    return needed


def _omitted_by(config: Config, volumes: Sequence["VolumePlan"]) -> list[Omission]:
    """What Volumes of one configuration do without."""
    omitted = _omitted_steps(config)
    omitted += [Omission(*pair) for pair in controls_omitted(config, volumes)]
    omitted += _omitted_views(config)
    if takes_effect(config, volumes):
        omitted += [Omission(*pair) for pair in camera_omitted(config, volumes)]
    frames = _frames(volumes)
    if all(frame.velocity is None for frame in frames):
        omitted.append(Omission("velocity grids", _why_no_velocity(volumes, config)))
    if all(frame.mask is None for frame in frames):
        omitted.append(Omission("mask field", _why_no_mask(config, volumes)))
    return omitted


def _frames(volumes: Sequence["VolumePlan"]) -> list["FramePlan"]:
    return [frame for volume in volumes for frame in volume.frames]


def _describe_step(step: str, config: Config) -> str:
    octaves = octave_iterations(getattr(config, step).iterations, config.optimize.iterations)
    return f"{step} step with {'/'.join(map(str, octaves))} iterations, coarse to fine"


def _describe_grids(config: Config) -> str:
    """The grids of a result's file, as the end of a sentence."""
    if "colour" not in config.optimize.steps:
        return "density"
    emission, *others = colour_names(config.layer.scatter_colour, config.layer.split_rgb)
    if config.layer.emission_mode == "perDensity":
        emission += " per density"
    names = ["density", emission, *others]
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _describe_windows(volumes: Sequence["VolumePlan"]) -> list[str]:
    """What windows have in common: nothing where none follows on another."""
    sentences = []
    if n_coarse := sum(len(volume.coarse_frames) for volume in volumes):
        sentences.append(f"a coarse step over {n_coarse} frames, once, that all windows start from")
    if n_twice := sum(len(volume.twice_frames) for volume in volumes):
        sentences.append(
            f"{n_twice} frame{'' if n_twice == 1 else 's'} in two windows each, to be blended "
            "(windows.overlap)"
        )
    return sentences


def _omitted_steps(config: Config) -> list[Omission]:
    steps = config.optimize.steps
    omitted = []
    if "colour" not in steps:
        what = "RGB emission"
        if config.layer.scatter_colour or config.layer.split_rgb:
            what += " and all that is made from it (layer.scatter_colour, layer.split_rgb)"
        omitted.append(Omission(what, "no colour step is asked for (optimize.steps)"))
    if "shape" not in steps:
        omitted.append(
            Omission("displacement of the density", "no shape step is asked for (optimize.steps)")
        )
    else:
        omitted.append(
            Omission(
                "transmittance along the rays of the shape step",
                "a grey picture is the opacity, which needs column sums only",
            )
        )
    return omitted + [Omission(*pair) for pair in losses_omitted(config)]


def _omitted_views(config: Config) -> list[Omission]:
    if n_different_views(config.views) > 1:
        return []
    return [
        Omission("further views", "one view is asked for (views.azimuth and views.elevation are 0)")
    ]


def _why_no_velocity(volumes: Sequence["VolumePlan"], config: Config) -> str:
    frames = _frames(volumes)
    if len(frames) == 1:
        return "there is one frame only"
    if config.stage.motion == "estimate":
        return "the motion is estimated instead (stage.motion)"
    if config.windows.size == 1:
        return "windows.size is 1: no frame starts from another"
    if all(len(window.time_codes) == 1 for volume in volumes for window in volume.windows):
        return "no two frames share a window"
    return (
        "neither the Volumes nor their files have any under the usual names (stage.velocity): "
        "results keep their places from frame to frame and do not follow the smoke; "
        "stage.motion=estimate would estimate its motion"
    )


def _why_no_mask(config: Config, volumes: Sequence["VolumePlan"]) -> str:
    if not config.stage.mask:
        return "none is named (stage.mask)"
    if takes_effect(config, volumes):
        return "every frame is empty"
    return "there is no effect to be scaled"


def _omitted_of_volume(volume: "VolumePlan") -> list[Omission]:
    omitted = []
    where = f"of <{volume.source.prim_path}>"
    if volume.source.request.ignored:
        omitted.append(
            Omission(
                f"{', '.join(volume.source.request.ignored)} {where}",
                "UsdSmokeStyleAPI is not applied to the prim; apply it, and they count",
            )
        )
    if volume.source.other_fields:
        omitted.append(
            Omission(
                f"fields {', '.join(volume.source.other_fields)} {where}",
                "only density, velocity and mask are used; they stay as they are on the stage",
            )
        )
    if volume.cuts and volume.config.windows.size > 1:
        omitted.append(_omitted_over_cuts(volume.cuts, where))
    empty = [frame.source.time_code for frame in volume.frames if frame.is_empty]
    if empty:
        omitted.append(
            Omission(
                f"pictures and features at timeCodes {format_time_codes(empty)} {where}",
                "the frames are empty",
            )
        )
    filled = [frame for frame in volume.frames if not frame.is_empty]
    if filled and all(1 in frame.size.box for frame in filled):
        omitted.append(
            Omission(f"everything three-dimensional {where}", "the volume is one voxel thick")
        )
    n_box = sum(frame.size.box[0] * frame.size.box[1] * frame.size.box[2] for frame in filled)
    n_active = sum(frame.size.active_voxels for frame in filled)
    if n_box > n_active:
        omitted.append(
            Omission(
                f"{1 - n_active / n_box:.0%} of the boxes {where}",
                "these voxels are empty; only active ones are projected and optimised",
            )
        )
    return omitted


def _omitted_over_cuts(cuts: Sequence[tuple[float, float]], where: str) -> Omission:
    places = [" and ".join(map(format_time_code, cut)) for cut in cuts[:_FEW_CUTS]]
    more = [f"{len(cuts) - _FEW_CUTS} more places"] if len(cuts) > _FEW_CUTS else []
    return Omission(
        f"coherence over cuts {where}",
        f"the sequence is cut between timeCodes {', '.join([*places, *more])}: these steps are "
        "longer than two frames and than twice the usual step",
    )
