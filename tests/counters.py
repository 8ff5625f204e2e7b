"""Counters of the work of a run: what OpenVDB is asked for, and elements that torch makes."""

import itertools
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

__all__ = ["Elements", "Reads", "unnamed_files"]


class Elements(TorchDispatchMode):
    """Counts the elements of all tensors that torch's operations make, gradients included.

    A view of a tensor takes no work, however large it is: ``views=False`` leaves views out.

    Attributes:
        made: elements of all tensors.
        convolved: those that convolutions make. Only the feature networks have convolutions.
    """

    def __init__(self, views: bool = True) -> None:
        super().__init__()
        self.made = self.convolved = 0
        self._views = views

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None
    ) -> Any:
        found = func(*args, **(kwargs or {}))
        if func.is_view and not self._views:
            return found
        parts = found if isinstance(found, (tuple, list)) else [found]
        n_elements = sum(part.numel() for part in parts if isinstance(part, torch.Tensor))
        self.made += n_elements
        if "convolution" in func.name():
            self.convolved += n_elements
        return found


class Reads:
    """Counts what the process that opens VDB files is asked for."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.grids: list[tuple[str, str]] = []  # folder and file name, grid
        self.n_bytes = 0
        self.written: Counter[str] = Counter()  # bytes of arrays by grid
        self._pose(monkeypatch)

    @property
    def sources(self) -> Counter[tuple[str, str]]:
        """How often each file and grid of the folder ``cache`` is read."""
        return Counter((name, grid) for name, grid in self.grids if name.startswith("cache/"))

    def _pose(self, monkeypatch: pytest.MonkeyPatch) -> None:
        from tests.pipeline_fixtures import run_here

        def watched(
            request: Mapping[str, Any], arrays: Sequence[np.ndarray], config: Any
        ) -> tuple[Any, list[np.ndarray]]:
            answer, found = run_here(request, arrays, config)
            if request["action"] == "read":
                name = "/".join(Path(request["file_path"]).parts[-2:])
                self.grids += zip(itertools.repeat(name), map(str, request["names"]))
                self.n_bytes += sum(array.nbytes for array in found)
            for field, array in zip(request.get("grids", []), arrays, strict=False):
                self.written[field["name"]] += array.nbytes
            return answer, found

        monkeypatch.setattr("usdsmoke.vdb.child.run_child", watched)


def unnamed_files(folder: Path) -> set[str]:
    """The files without a name that this process holds in a folder."""
    held = {os.path.realpath(entry.path) for entry in os.scandir("/proc/self/fd")}
    return {path for path in held if path.startswith(f"{folder}/#")}
