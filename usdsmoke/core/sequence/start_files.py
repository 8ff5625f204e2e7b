"""What frames start from, as files: starts of the coarse step, and checkpoints of windows.

Both are .npz and come back bit for bit. The checksums of the format tell damage.
"""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.potential import Displacement
from usdsmoke.core.sequence.start import Carried, CoarseStart
from usdsmoke.core.sequence.steadiness import Clouds
from usdsmoke.core.smoke.active import ActiveSmoke

_CLOUDS = ("positions", "values", "inside", "mass", "weights")

_Read = TypeVar("_Read")


def save_start(start: CoarseStart, file_path: Path) -> None:
    """Write a start; ``load_start`` and ``load_carried`` give it back bit for bit."""
    arrays: dict[str, Any] = {"time_code": start.time_code, "factor": start.factor}
    if start.displacement is not None:
        arrays |= _displacement_arrays(start.displacement)
    if start.smoke is not None and start.colours is not None:
        arrays["ijk"] = start.smoke.ijk.cpu().numpy()
        arrays["density"] = start.smoke.density.cpu().numpy()
        arrays["smoke_to_stage"] = start.smoke.index_to_stage
        arrays["colours"] = start.colours.cpu().numpy()
    if (carried := start.carried) is not None:
        arrays["carried"] = True
        if carried.unclamped is not None:  # on the same box
            arrays["carried_displacement"] = carried.unclamped.values.cpu().numpy()
        if carried.colours is not None:
            arrays["carried_colours"] = carried.colours.cpu().numpy()
    _save(arrays, file_path)


def load_start(file_path: Path) -> CoarseStart:
    """Read what ``save_start`` wrote, except ``carried``; on the CPU.

    Raises:
        OSError, ValueError, KeyError: it is missing, damaged or of another kind.
    """

    def read(arrays: Any) -> CoarseStart:
        smoke = colours = None
        if "ijk" in arrays:
            smoke = ActiveSmoke(
                torch.from_numpy(arrays["ijk"]),
                torch.from_numpy(arrays["density"]),
                arrays["smoke_to_stage"],
            )
            colours = torch.from_numpy(arrays["colours"])
        displacement = _displacement_of(arrays)
        code, factor = float(arrays["time_code"]), int(arrays["factor"])
        return CoarseStart(code, factor, displacement, smoke, colours)

    return _load(file_path, read)


def load_carried(file_path: Path) -> Carried | None:
    """The ``carried`` of what ``save_start`` wrote.

    Raises:
        OSError, ValueError, KeyError: see ``load_start``.
    """
    start = load_start(file_path)

    def read(arrays: Any) -> Carried | None:
        if "carried" not in arrays:
            return None
        unclamped = colours = None
        if "carried_displacement" in arrays and start.displacement is not None:
            values = torch.from_numpy(arrays["carried_displacement"])
            unclamped = Displacement(values, start.displacement.lattice)
        if "carried_colours" in arrays:
            colours = torch.from_numpy(arrays["carried_colours"])
        return Carried(start.time_code, unclamped, colours)

    return _load(file_path, read)


def save_checkpoint(carried: Carried, text: str, file_path: Path) -> None:
    """Write what a window goes on with behind a frame, and a text; see ``load_checkpoint``."""
    arrays: dict[str, Any] = {"time_code": carried.time_code, "text": text}
    if carried.unclamped is not None:
        arrays |= _displacement_arrays(carried.unclamped)
    if carried.colours is not None:
        arrays["colours"] = carried.colours.cpu().numpy()
    arrays["clouds"] = [len(kind) for kind in carried.clouds]
    for kind, many in enumerate(carried.clouds):
        for number, clouds in enumerate(many):
            name = f"clouds_{kind}_{number}"
            arrays[name] = [clouds.floor, clouds.age]
            for part in _CLOUDS:
                arrays[f"{name}_{part}"] = getattr(clouds, part).cpu().numpy()
    _save(arrays, file_path)


def load_checkpoint(file_path: Path) -> tuple[Carried, str]:
    """What ``save_checkpoint`` wrote.

    Raises:
        OSError, ValueError, KeyError: see ``load_start``.
    """

    def read(arrays: Any) -> tuple[Carried, str]:
        colours = torch.from_numpy(arrays["colours"]) if "colours" in arrays else None
        clouds = tuple(
            tuple(_clouds_of(arrays, f"clouds_{kind}_{number}") for number in range(n))
            for kind, n in enumerate(arrays["clouds"])
        )
        unclamped, code = _displacement_of(arrays), float(arrays["time_code"])
        return Carried(code, unclamped, colours, clouds), str(arrays["text"])

    return _load(file_path, read)


def _clouds_of(arrays: Any, name: str) -> Clouds:
    parts: dict[str, Tensor] = {
        part: torch.from_numpy(arrays[f"{name}_{part}"]) for part in _CLOUDS
    }
    floor, age = arrays[name]
    return Clouds(**parts, floor=float(floor), age=int(age))


def _displacement_arrays(displacement: Displacement) -> dict[str, np.ndarray]:
    return {
        "displacement": displacement.values.cpu().numpy(),
        "displacement_low": displacement.lattice.low,
        "displacement_to_stage": displacement.lattice.index_to_stage,
    }


def _displacement_of(arrays: Any) -> Displacement | None:
    if "displacement" not in arrays:
        return None
    values = torch.from_numpy(arrays["displacement"])
    i, j, k = values.shape[:3]
    lattice = Lattice(arrays["displacement_low"], (i, j, k), arrays["displacement_to_stage"])
    return Displacement(values, lattice)


def _save(arrays: dict[str, Any], file_path: Path) -> None:
    # savez would add .npz to a temporary name, and leave an archive open behind an error
    with zipfile.ZipFile(file_path, "w") as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.asanyarray(values), allow_pickle=False)


def _load(file_path: Path, read: Callable[[Any], _Read]) -> _Read:
    """What ``read`` makes of a file's arrays; a damaged one raises ValueError."""
    try:
        with open(file_path, "rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            return read(arrays)
    except (zipfile.BadZipFile, EOFError) as error:
        raise ValueError(f"{file_path} is damaged: {error}") from error
