"""The process that touches files through OpenVDB, OpenEXR and OpenUSD; started by
``usdsmoke.vdb.child``.

``python -m usdsmoke.vdb.worker`` reads the name of a folder from stdin, a JSON text on a line. It
answers the ``request.json`` there with ``answer.json`` and arrays beside it. Then it prints
``next`` when it waits for another folder, ``end`` when it ends itself, or ``full`` when it ends
because the answer could not be written.

The parent checks the file's header before a request, and the result after it. No state is carried
from one request to the next: a worker ends after a refused request, and when its memory has grown.
"""

import importlib
import json
import os
import resource
import shutil
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from usdsmoke.base.errors import UsdSmokeError, WriteFailed
from usdsmoke.base.machine import give_back_memory
from usdsmoke.vdb.binding import binding_version, find_binding
from usdsmoke.vdb.boxes import LEAST_VOXEL, check_dense_size

# What the bindings raise on files and values they cannot take, over all versions.
_BINDING_ERRORS = (ArithmeticError, KeyError, OSError, RuntimeError, TypeError, ValueError)
LEAF = 8  # voxels along the side of a leaf node
_GROWTH = 2**28  # bytes of address space beyond the first answer's that end a worker


def main() -> int:
    """Answer requests until one is refused, or the parent ends."""
    answers = os.dup(1)
    os.dup2(2, 1)  # OpenVDB's output must not be mistaken for an answer
    first, folder = 0, ""
    for line in sys.stdin:
        folder = json.loads(line)
        grown = max(0, _address_space() - first) if first else 0
        try:
            answered = answer_request(Path(folder), grown)
        except OSError:  # not even the answer could be written
            os.write(answers, b"full\n")
            return 0
        give_back_memory()
        first = first or _address_space()
        goes_on = answered and _address_space() - first <= _GROWTH
        os.write(answers, b"next\n" if goes_on else b"end\n")
        if not goes_on:
            return 0
    if folder:  # it is gone, unless the parent was killed
        shutil.rmtree(folder, ignore_errors=True)
    return 0


class _NotHandedOver(Exception):
    """The folder for temporary files is full, or may not be written to."""


def answer_request(folder: Path, grown: int = 0) -> bool:
    """Answer the request in a folder; True if it was fulfilled.

    Args:
        folder: with ``request.json`` and arrays ``in0.npy`` and so on.
        grown: bytes of address space that earlier requests still occupy. They are not part of this
            request's limit.
    """
    request = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    _set_limits(request["memory_limit_bytes"] + grown, request["cpu_limit_s"])
    answer: dict[str, Any]
    try:
        content, n_arrays = find_action(request["action"])(request, folder)
        answer = {"answer": content, "n_arrays": n_arrays}
    except UsdSmokeError as error:
        answer = {"error": type(error).__name__, "message": str(error)}
    except _NotHandedOver as error:
        answer = {"not_handed_over": str(error)}
    except MemoryError:
        limit = request["memory_limit_bytes"] / 2**30
        failure = f"it needs more than {limit:g} GiB of memory"
        answer = {"failure": failure, "lacks_memory": True}
    except _BINDING_ERRORS as error:
        text = " ".join(str(error).split()) or type(error).__name__
        answer = {"failure": f"{request.get('reader', 'OpenVDB')} says: {text}"}
    (folder / "answer.json").write_text(json.dumps(answer), encoding="utf-8")
    return "answer" in answer


