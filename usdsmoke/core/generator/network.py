"""A small network that paints smoke in one pass: colours from density and noise.

From the coarsest octave to the finest, each takes white noise, which belongs to its voxels, and the
density; the finest one takes neither, as that density flickers and that noise makes specks. Each
takes the features of the octave before, interpolated. Two convolutions of 3 x 3 x 3 follow; the
second adds to the first. The finest features give display-encoded colours. So a colour depends on
the smoke around its voxel alone: not on the box, on other frames, or on how work is divided.
[Ulyanov2016, Gutierrez2020]
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from usdsmoke.core.generator.convolution import by_number, convolve, row_product
from usdsmoke.core.generator.definition import (
    LEAST_OCTAVES,
    N_NEIGHBOURS,
    N_NOISE,
    count_octaves,
    parameter_shapes,
)
from usdsmoke.core.generator.levels import Level, Octaves, Slab, slabs
from usdsmoke.core.generator.weights import read_weights, weights_bytes
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.noise import white_noise

SLOPE = 0.1  # of the rectifier below 0
THIN = 0.03  # optical depth of a voxel beside which thinner ones hardly count
FAINT = 0.2  # of a usual spread: first weights of the colours
TILE_VOXELS = 2**19  # that are painted at once, about
SEED_STEP = 0x9E3779B9  # between the seeds of neighbouring octaves' noise


@dataclass(frozen=True)
class Generator:
    """The network with its parameters, by name."""

    parameters: Mapping[str, Tensor]

    @classmethod
    def new(cls, mean: Tensor, seed: int, n_octaves: int = LEAST_OCTAVES) -> "Generator":
        """One that is not trained yet, and paints about one colour.

        Args:
            mean: display-encoded colour [3].
            seed: of the first parameters.
            n_octaves: see ``octaves_for``.
        """
        source = torch.Generator().manual_seed(seed)
        parameters = {}
        for name, shape in parameter_shapes(n_octaves).items():
            n_in = N_NEIGHBOURS * shape[1] if len(shape) == 3 else shape[0]
            spread = 0.0 if len(shape) == 1 else (2.0 / n_in) ** 0.5
            parameters[name] = torch.randn(shape, generator=source) * spread
        # Else sigmoids start at their ends: in dense smoke they stay there for 200 iterations.
        parameters["colour.weight"] *= FAINT
        inside = mean.cpu().clamp(0.02, 0.98)
        parameters["colour.bias"] = torch.log(inside / (1 - inside))
        return cls({name: values.to(mean) for name, values in parameters.items()})

    @classmethod
    def from_file(cls, file_path: Path) -> "Generator":
        """One that ``to_bytes`` gave.

        Raises:
            FeatureError: see ``read_weights``.
        """
        arrays = read_weights(file_path)
        return cls({name: torch.from_numpy(values) for name, values in arrays.items()})

    def to_bytes(self, notes: Mapping[str, str]) -> bytes:
        """A file with texts; see ``weights_bytes``."""
        parameters = self.parameters.items()
        return weights_bytes({name: p.detach().cpu().numpy() for name, p in parameters}, notes)

    def __call__(self, levels: Sequence[Level], gamma_w: float, seed: int) -> Tensor:
        """Display-encoded colours [N 3] in (0, 1) of the finest octave's voxels.

        Args:
            levels: ``n_octaves`` octaves, coarse to fine.
            gamma_w: extinction per density, 1/stage unit.
            seed: of the noise.

        Gradients: through the parameters.
        """
        features: Tensor | None = None
        for number, level in enumerate(levels):
            inputs = []
            if level is not levels[-1]:
                inputs.append(_noise(level, seed + number * SEED_STEP))
                depth = level.smoke.density * (gamma_w * level.edge)
                inputs.append(by_number(torch.log1p, depth / THIN)[:, None])
            if features is not None:
                inputs.append(level.finer(features))
            first = self._layer(f"{number}.first", torch.cat(inputs, 1), level)
            features = first + self._layer(f"{number}.second", first, level)
        assert features is not None
        p = self.parameters
        logits = row_product(features, p["colour.weight"]) + p["colour.bias"]
        return by_number(torch.sigmoid, logits)

    def paint(self, smoke: ActiveSmoke, gamma_w: float, seed: int) -> Tensor:
        """The colours of smoke at full resolution, which is not empty, without gradients.

        Tile by tile, so that tables and features take little more memory for a larger frame.
        """
        octaves = Octaves.of(smoke, self.n_octaves)
        colours = smoke.density.new_empty(len(smoke.ijk), 3)

        def painted(tile: Slab, part: Tensor) -> Tensor:
            levels = octaves.levels(part)
            return self(levels, gamma_w, seed)[tile.holds(levels[-1].smoke.ijk)]

        with torch.no_grad():
            for tile in slabs(smoke.ijk, TILE_VOXELS):
                part = tile.holds(smoke.ijk)
                colours[part] = painted(tile, part)
        return colours

    @property
    def n_octaves(self) -> int:
        """How many octaves it has."""
        return count_octaves(self.parameters)

    def copy(self) -> "Generator":
        """The same parameters in tensors of their own, without gradients."""
        return Generator({name: p.detach().clone() for name, p in self.parameters.items()})

    def to(self, device: torch.device) -> "Generator":
        """The same on a device."""
        return Generator({name: p.to(device) for name, p in self.parameters.items()})

    def _layer(self, name: str, values: Tensor, level: Level) -> Tensor:
        weight, bias = (self.parameters[f"{name}.{kind}"] for kind in ("weight", "bias"))
        return F.leaky_relu(convolve(values, level.neighbours, weight, bias), SLOPE)


def _noise(level: Level, seed: int) -> Tensor:
    """White, of mean 0 and variance 1, [N C]."""
    uniform = white_noise(level.smoke.ijk, N_NOISE, seed)
    return ((uniform - 0.5) * 12**0.5).to(level.smoke.density)
