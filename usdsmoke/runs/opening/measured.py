"""What frames share that a look gets later: what was measured of the shot as it was begun."""

from usdsmoke.base.errors import OutputExists, PlanError
from usdsmoke.planning.job import Job
from usdsmoke.planning.plan import Plan
from usdsmoke.runs.run import Run
from usdsmoke.runs.run_machine import with_changed, with_known_voxels


def check_measured(job: Job, before: Plan, run: Run) -> None:
    """Refuse to go on where nothing was measured that frames with smoke could share.

    Args:
        before: of the run.

    Raises:
        OutputExists: a Volume with smoke had none in the run, or was not in it.
    """
    scenes = {
        volume.source.prim_path: scene
        for volume, scene in zip(before.volumes, run.scenes, strict=True)
        if scene.get("thick") != 0
    }
    for volume in job.plan.volumes:
        if volume.filled and volume.source.prim_path not in scenes:
            raise OutputExists(
                f"the result in {run.output} has no frame with smoke of "
                f"<{volume.source.prim_path}>, so nothing was measured that its other frames could "
                "share. Begin it again with --force."
            )


def measured_as(job: Job, earlier: Run, codes: str) -> Job:
    """The job with the voxels of an earlier run, and measured on its frames.

    Args:
        codes: of the frames, as ``optics.frames`` takes them; "" for those that the job names.

    Raises:
        PlanError: this machine has too little memory for such voxels.
    """
    try:
        job = with_known_voxels(job, earlier.scenes)
    except PlanError as error:
        raise PlanError(
            f"{error} The look was begun with these voxels, and its frames have to agree. Begin "
            "it again with --force, or in another folder."
        ) from None
    return with_changed(
        job, lambda config: config.replace(optics=config.optics.replace(frames=codes))
    )
