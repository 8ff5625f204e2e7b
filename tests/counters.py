"""Counters of what a run does: calls, what OpenVDB is asked for, elements that torch makes."""

import importlib
import inspect
import itertools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

__all__ = ["Elements", "Reads", "count_calls", "watch_calls"]


def watch_calls(monkeypatch: pytest.MonkeyPatch, target: str, told: Callable[..., None]) -> None:
    """Tell the arguments of every call of ``module:function`` or ``module:Class.method``."""
    module, _, path = target.partition(":")
    owner: Any = importlib.import_module(module)
    *outer, name = path.split(".")
    for part in outer:
        owner = getattr(owner, part)
    real = getattr(owner, name)

    def watched(*arguments: Any, **named: Any) -> Any:
        told(*arguments, **named)
        return real(*arguments, **named)

    is_static = isinstance(inspect.getattr_static(owner, name), staticmethod)
    monkeypatch.setattr(owner, name, staticmethod(watched) if is_static else watched)


def count_calls(monkeypatch: pytest.MonkeyPatch, *targets: str) -> Counter[str]:
    """How often each target is called from now on; names without their module."""
    calls: Counter[str] = Counter()

    def counter(name: str) -> Callable[..., None]:
        return lambda *_, **__: calls.update([name])

    for target in targets:
        watch_calls(monkeypatch, target, counter(target.partition(":")[2]))
    return calls


class Elements(TorchDispatchMode):
    """How many elements all tensors have that torch's operations make, gradients included.

    Views of tensors cost nothing however large what they show: ``views=False`` leaves them out.
    """

    def __init__(self, views: bool = True) -> None:
        super().__init__()
        self.made = 0
        self._views = views

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None
    ) -> Any:
        found = func(*args, **(kwargs or {}))
        if func.is_view and not self._views:
            return found
        parts = found if isinstance(found, (tuple, list)) else [found]
        self.made += sum(part.numel() for part in parts if isinstance(part, torch.Tensor))
        return found


class Reads:
    """What the process that opens VDB files is asked for: file names, grids and bytes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.grids: list[tuple[str, str]] = []  # folder and file name, grid
        self.n_bytes = 0
        self.written: Counter[str] = Counter()  # bytes of arrays by grid
        self._pose(monkeypatch)

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
