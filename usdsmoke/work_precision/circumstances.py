"""The scene, the machine and the versions that a report was made with."""

import datetime
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from usdsmoke import __version__
from usdsmoke.base.machine import package_versions
from usdsmoke.base.time_codes import format_time_code, format_time_codes
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.records import Figures

__all__ = ["machine_figures", "processor_name", "scene_figures", "version_figures"]


def scene_figures(case: Case) -> Figures:
    """What was looked at."""
    source, volume = case.job.plan.source, case.volume
    low, high = case.smoke.box
    small_low, small_high = case.small_smoke.box
    codes = [frame.source.time_code for frame in volume.frames]
    size = case.small_scene.image_size
    rows = [
        ("stage", Path(source.file_path).name),
        ("Volume", volume.source.prim_path),
        ("timeCodes", f"{format_time_codes(codes)} ({len(codes)} frames)"),
        ("frame that was measured", f"timeCode {format_time_code(case.frame.time_code)}"),
        ("its smoke", _smoke_text(high - low + 1, len(case.smoke.ijk))),
        ("its pictures", f"{case.scene.image_size} pixels, extinction {case.scene.gamma_w:.4g} per "
                         "density and stage unit"),
        ("small copy, for trials", _smoke_text(small_high - small_low + 1,
                                               len(case.small_smoke.ijk))
                                   + f"; pictures of {size} pixels"),
        ("steps", ", ".join(case.steps)),
        ("network", case.config.features.network),
        ("styles", ", ".join(case.job.styles[n].name for n in volume.styles)),
    ]  # fmt: skip
    return Figures("Scene", tuple(rows))


def machine_figures(case: Case, seconds: float) -> Figures:
    """Where and when; nothing that names the machine or its user."""
    import torch

    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    rows = [
        ("date", datetime.date.today().isoformat()),
        ("system", f"{platform.system()} {platform.machine()}"),
        (
            "processor",
            f"{processor_name()}, {cores} cores, {torch.get_num_threads()} threads in use",
        ),
        ("memory", f"{memory:.0f} GiB"),
        ("GPU", torch.cuda.get_device_name(case.device) if case.on_gpu else "none in use"),
        ("load", f"{os.getloadavg()[0]:.1f} at the end"),
        ("time taken", f"{seconds:.0f} s of {case.seconds:.0f} s"),
    ]
    return Figures("Machine", tuple(rows))


def version_figures() -> Figures:
    """Of this program and of what it depends on."""
    rows = [("usdsmoke", __version__), *package_versions().items()]
    try:
        rows.append(("matplotlib", version("matplotlib")))
    except PackageNotFoundError:
        pass
    return Figures("Versions", tuple(rows))


def _smoke_text(sides: object, n_voxels: int) -> str:
    return f"{' x '.join(str(int(n)) for n in sides)} voxels, {n_voxels:,} active"  # type: ignore[attr-defined]


def processor_name() -> str:
    """The processor's name where the system tells."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.processor() or "processor unknown"
    names = [line.split(":", 1)[1].strip() for line in text.splitlines() if "model name" in line]
    return names[0] if names else platform.processor() or "processor unknown"
