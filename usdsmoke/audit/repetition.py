"""A result made again from its own record, and compared with the recorded content."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

from usdsmoke.audit.inputs import recorded_config, shown
from usdsmoke.audit.record import FoundRecord, find_records
from usdsmoke.audit.verification import verify_inputs
from usdsmoke.base.errors import LayerError, OutputExists, count_text
from usdsmoke.base.record_format import RunRecord
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.pipeline import (
    Request,
    StylizeResult,
    plan_with_notes,
    prepare,
    stylize_job,
)
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.progress import RunProgressCallback

_MOST_NAMED = 6  # changes or frames in a message


@dataclass(frozen=True)
class Rerun:
    """A result and what it is the repetition of."""

    result: StylizeResult
    record: Path  # the look layer, or a frame's file, that the run was repeated from
    n_frames: int  # recorded
    differences: tuple[str, ...]  # a sentence for every frame that is not as it was recorded

    def __str__(self) -> str:
        same = "as recorded" if not self.differences else f"{len(self.differences)} differ"
        opened = self.result.root_stage or self.result.look_layer
        head = f"{opened}: {count_text(self.n_frames, 'frame')}, {same}"
        return "\n".join((head, *self.differences[:_MOST_NAMED], *self.result.warnings))


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
        OutputExists: ``output`` holds the result itself, without ``force``.
        UsdSmokeError: see ``pipeline.stylize``.
    """
    item = _nearest(find_records(file))
    record = item.record
    if not record.stage:
        raise LayerError(
            f"{item.file} does not record the source stage. Give the look layer, or stylize again "
            "with 'usdsmoke stylize'."
        )
    if not force:
        _refuse_changes(item)
        if Path(os.path.realpath(output)) == Path(os.path.realpath(item.folder)):
            raise OutputExists(
                f"{output} holds the result that is to be repeated. Give another folder (-o)."
            )
    styles = [item.place(name) for name in record.style_request]
    config = recorded_config(item)
    job = prepare(Request(item.place(record.stage), styles, output, config, force))
    job = replace(job.refined_as(record.refinements), scenes=record.scenes)
    if planned is not None:
        planned(plan_with_notes(job))
    result = stylize_job(job, progress)
    (again,) = find_records(result.look_layer)
    frames = _frame_hashes(record)
    differences = _differences(frames, _frame_hashes(again.record))
    return Rerun(result, item.file, len(frames), differences)


def _nearest(found: list[FoundRecord]) -> FoundRecord:
    """The one record that is meant; looks that the source itself has are further away.

    Raises:
        LayerError: several are equally near.
    """
    nearest = [item for item in found if item.depth == found[0].depth]
    if len(nearest) > 1:
        files = ", ".join(str(item.file) for item in nearest)
        raise LayerError(f"there are several looks: {files}. Give the look layer of one of them.")
    return nearest[0]


def _refuse_changes(item: FoundRecord) -> None:
    changes = verify_inputs(item)
    if changes:
        named = "; ".join(
            f"{change.file}: expected {change.expected}, found {change.found}"
            for change in changes[:_MOST_NAMED]
        )
        more = f"; and {len(changes) - _MOST_NAMED} more" if len(changes) > _MOST_NAMED else ""
        force = ", or use --force (force=True in Python) to rerun with the changed inputs"
        force = "" if any(change.kind.endswith("-missing") for change in changes) else force
        raise LayerError(
            f"the inputs of {item.file} have changed: {named}{more}. Restore them{force}."
        )


def _frame_hashes(record: RunRecord) -> dict[tuple[str, float], str]:
    """Content hash by Volume and timeCode."""
    return {
        (frame.prim, frame.time_code): record.results.get(frame.file, "") for frame in record.frames
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
