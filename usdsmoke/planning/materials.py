"""What a look's material does, and which bound materials hide the look, in sentences."""

from collections.abc import Iterable

from usdsmoke.base.naming import colour_names
from usdsmoke.planning.plan import Omission, VolumePlan
from usdsmoke.usd.materials import binds_material


def materials_needed(volumes: Iterable[VolumePlan]) -> list[str]:
    """The materials that the layer will hold, a sentence for each Volume."""
    return [
        f"a material of <{volume.source.prim_path}> ({', '.join(targets)})"
        for volume in volumes
        if (targets := volume.config.layer.material_targets) and _binds(volume)
    ]


def hidden_look(volume: VolumePlan) -> list[Omission]:
    """The look, where a bound material does not read it; empty where it is seen."""
    if not _has_colour(volume) or _binds(volume):
        return []
    layer = volume.config.layer
    colours = colour_names(layer.scatter_colour, layer.split_rgb)
    hiding = [material for material in volume.source.materials if material.hides(colours)]
    if not hiding:
        return []
    path, material = volume.source.prim_path, hiding[0]
    if not material.can_replace:
        advice = "its binding is stronger than any on the Volume, so bind another material there"
    else:
        advice = "layer.material=replace binds one that does"
    reason = f"its material <{material.prim_path}> reads no {' or '.join(colours)}; {advice}"
    return [Omission(f"the look of <{path}> in renderers", reason)]


def hidden_look_warnings(volumes: Iterable[VolumePlan]) -> list[str]:
    """The same as warnings at the end of a run."""
    return [
        f"{omission.what} is not seen: {omission.reason}"
        for volume in volumes
        for omission in hidden_look(volume)
    ]


def _binds(volume: VolumePlan) -> bool:
    return binds_material(volume.config.layer, _has_colour(volume), volume.source.materials)


def _has_colour(volume: VolumePlan) -> bool:
    return "colour" in volume.config.optimize.steps
