"""A sum of many terms whose gradient is taken term by term, so that memory is one term's."""

from collections.abc import Callable, Iterable
from typing import Any, cast

import torch
from torch import Tensor

__all__ = ["sum_terms"]

Term = Callable[[Tensor], Tensor]


class _SumTerms(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, shared: Tensor, terms: Iterable[Term]) -> Tensor:
        total, gradient = shared.new_zeros(()), None
        for term in terms:
            with torch.enable_grad():
                leaf = shared.detach().requires_grad_(ctx.needs_input_grad[0])
                value = term(leaf)
                if leaf.requires_grad and value.requires_grad:
                    (found,) = torch.autograd.grad(value, leaf, materialize_grads=True)
                    # not in place: a gradient may be one number, expanded
                    gradient = found if gradient is None else gradient + found
            total = total + value.detach()
        ctx.save_for_backward(torch.zeros_like(shared) if gradient is None else gradient)
        return total

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return upstream * gradient, None


def sum_terms(shared: Tensor, terms: Iterable[Term]) -> Tensor:
    """Sum of scalar functions of one tensor; what a term keeps for its gradient is freed at once.

    Nine pictures of one smoke then need the memory of one, and what leads to the smoke itself is
    differentiated once and not nine times.

    Args:
        shared: any shape.
        terms: functions of ``shared`` alone: gradients to other tensors are not followed.

    Gradients: through ``shared``; exact, of first order only.
    """
    return cast(Tensor, _SumTerms.apply(shared, terms))
