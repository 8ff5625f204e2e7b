"""Where the core computes."""

import os
from collections.abc import Iterator

import pytest
import torch

from usdsmoke.base.errors import ConfigError
from usdsmoke.config.run_sections import OptimizeConfig
from usdsmoke.core.smoke.device import choose_device
from usdsmoke.core.smoke.tasks import n_sharing, share_among


@pytest.fixture(autouse=True)
def same_threads_afterwards() -> Iterator[None]:
    threads, sharing = torch.get_num_threads(), n_sharing()
    yield
    share_among(sharing)
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


def test_tasks_share_the_threads_asked_for_or_all_there_are_and_torch_has_none_of_its_own():
    choose_device(OptimizeConfig(device="cpu", threads=3))
    assert n_sharing() == 3
    choose_device(OptimizeConfig(device="cpu", threads=0))
    assert n_sharing() == len(os.sched_getaffinity(0))
    assert torch.get_num_threads() == 1
