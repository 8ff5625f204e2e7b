"""A loss of pictures that a GPU computes again and again: a CUDA graph.

Python queues a loss of a thousand small operations in 30 ms, and a GPU computes them in 3. Their
queue is recorded once, and given to the GPU as a whole from then on.

A recording is of one size of pictures. Views of smoke have many sizes, and other ones in each
frame, so pictures are enlarged to a few. Coarse features near the old border then see background
where they saw the border repeated: losses change by less than a thousandth, and slopes by 3 to 5 %.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, TypeVar, cast

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from usdsmoke.base.machine import no_garbage_collection

WARM_UP = 2  # runs before the recording: libraries choose their ways, tables are made
SIDE = 64  # pixels; sides of enlarged pictures are multiples of it

Evaluate = Callable[[], tuple[Tensor, Tensor]]
Result = TypeVar("Result")


class Replay:
    """A scalar function of tensors and its slope by the first of them.

    It is used by one thread.

    Args:
        function: of tensors on one GPU; it waits for no number of theirs, and reads nothing else
            that changes.
        inputs: any values, of the shapes and types that all later ones have.
    """

    def __init__(self, function: Callable[..., Tensor], *inputs: Tensor) -> None:
        self._inputs = [values.detach().clone() for values in inputs]
        # the function is not kept: it may hold this object, and a cycle would keep a GPU's memory
        self.record(partial(_value_and_slope, function, self._inputs))

    def __call__(self, *inputs: Tensor) -> Tensor:
        """The value, a scalar. Gradients: through the first of the inputs, of first order."""
        return cast(Tensor, _Replayed.apply(self, *inputs))

    def take(self, inputs: tuple[Tensor, ...]) -> None:
        """Overwrite the inputs."""
        for kept, values in zip(self._inputs, inputs, strict=True):
            kept.copy_(values)

    def record(self, evaluate: Evaluate) -> None:
        """Record the function of the inputs where they lie."""
        device = self._inputs[0].device
        with torch.cuda.device(device):
            recorder, here = _recorder_of(device), torch.cuda.current_stream()
            recorder.stream.wait_stream(here)
            # an old recording must not be freed during a new one
            with torch.cuda.stream(recorder.stream), no_garbage_collection():
                for _ in range(WARM_UP):
                    evaluate()
                self._graph, self._results = recorder.record(evaluate)
            here.wait_stream(recorder.stream)

    def play(self) -> tuple[Tensor, Tensor]:
        """The value and the slope at the inputs."""
        self._graph.replay()
        value, slope = self._results  # the next recording that plays may overwrite them
        return value.clone(), slope.clone()


def _value_and_slope(
    function: Callable[..., Tensor], inputs: list[Tensor]
) -> tuple[Tensor, Tensor]:
    first, *others = inputs
    with torch.enable_grad():
        leaf = first.detach().requires_grad_()
        value = function(leaf, *others)
        (slope,) = torch.autograd.grad(value, leaf, materialize_grads=True)
    return value.detach(), slope


class _Recorder:
    """The stream of a GPU that records, and the memory that all recordings share.

    They play one after the other, and what they give is copied at once.
    """

    def __init__(self, device: torch.device) -> None:
        self.stream = torch.cuda.Stream(device)
        self._pool = torch.cuda.graph_pool_handle()
        # memory whose recordings are all freed takes no new ones: this one is kept
        with torch.cuda.stream(self.stream):
            self._kept, _ = self.record(partial(torch.zeros, 1, device=device))

    def record(self, work: Callable[[], Result]) -> tuple[torch.cuda.CUDAGraph, Result]:
        """What the GPU is given to do, on the current stream, and what ``work`` returns."""
        graph = torch.cuda.CUDAGraph()
        # not ``torch.cuda.graph``, which empties the GPU's caches each time
        graph.capture_begin(pool=self._pool, capture_error_mode="thread_local")
        try:
            return graph, work()
        finally:
            graph.capture_end()


@cache
def _recorder_of(device: torch.device) -> _Recorder:
    return _Recorder(device)


def enlarged(picture: Tensor, guide: Tensor) -> tuple[Tensor, Tensor]:
    """A picture [H W C], its last row and column repeated, and its guide [H W], 0 there.

    Gradients: through the picture.
    """
    height, width = (-(-n // SIDE) * SIDE for n in guide.shape)
    below, beside = height - guide.shape[0], width - guide.shape[1]
    if guide.numel() == 0 or not (below or beside):
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
        replay.take(inputs)
        value, slope = replay.play()
        ctx.save_for_backward(slope)
        return value

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        (slope,) = ctx.saved_tensors
        return (None, slope * upstream, *[None] * (len(ctx.needs_input_grad) - 2))
