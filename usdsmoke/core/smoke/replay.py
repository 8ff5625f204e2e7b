"""A function of tensors that a GPU computes again and again: a CUDA graph.

Python queues a loss of a thousand small operations in 30 ms, and a GPU computes them in 2. Their
queue is recorded once, and given to the GPU as a whole from then on.
"""

import threading
from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

WARM_UP = 2  # runs before the recording: libraries choose their ways, tables are made


class Replay:
    """A scalar function of tensors and its slope by the first of them.

    Args:
        function: of tensors on one GPU; it waits for no number of theirs, and reads nothing else
            that changes.
        inputs: any values, of the shapes that all later ones have.
    """

    def __init__(self, function: Callable[..., Tensor], *inputs: Tensor) -> None:
        self._function, self._lock = function, threading.Lock()
        self._inputs = [values.detach().clone() for values in inputs]
        side, here = torch.cuda.Stream(), torch.cuda.current_stream()
        side.wait_stream(here)
        with torch.cuda.stream(side):
            for _ in range(WARM_UP):
                self._evaluate()
        here.wait_stream(side)
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self._graph, capture_error_mode="thread_local"):
            self._results = self._evaluate()

    def __call__(self, *inputs: Tensor) -> Tensor:
        """The value, a scalar. Gradients: through the first of the inputs, of first order."""
        return cast(Tensor, _Replayed.apply(self, *inputs))

    def play(self, inputs: tuple[Tensor, ...]) -> tuple[Tensor, Tensor]:
        """The value and the slope."""
        with self._lock:  # until the results are copied, on the GPU's queue
            for kept, values in zip(self._inputs, inputs, strict=True):
                kept.copy_(values)
            self._graph.replay()
            value, slope = self._results
            return value.clone(), slope.clone()

    def _evaluate(self) -> tuple[Tensor, Tensor]:
        first, *others = self._inputs
        with torch.enable_grad():
            leaf = first.detach().requires_grad_()
            value = self._function(leaf, *others)
            (slope,) = torch.autograd.grad(value, leaf, materialize_grads=True)
        return value.detach(), slope


class _Replayed(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, replay: Replay, *inputs: Tensor) -> Tensor:
        value, slope = replay.play(inputs)
        ctx.save_for_backward(slope)
        return value

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        (slope,) = ctx.saved_tensors
        return (None, slope * upstream, *[None] * (len(ctx.needs_input_grad) - 2))
