"""Precision and memory layout of the feature network's convolutions."""

from functools import partial
from typing import TYPE_CHECKING, Any

from usdsmoke.work_precision import Plan, Sweep, Task
from usdsmoke.work_precision.case import Case

if TYPE_CHECKING:
    from torch import Tensor

    from usdsmoke.core.style.losses import PictureLoss

__all__ = ["SWEEP", "double_gradient", "gradient"]

_STEP = 1e-6  # of the finite differences, along the gradient


def _applies(case: Case) -> str:
    return "losses.style is 0: no network is evaluated" if case.config.losses.style == 0 else ""


def _plan(case: Case) -> Plan:
    import torch

    picture, guide, judge = _problem(case)
    exact, _ = double_gradient(judge, picture, guide)

    def error(found: tuple["Tensor", float]) -> float:
        return float((found[0] - exact).norm() / exact.norm())

    kinds = [("float32", torch.float32), ("bfloat16", torch.bfloat16)]
    if case.on_gpu:
        kinds.append(("float16", torch.float16))
    layouts = [("as they come", None), ("channels last", torch.channels_last),
               ("channels first", torch.contiguous_format)]  # fmt: skip
    tasks = [
        Task(
            name,
            layout,
            partial(
                lambda dtype, order, run: gradient(judge, picture, guide, dtype, order),
                dtype,
                order,
            ),
            error,
            configured=name == "float32" and order is None,
        )
        for name, dtype in kinds
        for layout, order in layouts
    ]
    height, width = guide.shape
    apart = _differences(judge, picture, guide, exact)
    return Plan(
        tasks,
        "relative error of the loss's gradient",
        f"The style loss of one picture of the frame, {width} x {height} pixels, with its gradient "
        "by the pixels. The convolutions alone are done in that precision and layout; sums of "
        "Gram matrices and all else stay in single precision, whose rounding every point has.",
        "all of it in double precision; finite differences of that loss along its gradient differ "
        f"from it by {apart:.1e}.",
        uncertain=apart,
        n_runs=5,
        warm_up=True,
    )


def gradient(
    judge: "PictureLoss", picture: "Tensor", guide: "Tensor", dtype: Any, layout: Any
) -> tuple["Tensor", float]:
    """Gradient [H W 3] of a loss by its picture, and the loss.

    Args:
        judge: the loss.
        picture: [H W 3], float32.
        guide: [H W].
        dtype: that convolutions are done in.
        layout: memory format of their inputs and weights; None leaves them as they come.
    """
    import torch

    leaf = picture.detach().clone().requires_grad_(True)
    with _Convolutions(dtype, layout):
        loss = judge(leaf, guide)
    (found,) = torch.autograd.grad(loss, leaf)
    return found.double(), float(loss.detach())


def double_gradient(
    judge: "PictureLoss", picture: "Tensor", guide: "Tensor"
) -> tuple["Tensor", float]:
    """Gradient [H W 3] of a loss by its picture, and the loss, everything in double precision.

    Args:
        judge: the loss; what it remembers of the style was made in its own precision.
        picture: [H W 3].
        guide: [H W].
    """
    import torch

    leaf = picture.detach().double().requires_grad_(True)
    with _Doubles():
        loss = judge(leaf, guide.double())
    (found,) = torch.autograd.grad(loss, leaf)
    return found, float(loss.detach())


def _Doubles() -> Any:
    """A context in which whatever is single precision is taken as double."""
    import torch
    from torch.overrides import TorchFunctionMode
    from torch.utils._pytree import tree_map

    def widened(item: Any) -> Any:
        is_single = isinstance(item, torch.Tensor) and item.dtype == torch.float32
        return item.double() if is_single else item

    class Doubles(TorchFunctionMode):
        def __torch_function__(
            self, function: Any, types: Any, args: Any = (), kwargs: Any = None
        ) -> Any:
            args, kwargs = tree_map(widened, (args, kwargs or {}))
            return function(*args, **kwargs)

    return Doubles()


def _Convolutions(dtype: Any, layout: Any) -> Any:
    """A context in which convolutions have another precision and layout."""
    import torch
    from torch.overrides import TorchFunctionMode

    class Convolutions(TorchFunctionMode):
        def __torch_function__(
            self, function: Any, types: Any, args: Any = (), kwargs: Any = None
        ) -> Any:
            if function is not torch.conv2d:
                return function(*args, **(kwargs or {}))
            tensors = [self._converted(item) for item in args]
            named = {key: self._converted(item) for key, item in (kwargs or {}).items()}
            found = function(*tensors, **named)
            return found if dtype == torch.float64 else found.float()

        def _converted(self, item: Any) -> Any:
            if not isinstance(item, torch.Tensor):
                return item
            item = item.to(dtype)
            return (
                item if layout is None or item.ndim != 4 else item.contiguous(memory_format=layout)
            )

    return Convolutions()


def _problem(case: Case) -> tuple["Tensor", "Tensor", "PictureLoss"]:
    """A picture of the frame as the first iteration of the finest octave has it."""
    from usdsmoke.core.smoke.srgb import decode_srgb
    from usdsmoke.core.steps.colour import initial_colours
    from usdsmoke.core.steps.pictures import prepare_views
    from usdsmoke.core.steps.targets import make_targets
    from usdsmoke.core.views.scene import frame_views

    scene, smoke, config = case.scene, case.smoke, case.config
    targets = make_targets(case.styles, scene, config, case.device)
    view = frame_views(smoke, config.views, scene, config.optimize.seed)[0]
    (seen,) = prepare_views(smoke, [view], scene.gamma_w, scene.exposure)
    colours = decode_srgb(initial_colours(smoke, "noise", config.optimize.seed))
    picture = seen.unpremultiplied(colours, targets.background)
    judge = targets.at(1)
    judge(picture, seen.guide)  # statistics of the style are made once, in single precision
    return picture, seen.guide, judge


def _differences(
    judge: "PictureLoss", picture: "Tensor", guide: "Tensor", exact: "Tensor"
) -> float:
    """Relative difference of the derivative along the gradient from its central difference."""
    slope = float(exact.norm())
    if slope == 0:
        return 0.0
    way = exact * (_STEP * exact.numel() ** 0.5 / slope)  # root mean square: the step
    ends = [double_gradient(judge, picture.double() + sign * way, guide)[1] for sign in (1, -1)]
    wanted = float((exact * way).sum())
    return abs((ends[0] - ends[1]) / 2 - wanted) / wanted


SWEEP = Sweep("precision", "Precision and layout of the feature network", _applies, _plan)
