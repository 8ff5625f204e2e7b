"""A loss of pictures that a GPU computes again and again: a CUDA graph.

Python queues a loss of a thousand small operations in 30 ms, and a GPU computes them in 3. Their
queue is recorded once, and given to the GPU as a whole from then on.

A recording is of one size of pictures. Views of smoke have many sizes, and other ones in each
frame, so pictures are enlarged to a few. Coarse features near the old border then see background
where they saw the border repeated: losses change by less than a thousandth.
"""

import threading
from collections.abc import Callable
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

WARM_UP = 2  # runs before the recording: libraries choose their ways, tables are made
SIDE = 64  # pixels; sides of enlarged pictures are multiples of it


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
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.stream(side):
            for _ in range(WARM_UP):
                self._evaluate()
            # not ``torch.cuda.graph``, which collects Python's garbage each time, in 80 ms
            self._graph.capture_begin(capture_error_mode="thread_local")
            self._results = self._evaluate()
            self._graph.capture_end()
        here.wait_stream(side)

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


def enlarged(picture: Tensor, guide: Tensor) -> tuple[Tensor, Tensor]:
    """A picture [H W C], its last row and column repeated, and its guide [H W], 0 there.

    Gradients: through the picture.
    """
    height, width = (-(-n // SIDE) * SIDE for n in guide.shape)
    below, beside = height - guide.shape[0], width - guide.shape[1]
    if not below and not beside:
        return picture, guide
    wide = cast(Tensor, _Enlarged.apply(picture, below, beside))
    return wide, F.pad(guide, (0, beside, 0, below))


class _Enlarged(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, picture: Tensor, below: int, beside: int) -> Tensor:
        height, width = ctx.sides = picture.shape[:2]
        wide = picture.new_empty(height + below, width + beside, *picture.shape[2:])
        wide[:height, :width] = picture
        wide[:height, width:] = picture[:, -1:]
        wide[height:] = wide[height - 1]
        return wide

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None]:
        (height, width), slope = ctx.sides, upstream.clone()
        slope[height - 1] += slope[height:].sum(0)
        slope[:, width - 1] += slope[:, width:].sum(1)
        return slope[:height, :width], None, None


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
