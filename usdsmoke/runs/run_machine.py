"""The machine that a run computes with: device and kind of processor.

Bits depend on both, and not on the number of threads. A run settles the device when it begins, and
every later task uses one of that kind. Another kind of processor cannot be made the same: each
manifest names the one that made it, and the result names those that differ.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from usdsmoke.base.machine import no_garbage_collection, platform_name
from usdsmoke.base.record_format import MachineRecord
from usdsmoke.base.time_codes import format_time_codes
from usdsmoke.config.settings import Config
from usdsmoke.planning.job import Job
from usdsmoke.runs.run import Run

if TYPE_CHECKING:
    from usdsmoke.core.smoke.device import Machine


def machine_of(job: Job) -> "Machine":
    """What this machine computes a job with.

    Raises:
        ConfigError: the device is not there.
    """
    with no_garbage_collection():  # torch makes 10^5 objects that stay: .6 s are spent on them
        from usdsmoke.core.smoke.device import describe_machine

    return describe_machine(job.config.optimize)


def with_settled(job: Job, run: Run) -> Job:
    """The job with what was left open as its run was begun: the device, measured frames, and how
    often voxels are divided."""
    job, settled = with_known_voxels(job, run.scenes or job.scenes), _optimize(run)
    measured = run.description.get("settings", {}).get("optics", {}).get("frames", "")

    def settle(config: Config) -> Config:
        device = config.optimize.device
        settled_device = settled.get("device", device)
        optimize = config.optimize.replace(
            # a device of the same kind may be another one of several GPUs
            device=device if device.partition(":")[0] == settled_device else settled_device,
        )
        optics = config.optics.replace(frames=config.optics.frames or measured)
        return config.replace(optimize=optimize, optics=optics)

    return with_changed(job, settle)


def with_changed(job: Job, change: Callable[[Config], Config]) -> Job:
    """The job with other settings of the run and its Volumes, which change nothing else planned."""
    volumes = tuple(replace(volume, config=change(volume.config)) for volume in job.plan.volumes)
    plan = replace(job.plan, config=change(job.plan.config), volumes=volumes)
    return replace(job, plan=plan)


def with_known_voxels(job: Job, scenes: Sequence[Mapping[str, Any]]) -> Job:
    """The job with voxels divided as when scenes were measured; as it is without scenes.

    Raises:
        PlanError: see ``Job.refined_as``.
    """
    pairs = zip(job.plan.volumes, scenes, strict=False)
    return job.refined_as({v.source.prim_path: s["refine"] for v, s in pairs if "refine" in s})


def processor_note(run: Run, here: str) -> tuple[str, ...]:
    """A sentence where this task runs on another kind of processor than the run was begun on."""
    if here == run.processor or not run.processor:
        return ()
    return (
        f"this is another kind of processor ({here}) than the run was begun on ({run.processor}): "
        "frames made here may differ in their last bits from those of one machine",
    )


def processor_warnings(run: Run) -> list[str]:
    """A sentence for every other kind of processor that a task of the run was done on."""
    return [
        f"{', '.join(named)} ran on another kind of processor ({kind}) than the run was begun on "
        f"({run.processor}): bits may differ from those of one machine"
        for kind, named in sorted(_others(run).items())
    ]


def machine_record(run: Run) -> MachineRecord:
    """For the record: device, processor, and what other kinds of processors made."""
    settled, others = _optimize(run), _others(run)
    return MachineRecord(
        platform=platform_name(),
        device=settled.get("device", ""),
        processor=run.processor,
        others={name: kind for kind in sorted(others) for name in others[kind]},
    )


def _others(run: Run) -> dict[str, list[str]]:
    """What was made on other kinds of processors, by kind: ``coarse step``, ``window 3``."""
    found: dict[str, list[str]] = {}
    windows: dict[str, list[int]] = {}
    for window, processor in run.made_on().items():
        if not processor or processor == run.processor or not run.processor:
            continue
        if window is None:
            found.setdefault(processor, []).append("coarse step")
        else:
            windows.setdefault(processor, []).append(window)
    for processor, numbers in windows.items():
        named = f"window{'s' if len(numbers) > 1 else ''} {format_time_codes(map(float, numbers))}"
        found.setdefault(processor, []).append(named)
    return found


def _optimize(run: Run) -> dict[str, Any]:
    return dict(run.description.get("settings", {}).get("optimize", {}))