def _set_limits(n_bytes: int, cpu_seconds: float) -> None:
    """Limit address space, and processor time from now on; leave no core file after a crash.

    A timer ends the process when its time is used up. ``RLIMIT_CPU`` is measured from the start of
    the process, in whole seconds of a clock that drifts from those that a program can read.
    """
    signal.setitimer(signal.ITIMER_PROF, cpu_seconds)
    for kind, limit in ((resource.RLIMIT_AS, n_bytes), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(kind)[1]
        soft = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        try:
            resource.setrlimit(kind, (soft, hard))
        except (OSError, ValueError):  # a system that knows the limit but does not set it
            continue


def _address_space() -> int:
    """Bytes that this process has reserved; 0 if the system does not report it."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def _describe(request: Mapping[str, Any], folder: Path) -> tuple[Any, int]:
    """Name and version of the bindings."""
    return binding_version(), 0


def _read(request: Mapping[str, Any], folder: Path) -> tuple[Any, int]:
    """The active boxes of the grids called ``request["names"]``, in that order."""
    binding = find_binding()
    grids = []
    for n, name in enumerate(request["names"]):
        grid = binding.read(request["file_path"], name)
        ijk_min, ijk_max = grid.evalActiveVoxelBoundingBox()
        is_vector = isinstance(grid.background, (tuple, list))
        shape = [max(0, int(b) - int(a) + 1) for a, b in zip(ijk_min, ijk_max, strict=True)]
        if 0 in shape:  # an empty grid's box runs from the largest integer to the smallest
            shape, ijk_min = [0, 0, 0], (0, 0, 0)
        components, limit = 3 if is_vector else 1, request["dense_limit_bytes"]
        check_dense_size(f'grid "{name}"', shape, components, limit)
        values = np.zeros([*shape, 3] if is_vector else shape, np.float32)
        if values.size:
            grid.copyToArray(values, ijk=tuple(int(index) for index in ijk_min))
        _hand_over(values, folder / f"out{n}.npy")
        described = {"ijk_min": [int(i) for i in ijk_min], "background": grid.background}
        if values.size and not is_vector:
            described["beside"] = _largest_beside(grid, described["ijk_min"], shape)
        grids.append(described)
    return grids, len(grids)


def _hand_over(values: np.ndarray, file_path: Path) -> None:
    try:
        np.save(file_path, values, allow_pickle=False)
    except OSError as error:  # not of the file that is read
        file_path.unlink(missing_ok=True)  # it takes the room that the answer needs
        raise _NotHandedOver(error.strerror or str(error)) from error


def _largest_beside(grid: Any, ijk_min: Sequence[int], shape: Sequence[int]) -> float:
    """The largest finite value, without its sign, within a leaf of a box, outside it.

    Active voxels are in the box, so these are inactive ones.
    """
    largest = 0.0
    for axis, length in enumerate(shape):
        # The axes before reach beyond the box, so edges and corners are in the slabs of one axis.
        low = [i - LEAF * (a < axis) for a, i in enumerate(ijk_min)]
        slab = [n + 2 * LEAF * (a < axis) for a, n in enumerate(shape)]
        slab[axis] = LEAF
        for start in (ijk_min[axis] - LEAF, ijk_min[axis] + length):
            low[axis] = start
            values = np.zeros(slab, np.float32)
            grid.copyToArray(values, ijk=tuple(low))
            found = np.abs(values[np.isfinite(values)])
            largest = max(largest, float(found.max(initial=0.0)))
    return largest


def _write(request: Mapping[str, Any], folder: Path) -> tuple[Any, int]:
    """Write all grids of one file; the parent checks the file."""
    binding = find_binding()
    grids = [
        _build_grid(binding, described, np.load(folder / f"in{n}.npy", allow_pickle=False))
        for n, described in enumerate(request["grids"])
    ]
    binding.write(request["file_path"], grids=grids, metadata=request["file_metadata"])
    return None, 0


def _build_grid(binding: Any, described: Mapping[str, Any], values: np.ndarray) -> Any:
    """A grid whose active voxels are those that differ from the background."""
    if described["is_vector"]:
        grid = binding.Vec3SGrid(tuple(described["background"]))
    else:
        grid = binding.FloatGrid(described["background"])
    if values.size:
        tolerance = (0.0, 0.0, 0.0) if described["is_vector"] else 0.0
        ijk_min = tuple(int(index) for index in described["ijk_min"])
        grid.copyFromArray(np.ascontiguousarray(values), ijk=ijk_min, tolerance=tolerance)
    for key, value in described["metadata"].items():
        grid[key] = tuple(value) if isinstance(value, list) else value
    grid.name = described["name"]
    grid.gridClass = described["grid_class"]
    grid.vectorType = described["vector_type"]
    grid.saveFloatAsHalf = described["half"]
    grid.transform = _build_transform(binding, described["index_to_world"])
    return grid


def _build_transform(binding: Any, index_to_world: list[list[float]]) -> Any:
    """A transform that stores the matrix exactly.

    Made from the whole matrix, OpenVDB takes a scale out of it as (s + t) - t, which rounds; so the
    translation is added afterwards. The method that adds it in world space changed its name.
    """
    size = abs(float(np.linalg.det(np.array(index_to_world)[:3, :3])))
    if size < LEAST_VOXEL:
        raise WriteFailed(
            f"OpenVDB stores no voxels as small as these (volume {size:.2g}, at least "
            f"{LEAST_VOXEL:g}). Scale the grid up, and its Volume down on the stage. If "
            "grids.refine is set, lower it."
        )
    linear = [[*row[:3], 0.0] for row in index_to_world[:3]] + [[0.0, 0.0, 0.0, 1.0]]
    transform = binding.createLinearTransform(linear)
    add_translation = getattr(transform, "postTranslate", None) or transform.translate
    add_translation(tuple(index_to_world[3][:3]))
    return transform


def find_action(name: str) -> Callable[[Mapping[str, Any], Path], tuple[Any, int]]:
    """One of the functions above, or for ``package.module:function`` another package's."""
    module, _, function = name.partition(":")
    if not function:
        return _ACTIONS[name]
    found: Callable[[Mapping[str, Any], Path], tuple[Any, int]]
    found = getattr(importlib.import_module(module), function)
    return found


_ACTIONS = {"describe": _describe, "read": _read, "write": _write}


if __name__ == "__main__":
    sys.exit(main())
