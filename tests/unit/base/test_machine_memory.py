"""How much memory a process may still take, under control groups of either version."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from usdsmoke.base import machine
from usdsmoke.base.machine import GIB, available_memory_gib


def system(
    folder: Path, monkeypatch: pytest.MonkeyPatch, groups: str, files: Mapping[str, str]
) -> None:
    """A machine with 64 GiB available, the groups of a process, and what is told of them."""
    texts = {"proc/meminfo": f"MemAvailable: {64 * 2**20} kB", "proc/self/cgroup": groups}
    for name, text in {**texts, **files}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.setattr(machine, "_PROCESSES", folder / "proc")
    monkeypatch.setattr(machine, "_CONTROL_GROUPS", folder / "groups")


V2 = ("memory.max", "memory.current")
V1 = ("memory.limit_in_bytes", "memory.usage_in_bytes")


@pytest.mark.parametrize(
    ("groups", "place", "names"),
    [
        ("0::/", "", V2),
        ("0::/slurm/job/step", "slurm/job", V2),
        ("0::/host/path/of/a/container", "", V2),
        ("4:memory:/slurm/job\n1:cpu:/slurm\n0::/", "memory/slurm/job", V1),
        ("4:cpu,memory:/docker/12ab\n", "memory", V1),
    ],
)
def test_the_least_of_all_groups_counts(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    groups: str,
    place: str,
    names: tuple[str, str],
) -> None:
    limit, used = (f"groups/{place}/{name}" for name in names)
    system(tmp_path, monkeypatch, groups, {limit: f"{8 * GIB}", used: f"{3 * GIB}\n"})
    assert available_memory_gib() == 5


def test_files_that_are_kept_in_memory_are_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After some VDB files were read, a container looks full."""
    limit, used, stat = (f"groups/{name}" for name in (*V2, "memory.stat"))
    files = {limit: f"{8 * GIB}", used: f"{7 * GIB}", stat: f"anon 1\ninactive_file {4 * GIB}\n"}
    system(tmp_path, monkeypatch, "0::/", files)
    assert available_memory_gib() == 5


@pytest.mark.parametrize("files", [{}, {"groups/memory.max": "max", "groups/memory.current": "5"}])
def test_without_a_limit_the_machine_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: Mapping[str, str]
) -> None:
    system(tmp_path, monkeypatch, "0::/", files)
    assert available_memory_gib() == 64
