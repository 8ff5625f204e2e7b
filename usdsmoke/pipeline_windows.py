"""The work itself: every frame checked, every window stylized, every frame written."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from usdsmoke.grids.content_hash import hash_fields
from usdsmoke.pipeline_frames import FrameReader
from usdsmoke.pipeline_inputs import Job
from usdsmoke.pipeline_outputs import write_result
from usdsmoke.pipeline_pictures import sample_frames
from usdsmoke.plan import FramePlan, Plan, VolumePlan
from usdsmoke.run_folder import RunFolder
from usdsmoke.run_progress import RunProgress, RunProgressCallback, WorkMeter

if TYPE_CHECKING:
    from usdsmoke.core.progress import Progress
    from usdsmoke.core.scene import Scene

__all__ = ["check_frames", "measure_volume", "stylize_windows"]


def _windows_to_do(
    plan: Plan, run: RunFolder
) -> list[tuple[int, VolumePlan, tuple[FramePlan, ...]]]:
    """Volume number, Volume and frames of every window that is not finished.

    A window with one unfinished frame is done again as a whole, because each frame starts from its
    neighbour: so a run that was stopped gives the same bits as one that was not.
    """
    to_do = []
    for number, volume in enumerate(plan.volumes):
        frames = {frame.source.time_code: frame for frame in volume.frames}
        for window in volume.windows:
            members = tuple(frames[time_code] for time_code in window.time_codes)
            if any(run.finished(frame.file_name) is None for frame in members):
                to_do.append((number, volume, members))
    return to_do


def check_frames(
    reader: FrameReader, plan: Plan, run: RunFolder, tell: RunProgressCallback
) -> dict[str, dict[str, str]]:
    """Read every frame once, so that damage and NaN show before an hour of work, not after it.

    Returns:
        By the result's file name the content hashes of what decides the frame: ``density``, and
        ``mask`` where there is one.

    Raises:
        GridError, NonFiniteError: see ``FrameReader.read``.
    """
    to_do = [
        (volume, frame) for _, volume, members in _windows_to_do(plan, run) for frame in members
    ]
    hashes = {}
    for number, (volume, frame) in enumerate(to_do):
        tell(RunProgress("check", frame.source.time_code, number, len(to_do), 0.0))
        read = reader.read(volume, frame)
        hashes[frame.file_name] = {"density": hash_fields([read.density])}
        if read.mask is not None:
            hashes[frame.file_name]["mask"] = hash_fields([read.mask])
    return hashes


def measure_volume(reader: FrameReader, plan: Plan, volume: VolumePlan) -> "Scene":
    """Extinction and picture size, from up to three frames of the whole sequence.

    Raises:
        GridError, NonFiniteError: see ``FrameReader.read``.
    """
    from usdsmoke.core.scene import measure_scene

    frames = [reader.read(volume, frame) for frame in sample_frames(volume)]
    return measure_scene(frames, plan.config, plan.source.up_axis)


def stylize_windows(
    job: Job,
    run: RunFolder,
    reader: FrameReader,
    scenes: Sequence["Scene"],
    source_hashes: Mapping[str, Mapping[str, str]],
    tell: RunProgressCallback,
) -> float:
    """Stylize every unfinished window and write its frames.

    Args:
        job: what was asked for.
        run: where frames go, and which are finished.
        reader: of the source's frames.
        scenes: one for each Volume, from ``measure_volume``.
        source_hashes: from ``check_frames``.
        tell: hears of every iteration and every file.

    Returns:
        Seconds that it took.

    Raises:
        UsdSmokeError: whatever the core or the writing of files raises.
    """
    from usdsmoke.core.stylize import stylize_window

    plan, started = job.plan, time.monotonic()
    to_do = _windows_to_do(plan, run)
    warm = [bool(place) for _, _, members in to_do for place, _ in enumerate(members)]
    meter, done = WorkMeter(plan.config, warm), 0
    for number, volume, members in to_do:
        results = stylize_window(
            (reader.read(volume, frame) for frame in members),
            [style.pixels for style in job.styles],
            scenes[number],
            plan.config,
            _translate(meter, done, len(warm), tell),
            plan.source.time_codes_per_second,
        )
        for frame, stylized in zip(members, results, strict=True):
            share = meter.share_before(done + 1)
            tell(RunProgress("write", frame.source.time_code, done, len(warm), share))
            hashes = source_hashes[frame.file_name]
            write_result(run, volume, frame, stylized, plan.config, hashes)
            done += 1
    return time.monotonic() - started


def _translate(
    meter: WorkMeter, first: int, n_frames: int, tell: RunProgressCallback
) -> Callable[["Progress"], None]:
    """The core counts frames within a window; the run counts all of them."""

    def report(state: "Progress") -> None:
        frame = first + state.frame
        tell(
            RunProgress(
                step=state.step,
                time_code=state.time_code,
                frame=frame,
                n_frames=n_frames,
                share=meter.share(state, frame),
                octave=state.octave,
                n_octaves=state.n_octaves,
                loss=state.loss,
            )
        )

    return report
