"""A result made again from its own record, and compared with what it was."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from usdsmoke.audit.inputs import recorded_config, shown
from usdsmoke.audit.records import LookRecord, find_records
from usdsmoke.audit.verify import verify_inputs
from usdsmoke.base.errors import LayerError
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.pipeline import StylizeResult, stylize
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.progress import RunProgressCallback

__all__ = ["Rerun", "rerun"]

_MOST_NAMED = 6  # changes in a message


@dataclass(frozen=True)
class Rerun:
    """A result and what it is the repetition of."""

    result: StylizeResult
    record: Path  # the look layer, or a frame's file, that the run was repeated from
    n_frames: int  # recorded
    differences: tuple[str, ...]  # a sentence for every frame that is not as it was recorded


def rerun(
    file: str | PathLike[str],
    output: str | PathLike[str],
    force: bool = False,
    progress: RunProgressCallback | None = None,
    planned: Callable[[Plan], None] | None = None,
) -> Rerun:
    """Make a result again with the stage, the images and the settings that its record names.

    On the machine it was made on, with the same versions, the content hashes are the same; other
    processors and versions may round otherwise.

    Args:
        file: a look layer, or a stage, asset, VDB file or folder that leads to one.
        output: the folder of the repetition.
        force: go on though inputs have changed, and replace a result in ``output``.
        progress: called often, with how far the run is.
        planned: called once with the plan.

    Raises:
        LayerError: there is no record, more than one, or one without paths; or inputs have changed
            (named), without ``force``.
        ConfigError: this version of usdsmoke knows other settings.
        UsdSmokeError: see ``pipeline.stylize``.
    """
    record = _nearest(find_records(file))
    request = record.request()
    if not request:
        raise LayerError(
            f"the record in {record.file} does not say what the run was begun with; give its look "
            "layer, or stylize again with 'usdsmoke stylize'"
        )
    if not force:
        _refuse_changes(record)
    config = recorded_config(record)
    # what a tolerance came to stands in the record, and is not chosen again
    config = config.replace(optimize=config.optimize.replace(target_error=None))
    result = stylize(
        _place(record, request["stage"]),
        [_place(record, name) for name in request["styles"]],
        output,
        config,
        force=force,
        progress=progress,
        planned=planned,
    )
    (again,) = find_records(result.look_layer)
    frames = _frame_hashes(record)
    return Rerun(result, record.file, len(frames), _differences(frames, _frame_hashes(again)))


def _nearest(records: list[LookRecord]) -> LookRecord:
    """The one record that is meant; looks that the source itself has are further away.

    Raises:
        LayerError: several are equally near.
    """
    nearest = [record for record in records if record.depth == records[0].depth]
    if len(nearest) > 1:
        files = ", ".join(str(record.file) for record in nearest)
        raise LayerError(f"there are several looks: {files}; give the look layer of one of them")
    return nearest[0]


def _refuse_changes(record: LookRecord) -> None:
    changes = verify_inputs(record)
    if changes:
        named = "; ".join(
            f"{change.file}: expected {change.expected}, found {change.found}"
            for change in changes[:_MOST_NAMED]
        )
        more = f"; and {len(changes) - _MOST_NAMED} more" if len(changes) > _MOST_NAMED else ""
        raise LayerError(
            f"what the result of {record.file} was made from has changed: {named}{more}; bring it "
            "back, or make another result of it with --force"
        )


def _place(record: LookRecord, name: str) -> Path:
    return Path(os.path.normpath(record.folder / name))


def _frame_hashes(record: LookRecord) -> dict[tuple[str, float], str]:
    """Content hash by Volume and timeCode."""
    results = record.pairs("results")
    return {
        (frame["prim"], frame["timeCode"]): results.get(frame["file"], "")
        for frame in record.frames()
    }


def _differences(
    before: Mapping[tuple[str, float], str], after: Mapping[tuple[str, float], str]
) -> tuple[str, ...]:
    return tuple(
        f"<{prim}> at timeCode {format_time_code(code)}: recorded "
        f"{shown(before.get((prim, code), ''))}, now {shown(after.get((prim, code), ''))}"
        for prim, code in sorted({*before, *after})
        if before.get((prim, code)) != after.get((prim, code))
    )
