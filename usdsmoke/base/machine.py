"""The machine of a run: its processors, memory, disk, packages, and torch's environment variables.

It loads nothing heavy: no torch, USD or OpenVDB.
"""

import ctypes
import gc
import importlib.util
import math
import os
import platform
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from usdsmoke.base.errors import MissingPackage

GIB = 2**30
MOST_THREADS = 4

_DEVICES = Path("/dev")
_PROCESSES = Path("/proc")
_CONTROL_GROUPS = Path("/sys/fs/cgroup")
_PACKAGES = ("usd-core", "torch", "numpy")
_INSTALL = {  # module: what to do if it is missing
    "numpy": "pip install numpy",
    "yaml": "pip install pyyaml",
    "pydantic": "pip install pydantic",
    "rich": "pip install rich",
    "pxr": "pip install usd-core",
    "torch": "pip install torch",
    "PIL": "pip install pillow",
    "OpenEXR": "pip install OpenEXR",
    "av": "pip install av",
    "matplotlib": "pip install matplotlib jinja2",
    "jinja2": "pip install matplotlib jinja2",
    "distributed": "pip install distributed",
    "prov": "pip install prov",
    "mitsuba": "pip install mitsuba",
}


_most_cpus = 2**31  # see ``limit_cpus``


def limit_cpus(n: int) -> None:
    """Let this process use at most n processors: others compute beside it."""
    global _most_cpus
    _most_cpus = n


def usable_cpus() -> int:
    """Processors that this process may use."""
    there = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        there = len(os.sched_getaffinity(0))
    return max(1, min(there, _most_cpus))


def usable_threads() -> int:
    """Threads of a process that is not told how many: its processors, up to ``MOST_THREADS``.

    They wait for each other, and more take longer (decision 028).
    """
    return min(usable_cpus(), MOST_THREADS)


def available_memory_gib() -> float:
    """Available memory, GiB: the machine's or that of a control group, whichever is least.

    Counted are the process's own group and those above it, of either version of control groups.
    Files that the system keeps in memory, and that were not used lately, do not count as used: it
    gives them up. Infinite if the system does not report it.
    """
    candidates = [math.inf]
    for line in _lines(_PROCESSES / "meminfo"):
        if line.startswith("MemAvailable:"):
            candidates.append(float(line.split()[1]) * 1024)
    for folder, names in _control_groups():
        limit, used = (_number(folder / name) for name in names)
        if limit is not None and used is not None:
            kept = dict(line.split() for line in _lines(folder / "memory.stat") if " " in line)
            given_up = float(kept.get("total_inactive_file", kept.get("inactive_file", 0)))
            candidates.append(max(limit - used + given_up, 0.0))
    return min(candidates) / GIB


def _control_groups() -> Iterator[tuple[Path, tuple[str, str]]]:
    """The folders that limit this process's memory, with the names of the limit and of the use."""
    v1, v2 = ("memory.limit_in_bytes", "memory.usage_in_bytes"), ("memory.max", "memory.current")
    for line in _lines(_PROCESSES / "self/cgroup"):
        _, controllers, own = line.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        root = _CONTROL_GROUPS / "memory" if controllers else _CONTROL_GROUPS
        group = root / own.lstrip("/")
        for folder in (group, *group.parents):
            if folder.is_relative_to(root):
                yield folder, v1 if controllers else v2


def _number(file_path: Path) -> float | None:
    """The number in a file; None if there is none, such as ``max``."""
    try:
        return float(_lines(file_path)[0])
    except (IndexError, ValueError):
        return None


def free_disk_bytes(folder: Path) -> int:
    """Free bytes on the disk that ``folder`` is on, or will be on once it is made."""
    folder = Path(folder).absolute()
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free


def _lines(file_path: Path) -> list[str]:
    try:
        return file_path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []


def process_seconds() -> float:
    """Since this process began, to a hundredth; 0 where the system does not tell."""
    try:
        began = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        now = float(Path("/proc/uptime").read_text().split()[0])
        return max(now - began / os.sysconf("SC_CLK_TCK"), 0.0)
    except (OSError, ValueError, IndexError):
        return 0.0


def give_back_memory() -> None:
    """Return free memory that the C library keeps to the system, if the library can.

    Fields of many sizes leave gaps between them. Without this a shot of 72 frames peaked a tenth
    above one of 24 (benchmarks/window_cost.py). It takes about two milliseconds: call it between
    frames, and before work that takes seconds.
    """
    trim = _find_trim()
    if trim is not None:
        trim(0)


@contextmanager
def no_garbage_collection() -> Iterator[None]:
    """Python frees no objects that refer to each other meanwhile."""
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()


@lru_cache(maxsize=1)
def _find_trim() -> Any | None:
    """``malloc_trim`` of the GNU C library; None with any other one."""
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):
        return None


def package_versions() -> dict[str, str]:
    """Versions of Python and of the packages that a result depends on, except OpenVDB's."""
    from importlib.metadata import PackageNotFoundError, version

    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # a USD or torch of another origin, without a wheel's record
            versions[name] = "unknown"
    return versions


def seems_to_have_gpu() -> bool:
    """Whether torch, which takes seconds to load, may find a GPU."""
    nodes = ("nvidia[0-9]*", "dxg", "kfd")
    version = package_versions().get("torch", "")
    return not version.endswith("+cpu") and any(list(_DEVICES.glob(node)) for node in nodes)


def platform_name() -> str:
    """System and processor family, such as ``Linux x86_64``; no name of the machine."""
    return f"{platform.system()} {platform.machine()}"


def prepare_numpy_environment() -> None:
    """One thread for NumPy's matrices, unless the user has set another number.

    Its threads spin after each product, which takes a tenth of the processor time from the threads
    that share a run's work. To be called before NumPy is loaded.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def prepare_torch_environment() -> None:
    """Set variables that torch reads when it is imported; a user's own values stay."""
    # Threads that spin while they wait slow each other down on shared processors.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    # Every picture size adds its convolutions to a cache. A frame's octaves have up to a thousand;
    # more would make it grow with the shot.
    os.environ.setdefault("ONEDNN_PRIMITIVE_CACHE_CAPACITY", "1024")


def python_command(code: str) -> list[str]:
    """The command that runs one line of Python code with this interpreter.

    Modules in the current folder are not imported, as with ``python -P``, which Python 3.10 lacks.
    """
    folder_left_out = "import sys; sys.path[:] = [entry for entry in sys.path if entry]; "
    return [sys.executable, "-c", folder_left_out + code]


def check_packages(*modules: str) -> None:
    """Check that the packages that the work needs later are installed.

    Args:
        modules: names of modules; nothing is imported.

    Raises:
        MissingPackage: one is not installed.
    """
    for name in modules:
        try:
            found = name in sys.modules or importlib.util.find_spec(name) is not None
        except ValueError:  # a module that was loaded without a spec
            found = True
        if not found or sys.modules.get(name, name) is None:
            raise missing_package(name)


def missing_package(name: str | None) -> MissingPackage:
    """The error for a module that cannot be found.

    Args:
        name: of the module, as ``ModuleNotFoundError.name``.
    """
    top = (name or "a module").partition(".")[0]
    advice = _INSTALL.get(top, f"pip install {top}")
    return MissingPackage(f"the Python package {top} is not installed. Run: {advice}")
