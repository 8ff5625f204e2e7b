"""The Volumes of a stage as a run takes them: with settings, cameras and lights of their own."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pxr import Usd

from usdsmoke.base.volume import EarlierLooks
from usdsmoke.config.settings import Config
from usdsmoke.usd.stage.cameras import seen_through
from usdsmoke.usd.stage.lights import lit_by
from usdsmoke.usd.stage.originals import check_originals, open_source
from usdsmoke.usd.stage.volumes import find_volumes
from usdsmoke.usd.volume_settings import ResolvedVolumes, resolve_volumes


def read_source(
    file_path: str | os.PathLike[str],
    config: Config,
    styles: Sequence[Path] = (),
    bare: bool = False,
) -> tuple[Usd.Stage, EarlierLooks, ResolvedVolumes]:
    """The stage without its looks, what was left out, and its Volumes with their settings.

    Args:
        styles: absolute paths of the images that were given for the run.
        bare: whether Volumes may be without images; what they are made of is not checked then.

    Raises:
        UsdSmokeError: see ``open_source``, ``find_volumes``, ``check_originals``,
            ``resolve_volumes``, ``seen_through`` and ``lit_by``.
    """
    stage, earlier = open_source(file_path, config.stage.restylize)
    with_styles, copied = not (styles or bare), config.layer.copy_fields
    found = find_volumes(stage, config.stage, with_styles=with_styles, copied=copied)
    if not (bare or config.stage.restylize):
        check_originals(stage, found)
    resolved = resolve_volumes(found, config, styles, bare)
    configs = [own.config for own in resolved.volumes]
    source = seen_through(stage, resolved.source, [own.views.camera for own in configs])
    source = lit_by(stage, source, [own.lit_optics for own in configs])
    return stage, earlier, replace(resolved, source=source)
