"""The device on which the core computes, and what decides the bits of results."""

import os
import platform
from dataclasses import dataclass

import torch

from usdsmoke.base.errors import ConfigError
from usdsmoke.base.machine import usable_threads
from usdsmoke.config.run_sections import OptimizeConfig
from usdsmoke.core.smoke.tasks import share_among

# Variables by which libraries under torch take other instructions than the processor offers.
_LIMITS = ("ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA", "MKL_ENABLE_INSTRUCTIONS", "MKL_CBWR")


@dataclass(frozen=True)
class Machine:
    """What of a machine decides bits."""

    device: str  # "cpu" or "cuda"
    processor: str  # its kind: family, instructions that torch uses, on a GPU also its name


def choose_device(config: OptimizeConfig) -> torch.device:
    """The configured device. Sets the number of threads (``share_among``), and that convolutions
    leave cuDNN out, for the whole process.

    Raises:
        ConfigError: the device is unknown here; the message lists those there are.
    """
    available = ["cpu"] + (["cuda"] if torch.cuda.is_available() else [])
    device = _parse_device(available[-1] if config.device == "auto" else config.device)
    n_gpus = torch.cuda.device_count() if len(available) > 1 else 0
    if device is None or device.type not in available or (device.index or 0) >= max(n_gpus, 1):
        raise ConfigError(
            f"optimize.device {config.device!r} is not available. "
            f"Use one of auto, {', '.join(available)}."
        )
    share_among(config.threads or usable_threads())
    # cuDNN's convolutions take as long, more with the first picture of a size (decision 067)
    torch.backends.cudnn.enabled = False
    return device


def describe_machine(config: OptimizeConfig) -> Machine:
    """What determines the bits of results on this machine; "auto" settings are resolved.

    Raises:
        ConfigError: see ``choose_device``.
    """
    device = choose_device(config)
    kind = f"{platform.machine()} {torch.backends.cpu.get_cpu_capability()}"
    limits = [f"{name}={os.environ[name]}" for name in _LIMITS if os.environ.get(name)]
    if device.type == "cuda":
        limits.append(torch.cuda.get_device_name(device))
    return Machine(device.type, ", ".join([kind, *limits]))


def _parse_device(name: str) -> torch.device | None:
    try:
        return torch.device(name)
    except RuntimeError:  # not a name that torch knows
        return None
