"""VGG-19 feature maps, from a file of weights; nothing is downloaded.

Reads torchvision's state dict (``vgg19-dcbb9e9d.pth``) or the same tensors in a safetensors file,
from the configured path, the environment variable ``USDSMOKE_VGG19`` or torch's hub cache, in this
order.
"""

from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.base.errors import FeatureError
from usdsmoke.base.record_format import hash_stream
from usdsmoke.core.features.convolve import replicated
from usdsmoke.core.features.layers import (
    VGG19_BLOCKS,
    VGG19_FILE_NAME,
    find_vgg19_file,
    vgg19_layers,
)
from usdsmoke.core.features.safetensors import read_safetensors

_MEAN = (0.485, 0.456, 0.406)
_DEVIATION = (0.229, 0.224, 0.225)


def _convolutions() -> list[tuple[str, int, int, int]]:
    """(layer name, torchvision index, channels in, channels out) of the 16 convolutions."""
    found, index, channels = [], 0, 3
    for block, (width, count) in enumerate(VGG19_BLOCKS, start=1):
        for number in range(1, count + 1):
            found.append((f"relu{block}_{number}", index, channels, width))
            channels, index = width, index + 2
        index += 1  # the pooling
    return found


def _reason(error: Exception, file_path: Path) -> str:
    """Why a file cannot be read; torch's own texts advise to run whatever code it holds."""
    if isinstance(error, OSError):
        return error.strerror or "the system refused"
    if file_path.suffix == ".safetensors":
        return "it is not a complete safetensors file of numbers"
    return "it is no file of tensors alone; a file that holds code is never run"


def _pick_parameters(tensors: Any, file_path: Path) -> dict[str, tuple[Tensor, Tensor]]:
    """Weight and bias of each convolution by layer name; the rest is ignored."""
    parameters = {}
    for name, index, n_in, n_out in _convolutions():
        pair = []
        for kind, expected in (("weight", (n_out, n_in, 3, 3)), ("bias", (n_out,))):
            key = f"features.{index}.{kind}"
            tensor = tensors.get(key) if isinstance(tensors, dict) else None
            if not isinstance(tensor, Tensor) or tuple(tensor.shape) != expected:
                found = list(tensor.shape) if isinstance(tensor, Tensor) else "missing"
                raise FeatureError(
                    f"{key} in {file_path} is {found}, not {list(expected)}. Give the file of "
                    "torchvision's VGG-19 without batch normalisation."
                )
            if not torch.isfinite(tensor).all():
                raise FeatureError(
                    f"{key} in {file_path} holds NaN or infinity: the file is damaged. Download "
                    "it again."
                )
            pair.append(tensor.float())
        parameters[name] = (pair[0], pair[1])
    return parameters


class Vgg19Features:
    """Rectified maps ``relu1_1`` .. ``relu5_4`` of VGG-19 [Simonyan2015] with max-pooling.

    Differs from the original in replicated instead of zero borders, which leave no dark comb along
    the edge of the picture.
    """

    names = vgg19_layers()

    def __init__(self, parameters: dict[str, tuple[Tensor, Tensor]]) -> None:
        self._parameters = parameters
        like = parameters[self.names[0]][0]
        self._mean, self._deviation = like.new_tensor(_MEAN), like.new_tensor(_DEVIATION)

    @classmethod
    def from_file(cls, configured: str = "") -> "Vgg19Features":
        """The network with the weights of a file.

        Raises:
            FeatureError: no file, not readable, or not VGG-19's tensors.
        """
        file_path = find_vgg19_file(configured)
        if file_path.name == VGG19_FILE_NAME:
            with file_path.open("rb") as file:
                sha256 = hash_stream(file)
            if not sha256.startswith("dcbb9e9d"):
                raise FeatureError(
                    f"{file_path} has SHA-256 {sha256[:8]}..., not dcbb9e9d... as in its name: it "
                    "is damaged. Download it again."
                )
        try:
            if file_path.suffix == ".safetensors":
                arrays, _ = read_safetensors(file_path)
                tensors = {name: torch.from_numpy(values) for name, values in arrays.items()}
            else:
                tensors = torch.load(file_path, map_location="cpu", weights_only=True)
        except Exception as error:  # torch.load raises many kinds on a bad file
            raise FeatureError(
                f"cannot read VGG-19 weights from {file_path}: {_reason(error, file_path)}. Give "
                "torchvision's state dict or a safetensors file."
            ) from None
        return cls(_pick_parameters(tensors, file_path))

    def to(self, like: Tensor) -> "Vgg19Features":
        """The same network with the dtype and device of a tensor."""
        moved = {name: (w.to(like), b.to(like)) for name, (w, b) in self._parameters.items()}
        return Vgg19Features(moved)

    def __call__(self, picture: Tensor, requested: frozenset[str]) -> dict[str, Tensor]:
        """[1 C h w] maps of a picture [H W 3]; stops after the deepest requested layer.

        Gradients: through ``picture``.
        """
        maps = ((picture - self._mean) / self._deviation).permute(2, 0, 1)[None]
        found: dict[str, Tensor] = {}
        for name in self.names:
            if len(found) == len(requested):
                break
            if name.endswith("_1") and name != "relu1_1":
                maps = F.max_pool2d(maps, 2, ceil_mode=True)
            maps = torch.relu(F.conv2d(replicated(maps, 1), *self._parameters[name]))
            if name in requested:
                found[name] = maps
        return found
