"""Variables that torch reads when it is imported; a user's own values stay."""

import os

__all__ = ["prepare_torch_environment"]


def prepare_torch_environment() -> None:
    """To be called before torch is imported."""
    # Threads that spin while they wait slow each other down many times where processors are shared.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    # Every size of picture leaves its convolutions in a cache, which grows with the shot.
    os.environ.setdefault("ONEDNN_PRIMITIVE_CACHE_CAPACITY", "16")
