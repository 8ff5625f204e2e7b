"""The sweep over VDB files: 16-bit against 32-bit floats, and what pruning saves."""

import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from usdsmoke.base.boxes import values_in_box
from usdsmoke.base.volume import DenseField
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.vdb.write import write_frame
from usdsmoke.work_precision.case import Case
from usdsmoke.work_precision.engine import Sweep
from usdsmoke.work_precision.records import Plan, Task

_SHARES = (0.0, 1e-4, 1e-3, 1e-2, 1e-1)  # of the largest density


def _plan(case: Case) -> Plan:
    density = case.frame.density
    largest = float(density.values.max())
    prunes = sorted(
        {*(float(f"{share * largest:.2g}") for share in _SHARES), case.config.grids.prune}
    )
    fields = {prune: _fields(case, density, prune) for prune in prunes}
    exact = fields[0.0]

    def error(found: tuple[int, list[DenseField]]) -> float:
        return max(_relative(a, b) for a, b in zip(found[1], exact, strict=True))

    order = sorted(prunes, key=lambda prune: (prune != case.config.grids.prune, prune))
    tasks = [
        Task(
            "32-bit floats" if not half else "16-bit floats",
            f"grids.prune={prune:g}",
            partial(lambda f, h, run: _written(case, f, h), fields[prune], half),
            error,
            prune == case.config.grids.prune and half == case.config.grids.half,
            size=lambda found: float(found[0]),
        )
        for prune in order
        for half in (case.config.grids.half, not case.config.grids.half)
        if not half or (largest * case.scene.gamma_w < 6e4 and largest < 6e4)
    ]
    names = " and ".join(field.name for field in exact)
    return Plan(
        tasks,
        "largest relative error of a grid (rms)",
        f"The frame's {names}, written like a result and read back, at full size."
        + (" The emission has a colour that varies smoothly in space, because the source has none."
           if len(exact) > 1 else ""),
        "the grids before they were written. Bytes are those on disk. Another process reads the "
        "file back.",
        y_label="size of the file [bytes]",
        n_runs=2,
    )  # fmt: skip


def _fields(case: Case, density: DenseField, prune: float) -> list[DenseField]:
    values = np.where(density.values > prune, density.values, 0).astype(np.float32)
    kept = replace(density, values=values, background=0.0)
    if "colour" not in case.steps:
        return [kept]
    axes = np.meshgrid(*(np.linspace(0, 9, n) for n in values.shape), indexing="ij")
    waves = [0.55 + 0.45 * np.sin(axes[n] + 1.7 * axes[n - 1] + n) for n in range(3)]
    light = np.stack(waves, axis=-1) * (case.scene.gamma_w * np.clip(values, 0, None))[..., None]
    emission = DenseField(
        "emission", light.astype(np.float32), density.ijk_min, density.index_to_world,
        (0.0, 0.0, 0.0), "unknown",
    )  # fmt: skip
    return [kept, emission]


def _written(case: Case, fields: list[DenseField], half: bool) -> tuple[int, list[DenseField]]:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "frame.vdb"
        write_frame(target, fields, {}, half, case.config.grids)
        requests = [GridRequest(field.name) for field in fields]
        read = read_grids(target, requests, case.config.grids)
        return target.stat().st_size, read


def _relative(found: DenseField, exact: DenseField) -> float:
    """Root mean square of the differences, of the exact values' own; boxes may differ."""
    values = values_in_box(found, exact.ijk_min, exact.values.shape, np.float64)
    truth = exact.values.astype(np.float64)
    return float(np.sqrt(np.mean((values - truth) ** 2) / np.mean(truth**2)))


FILES = Sweep("files", "VDB files: precision and pruning", lambda case: "", _plan)
