"""Work shared among threads."""

import os
import sys
import threading
import time
from collections.abc import Iterator

import pytest
import torch

from usdsmoke.core.smoke.memory import accumulate, accumulate_beside
from usdsmoke.core.smoke.tasks import (
    computing_threads,
    made_ahead,
    n_sharing,
    run_beside,
    run_tasks,
    share_among,
)


@pytest.fixture(autouse=True)
def same_threads_afterwards() -> Iterator[None]:
    threads, sharing = torch.get_num_threads(), n_sharing()
    yield
    share_among(sharing)
    torch.set_num_threads(threads)


def test_results_come_in_the_order_of_the_tasks_from_several_threads():
    share_among(3)
    together = threading.Barrier(3, timeout=30)

    def task(number: int) -> tuple[int, int]:
        if number < 3:
            together.wait()  # passes only if three threads are here at once
        return number, threading.get_ident()

    found = run_tasks([lambda n=n: task(n) for n in range(20)])
    assert [number for number, _ in found] == list(range(20))
    assert len({thread for _, thread in found[:3]}) == 3


def test_threads_take_turns_more_often_only_while_they_compute():
    before = sys.getswitchinterval()
    sys.setswitchinterval(0.005)
    try:
        with computing_threads(2):
            assert sys.getswitchinterval() < 0.001
        assert sys.getswitchinterval() == pytest.approx(0.005, rel=1e-3)
        with computing_threads(1):  # nobody waits
            assert sys.getswitchinterval() == pytest.approx(0.005, rel=1e-3)
    finally:
        sys.setswitchinterval(before)


def test_tasks_inside_a_task_stay_in_its_thread():
    share_among(2)

    def outer() -> set[int]:
        return {*run_tasks([threading.get_ident] * 5), threading.get_ident()}

    assert all(len(threads) == 1 for threads in run_tasks([outer, outer, outer]))


@pytest.mark.parametrize("bad", [0, 5])
def test_an_error_in_a_task_is_raised_and_work_goes_on_afterwards(bad: int):
    share_among(2)

    def task(number: int) -> int:
        if number == bad:
            raise ValueError("the bad one")
        return number

    with pytest.raises(ValueError, match="bad one"):
        run_tasks([lambda n=n: task(n) for n in range(8)])
    assert run_tasks([lambda: 1, lambda: 2, lambda: 3]) == [1, 2, 3]


def test_work_beside_another_one_runs_at_once_and_both_come_back():
    share_among(2)
    together = threading.Barrier(2, timeout=30)

    def work() -> int:
        together.wait()  # passes only if both are here at once
        return threading.get_ident()

    first, second = run_beside(work, work)
    assert first == threading.get_ident() != second


@pytest.mark.parametrize("threads", [1, 2])
def test_work_beside_another_one_has_gradients_as_its_caller_has(threads: int):
    share_among(threads)
    with torch.no_grad():
        assert run_beside(torch.is_grad_enabled, torch.is_grad_enabled) == (False, False)
    assert run_beside(torch.is_grad_enabled, torch.is_grad_enabled) == (True, True)


def test_tasks_inside_the_second_of_two_stay_in_its_thread():
    share_among(3)
    begun = threading.Event()

    def second() -> set[int]:
        begun.set()
        return {*run_tasks([threading.get_ident] * 5), threading.get_ident()}

    _, threads = run_beside(lambda: begun.wait(30), second)
    assert len(threads) == 1


def test_work_beside_another_one_inside_a_task_stays_in_its_thread():
    share_among(3)

    def outer() -> bool:
        return run_beside(threading.get_ident, threading.get_ident) == (threading.get_ident(),) * 2

    assert all(run_tasks([outer, outer]))


