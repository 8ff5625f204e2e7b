"""Which losses, network layers and iterations a run does without, in sentences."""

from collections.abc import Iterable

from usdsmoke.base.config import Config
from usdsmoke.core.style.definition import default_layers, learned_layers, oriented_layers

__all__ = ["losses_omitted", "unneeded_layers"]

_OTHERS = ("total_variation", "histogram", "content", "laplacian", "photorealism")


def losses_omitted(config: Config) -> list[tuple[str, str]]:
    """What is not evaluated when pictures are judged, and why: pairs of thing and reason."""
    omitted = []
    if config.losses.style == 0:
        omitted.append(("style loss and features", "losses.style is 0"))
    omitted += [
        (f"{name.replace('_', ' ')} loss", f"losses.{name} is 0")
        for name in _OTHERS
        if getattr(config.losses, name) == 0
    ]
    omitted += _network(config)
    if config.optimize.tolerance > 0:
        reason = f"an octave ends when its loss hardly falls ({config.optimize.tolerance:g})"
        omitted.append(("iterations after convergence", f"{reason}: optimize.tolerance"))
    return omitted


def _network(config: Config) -> list[tuple[str, str]]:
    if config.features.network != "embedded":
        return [("network layers below the last style layer", "nothing looks at them")]
    omitted = [("VGG-19 parameters", "the embedded features need no file")]
    names = unneeded_layers(config)
    if names and config.losses.style:
        omitted.append((f"network layers {', '.join(names)}", "no layer in use is as deep"))
    return omitted


def unneeded_layers(config: Config) -> tuple[str, ...]:
    """The embedded network's layers deeper than all that is looked at, each kind for itself.

    Of the style layers those of weight 0 do not count, of the content layers none without a
    content loss. What lies above a layer in use is evaluated on the way to it.
    """
    names = config.features.layers or list(default_layers())
    weights = config.features.weights or [1.0] * len(names)
    used = {name for name, weight in zip(names, weights, strict=False) if weight > 0}
    if config.losses.content:
        used |= set(config.features.content_layers)
    return (*_deeper(oriented_layers(), used), *_deeper(learned_layers(), used))


def _deeper(names: tuple[str, ...], used: Iterable[str]) -> tuple[str, ...]:
    deepest = max((names.index(name) for name in used if name in names), default=-1)
    return names[deepest + 1 :]
