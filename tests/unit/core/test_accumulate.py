"""Sums whose gradients are taken term by term: the plain sum's, with the memory of one term."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from usdsmoke.core.smoke.memory import accumulate

DOUBLE = torch.float64
TERMS: list[Callable[[Tensor], Tensor]] = [
    lambda x: (x**3).sum(),
    lambda x: x.sum(),  # whose gradient is one number, expanded
    lambda x: x[0].exp().mean(),
    lambda x: (x[1:] * x[:-1]).sum(),
    lambda x: x.sum(),
]


def start(*shape: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(0), dtype=DOUBLE)


def value_and_slope(loss: Callable[[Tensor], Tensor], x: Tensor) -> tuple[Tensor, Tensor]:
    unknown = x.clone().requires_grad_()
    value = loss(unknown)
    return value.detach(), torch.autograd.grad(value, unknown)[0]


@pytest.mark.parametrize("order", [1, -1])
def test_value_and_gradient_are_those_of_the_plain_sum(order):
    x, terms = start(4, 3), TERMS[::order]
    found = value_and_slope(lambda x: accumulate(x, terms), x)
    wanted = value_and_slope(lambda x: sum((term(x) for term in terms), x.new_zeros(())), x)
    assert torch.allclose(found[0], wanted[0], rtol=1e-14)
    assert torch.allclose(found[1], wanted[1], rtol=1e-14)


def test_gradients_agree_with_finite_differences_in_a_larger_expression():
    def loss(x: Tensor) -> Tensor:
        return 3.0 * accumulate(torch.sin(x) ** 2, TERMS) ** 2 + x.sum()

    assert gradcheck(loss, start(4, 3).requires_grad_())


def test_terms_that_do_not_depend_on_the_tensor_count_and_have_no_slope():
    x, other = start(3), torch.tensor(5.0, dtype=DOUBLE, requires_grad=True)
    terms = [lambda x: x.new_tensor(2.0), lambda _: other**2, lambda x: (x.detach() ** 2).sum()]
    value, slope = value_and_slope(lambda x: accumulate(x, terms), x)
    assert value.item() == pytest.approx(27 + (x**2).sum().item()) and not slope.any()
    assert other.grad is None


def test_no_terms_are_zero_with_a_zero_slope():
    value, slope = value_and_slope(lambda x: accumulate(x, []), start(3))
    assert value.item() == 0 and slope.tolist() == [0.0] * 3


def test_a_tensor_without_gradient_costs_none(monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a gradient was taken that nobody wants")

    monkeypatch.setattr(torch.autograd, "grad", refuse)
    other, kept = torch.tensor(2.0, dtype=DOUBLE, requires_grad=True), []

    def term(x: Tensor) -> Tensor:
        kept.append(x.requires_grad)
        return (x * other).sum()

    found = accumulate(start(3), [term, term])
    assert not found.requires_grad and kept == [False, False]
    assert found.item() == pytest.approx(4 * start(3).sum().item())


def test_only_one_term_s_intermediate_tensors_are_alive_at_a_time():
    """Counted by what the graph saves; the plain sum keeps everything to its end."""
    most = {}
    for name, total in (
        ("term by term", accumulate),
        ("plain", lambda x, terms: sum((term(x) for term in terms), x.new_zeros(()))),
    ):
        alive, highest = [0], [0]

        class Kept:
            def __init__(self, tensor: Tensor, alive: list[int] = alive) -> None:
                self.tensor, self._alive = tensor, alive
                alive[0] += 1

            def __del__(self) -> None:
                self._alive[0] -= 1

        def term(x: Tensor, alive: list[int] = alive, highest: list[int] = highest) -> Tensor:
            loss = x.exp().sin().exp().sum()
            highest[0] = max(highest[0], alive[0])
            return loss

        x = start(5).requires_grad_()
        with torch.autograd.graph.saved_tensors_hooks(Kept, lambda kept: kept.tensor):
            loss = total(x, [term] * 9)
        most[name] = highest[0]
        loss.backward()
    assert most == {"term by term": 3, "plain": 27}