def test_two_terms_beside_each_other_are_computed_at_once():
    share_among(2)
    together = threading.Barrier(2, timeout=30)

    def outer(x: torch.Tensor) -> torch.Tensor:
        together.wait()
        return accumulate(x, [lambda x: inner(x, 0), lambda x: inner(x, 1)])

    def inner(x: torch.Tensor, number: int) -> torch.Tensor:
        shared.wait()  # both threads share the first term's own terms
        return x.sum()

    def other(x: torch.Tensor) -> torch.Tensor:
        together.wait()
        return x.square().sum()

    shared = threading.Barrier(2, timeout=30)
    values = torch.ones(4, requires_grad=True)
    assert accumulate_beside(values, outer, other).item() == 12


def test_tasks_inside_the_first_of_two_are_shared_once_the_other_thread_is_free():
    share_among(2)
    is_done, together = threading.Event(), threading.Barrier(2, timeout=30)

    def first() -> list[int]:
        alone = run_tasks([threading.get_ident] * 3)  # the other thread is not waited for
        is_done.set()
        run_tasks([together.wait] * 2)
        return alone

    alone, _ = run_beside(first, lambda: is_done.wait(30) or pytest.fail("it waited"))
    assert set(alone) == {threading.get_ident()}


@pytest.mark.parametrize("bad", ["first", "second"])
def test_an_error_beside_other_work_is_raised_after_it_has_ended(bad: str):
    share_among(2)
    ended, together = [], threading.Barrier(2, timeout=30)

    def work(name: str) -> None:
        together.wait()
        if name == bad:
            raise ValueError("the bad one")
        time.sleep(0.05)
        ended.append(name)

    with pytest.raises(ValueError, match="bad one"):
        run_beside(lambda: work("first"), lambda: work("second"))
    assert ended == ["second" if bad == "first" else "first"]
    assert run_beside(lambda: 1, lambda: 2) == (1, 2)


@pytest.mark.parametrize("threads", [1, 3])
def test_gradients_of_two_terms_beside_each_other_are_their_sum(threads: int):
    share_among(threads)
    values = torch.linspace(-1, 1, 50, dtype=torch.float64, requires_grad=True)
    terms = [lambda x, k=k: (x * k).sin().sum() for k in range(1, 4)]
    total = accumulate_beside(values, lambda x: accumulate(x, terms[:2]), lambda x: 2 * terms[2](x))
    (gradient,) = torch.autograd.grad(total, values)
    x = values.detach()
    exact = x.cos() + 2 * (2 * x).cos() + 6 * (3 * x).cos()
    assert torch.allclose(gradient, exact, rtol=0, atol=1e-14)


def test_gradients_of_shared_terms_are_those_of_one_thread():
    values = torch.linspace(-1, 1, 50, requires_grad=True)
    terms = [lambda x, k=k: (x * k).sin().sum() for k in range(1, 7)]
    found = []
    for threads in (1, 3):
        share_among(threads)
        (gradient,) = torch.autograd.grad(accumulate(values, terms), values)
        found.append(gradient)
    assert torch.equal(*found)
    exact = sum(k * (values.detach() * k).cos() for k in range(1, 7))
    assert torch.allclose(found[0], exact, atol=1e-5)


def test_tasks_have_gradients_enabled_as_their_caller_has():
    share_among(2)
    with torch.no_grad():
        assert run_tasks([torch.is_grad_enabled] * 4) == [False] * 4
    assert run_tasks([torch.is_grad_enabled] * 4) == [True] * 4


def test_a_fork_has_threads_of_its_own():
    share_among(2)
    run_tasks([lambda: 1, lambda: 2])
    child = os.fork()
    if child == 0:
        os._exit(0 if run_tasks([lambda: 1, lambda: 2]) == [1, 2] else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_the_next_item_is_made_while_one_is_used():
    begun = [threading.Event() for _ in range(3)]

    def items() -> Iterator[int]:
        for number, event in enumerate(begun):
            event.set()
            yield number

    for number in made_ahead(items()):
        assert begun[min(number + 1, 2)].wait(30)


def test_an_error_of_the_next_item_comes_behind_the_items_before_it():
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("the second")

    ahead = made_ahead(items())
    assert next(ahead) == 1
    with pytest.raises(ValueError, match="second"):
        next(ahead)
