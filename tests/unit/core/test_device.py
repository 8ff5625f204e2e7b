"""Where the core computes."""

import os
from collections.abc import Iterator

import pytest
import torch

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.sections import OptimizeConfig
from usdsmoke.core.smoke.device import choose_device


@pytest.fixture(autouse=True)
def same_threads_afterwards() -> Iterator[None]:
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


def test_auto_takes_the_processor_where_there_is_no_gpu(no_gpu):
    assert choose_device(OptimizeConfig(device="auto")) == torch.device("cpu")


def test_auto_takes_the_gpu_where_there_is_one(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert choose_device(OptimizeConfig(device="auto")) == torch.device("cuda")
    assert choose_device(OptimizeConfig(device="cuda:1")) == torch.device("cuda:1")
    assert choose_device(OptimizeConfig(device="cpu")) == torch.device("cpu")
    with pytest.raises(ConfigError, match=r"'cuda:2'.* auto, cpu, cuda\b"):
        choose_device(OptimizeConfig(device="cuda:2"))


@pytest.mark.parametrize("device", ["cuda", "cuda:0"])
def test_a_device_that_is_not_there_is_refused_with_those_that_are(device, no_gpu):
    with pytest.raises(ConfigError, match=rf"optimize\.device '{device}' .*auto, cpu\b"):
        choose_device(OptimizeConfig(device=device))


def test_threads_are_those_asked_for_or_all_there_are():
    choose_device(OptimizeConfig(device="cpu", threads=1))
    assert torch.get_num_threads() == 1
    choose_device(OptimizeConfig(device="cpu", threads=0))
    assert torch.get_num_threads() == len(os.sched_getaffinity(0))
