"""Finished frames under the paths that ``layer.files`` gives them in the output folder.

The files stay in the folder of their run too, as hard links where the file system has them: there
they are looked for when frames are done again. A path that stays the same from one result to the
next is replaced when the later result is assembled.
"""

import os
from pathlib import Path, PurePosixPath

from usdsmoke.base.errors import LayerError, UsdSmokeError
from usdsmoke.base.publish import share_file
from usdsmoke.planning.job import Job
from usdsmoke.planning.make_plan import result_file_names
from usdsmoke.planning.plan import FramePlan, Plan, VolumePlan
from usdsmoke.runs.run import Run, find_runs
from usdsmoke.usd.look import check_root_file, published_runs
from usdsmoke.vdb.header import read_header


def result_file(run: Run, volume: VolumePlan, frame: FramePlan) -> Path:
    """The file of a frame that layers and records name."""
    return (run.output if volume.places else run.folder) / volume.file_of(frame)


def empty_names(volume: VolumePlan) -> tuple[str, str]:
    """The file without a voxel that colours show where the source is shown: its name in the run's
    folder, and its path in the output folder ("": it stays in the run's).

    Where the first timeCode is not stylized, it has that one's number: Blender counts files from
    the first one. Elsewhere a number would pass for a frame. Both are empty where all is stylized.
    """
    stylized = {frame.source.time_code for frame in volume.frames}
    codes = volume.source.time_codes
    if all(code in stylized for code in codes):
        return "", ""
    if codes[0] not in stylized:
        names = result_file_names(volume.source, volume.stem)
        return names[codes[0]], volume.places.get(codes[0], "")
    name = f"{volume.stem}.empty.vdb"
    place = volume.places.get(codes[0], "")
    return name, str(PurePosixPath(place).with_name(name)) if place else ""


def check_targets(job: Job) -> None:
    """Refuse to overwrite what belongs to other looks, to other stages or to other programs.

    Raises:
        LayerError: with the file and whose it is.
    """
    check_delivery(job.plan, job.output)
    check_root_file(job.targets, job.config.layer.mode, Path(job.plan.source.file_path))
    _check_sheets(job)


def _check_sheets(job: Job) -> None:
    """Refuse to overwrite a picture that no run has put in the place of a contact sheet."""
    runs = list(find_runs(job.output))
    if not runs and published_runs(job.targets.look_layer):
        return  # whose record is lost
    # An unfinished run may have written a sheet, and has not told yet.
    known = {name for run in runs for name in run.files}
    unfinished = any(not run.complete for run in runs)
    for sheet in job.sheets:
        is_known = unfinished or os.path.relpath(sheet, job.output) in known
        if sheet.exists() and not is_known:
            raise LayerError(
                f"{sheet} does not belong to a result in {job.output}, and would be overwritten. "
                "Move it away, or set layer.contact_sheet=0."
            )


def check_delivery(plan: Plan, output: Path) -> None:
    """Refuse paths that hold files of other looks, or no files of usdsmoke.

    Raises:
        LayerError: with the file and whose it is.
    """
    looks: dict[str, str] = {}  # by run and by file
    if any(volume.places for volume in plan.volumes):
        for run in find_runs(output):
            looks |= dict.fromkeys((run.run_id, *run.grown_from, *run.files), run.look)
    ours = plan.config.layer.look
    places = [place for volume in plan.volumes for place in volume.places.values()]
    places += [empty_names(volume)[1] for volume in plan.volumes]
    for place in filter(None, places):
        if not (output / place).exists():
            continue
        look = looks.get(_run_of(output / place)) or looks.get(place)
        if look is None:
            raise LayerError(
                f"{output / place} does not belong to a result in {output}, and would be "
                "overwritten. Move it away, or change layer.files."
            )
        if look != ours:
            raise LayerError(
                f"{output / place} belongs to the look {look}, and the look {ours} would overwrite "
                "it. Put {look} into layer.files."
            )


def deliver_frames(run: Run, plan: Plan) -> list[Path]:
    """Give the files of a run, finished and checked, their paths; these.

    Raises:
        LayerError: see ``check_delivery``.
        WriteFailed: the operating system refused.
    """
    check_delivery(plan, run.output)
    delivered = []
    for volume in plan.volumes:
        placed = [(frame.file_name, volume.file_of(frame)) for frame in volume.frames]
        for name, place in (*placed, empty_names(volume)) if volume.places else ():
            if (run.folder / name).is_file() and place:
                share_file(run.folder / name, run.output / place)
                delivered.append(run.output / place)
    return delivered


def _run_of(file_path: Path) -> str:
    """The id of the run that has written a file; "" for other programs' files."""
    try:
        return str(read_header(file_path).metadata.get("usdsmoke:run", ""))
    except UsdSmokeError:
        return ""
