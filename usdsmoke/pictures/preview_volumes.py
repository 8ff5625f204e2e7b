"""Which Volumes and timeCodes a preview draws, what it leaves out, and what it refuses."""

from pxr import Sdf, Usd, UsdVol

from usdsmoke.base.errors import AssetNotResolved, FieldNotFound, GridError, UsdSmokeError
from usdsmoke.base.time_codes import parse_frames, select_frames
from usdsmoke.base.volume import StageSource
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.pictures.preview_smoke import Smoke, compose_one
from usdsmoke.usd.stage import find_volumes


def find_smoke(stage: Usd.Stage, config: StageConfig) -> Smoke:
    """The Volumes of a stage at the requested timeCodes.

    A Volume that is not named, and cannot be used there, is left out with a note.

    Args:
        stage: from ``open_stage``.
        config: which Volumes, timeCodes and fields; no timeCodes means all there are.

    Raises:
        StageError: no Volume, an unknown one, a timeCode that no Volume has, a file of a named
            Volume that is not there, or nothing to draw; or a look layer without its source.
    """
    problems: list[str] = []
    named = [path for path in config.prims if _is_volume(stage, path)]
    if named and len(named) == len(config.prims):  # what is named must be there
        selected = _find(stage, config)
    else:  # all Volumes, or those of a group
        selected = _find(stage, config, problems)
        if not {volume.prim_path for volume in selected.volumes}.issuperset(named):
            selected = _find(stage, config)
    whole, faults = selected, list[str]()
    if config.frames:
        try:
            whole = _find(stage, config.replace(frames=""), faults)
        except (AssetNotResolved, FieldNotFound):
            whole = selected  # files of frames that are not requested may be missing
        if named and len(problems) > len(faults):  # not of a Volume that cannot be drawn at all
            selected = _find(stage, config)
    smoke = Smoke(
        stage,
        selected,
        whole,
        passed_over=_passed_over(config, len(whole.volumes), bool(named)),
        without_file=_without_file(stage, config, selected, whole),
    )
    for path, reason in selected.omitted.items():
        smoke.notes[f"<{path}> is not drawn: {reason}"] = None
    notes = [*selected.missing, *problems]
    smoke.notes |= {f"left out: {sentence}": None for sentence in notes}
    smoke.notes |= dict.fromkeys(selected.dropped)
    smoke.notes |= {note: None for volume in selected.volumes for note in volume.notes}
    return smoke


def _passed_over(
    config: StageConfig, n_volumes: int, has_named: bool
) -> tuple[type[UsdSmokeError], ...]:
    """What leaves a Volume out of a frame, instead of refusing the preview."""
    if not config.frames or (n_volumes > 1 and not has_named):
        return AssetNotResolved, GridError
    return (AssetNotResolved,) if config.allow_missing else ()


def _without_file(
    stage: Usd.Stage, config: StageConfig, selected: StageSource, whole: StageSource
) -> tuple[float, ...]:
    """Requested timeCodes at which some Volume lacks its file, and no animated one is selected."""
    if not config.frames:
        return ()
    ranges, found = parse_frames(config.frames), set[float]()
    animated = [volume for volume in selected.volumes if volume.animated]
    there = {frame.time_code for volume in animated for frame in volume.frames}
    for volume in whole.volumes:
        codes, _ = select_frames(ranges, volume.time_codes) if volume.animated else ((), ())
        for code in set(codes) - there:
            try:
                compose_one(stage, whole, volume, code)
            except AssetNotResolved:
                found.add(code)
    return tuple(sorted(found))


def _is_volume(stage: Usd.Stage, path: str) -> bool:
    prim = stage.GetPrimAtPath(path) if Sdf.Path.IsValidPathString(path) else None
    return not prim or bool(prim.IsA(UsdVol.Volume))  # find_volumes refuses what is not there


def _find(stage: Usd.Stage, config: StageConfig, problems: list[str] | None = None) -> StageSource:
    """Ignores the Volumes' requests: an invalid request hides no smoke."""
    return find_volumes(stage, config, with_requests=False, problems=problems, with_instances=True)
