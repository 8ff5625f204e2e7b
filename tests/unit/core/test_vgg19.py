"""VGG-19 from files that are made here: right, wrong and damaged ones."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from tests.fixtures.smoke_fixtures import random_style
from usdsmoke.base.errors import FeatureError
from usdsmoke.config.look_sections import FeaturesConfig
from usdsmoke.core.features.layers import VGG19_FILE_NAME, find_vgg19_file
from usdsmoke.core.features.network import build_network
from usdsmoke.core.features.vgg19 import Vgg19Features
from usdsmoke.core.style.losses import StyleTarget

WIDTHS = (64, 64, "M", 128, 128, "M", *[256] * 4, "M", *[512] * 4, "M", *[512] * 4)
PICTURE = torch.from_numpy(random_style(20, 24))


def reference() -> nn.Sequential:
    """The features of torchvision's model by its own recipe, with replicated borders.

    The deep convolutions, which only the shape of is looked at, are one number stored once.
    """
    layers: list[nn.Module] = []
    channels = 3
    for width in WIDTHS:
        if isinstance(width, str):
            layers.append(nn.MaxPool2d(2, 2, ceil_mode=True))
            continue
        layer = nn.Conv2d(channels, width, 3, padding=1, padding_mode="replicate", device="meta")
        shape, generator = (width, channels, 3, 3), torch.Generator().manual_seed(len(layers))
        weight = torch.full((1, 1, 1, 1), 1e-3).expand(shape)
        if width <= 256 and channels <= 128:
            weight = torch.randn(shape, generator=generator) * (2 / (9 * channels)) ** 0.5
        layer.weight = nn.Parameter(weight, requires_grad=False)
        layer.bias = nn.Parameter(
            0.1 * torch.randn(width, generator=generator), requires_grad=False
        )
        layers += [layer, nn.ReLU()]
        channels = width
    return nn.Sequential(*layers)


@pytest.fixture(scope="module")
def model() -> nn.Sequential:
    return reference()


@pytest.fixture(scope="module")
def tensors(model: nn.Sequential) -> dict[str, Tensor]:
    """A state dict with a classifier, as torchvision's has."""
    found = {f"features.{name}": values for name, values in model.state_dict().items()}
    return {**found, "classifier.0.weight": torch.zeros(4, 4)}


@pytest.fixture(scope="module")
def pth_file(tensors: dict[str, Tensor], tmp_path_factory: pytest.TempPathFactory) -> Path:
    file_path = tmp_path_factory.mktemp("vgg19") / "weights.pth"
    torch.save(tensors, file_path)
    return file_path


def write_safetensors(file_path: Path, tensors: dict[str, Tensor]) -> Path:
    """By the format's description: length, JSON table, data; half floats."""
    table: dict[str, object] = {"__metadata__": {"made": "by hand"}}
    chunks, start = [], 0
    for name, values in tensors.items():
        chunk = values.half().contiguous().numpy().tobytes()
        table[name] = {
            "dtype": "F16",
            "shape": list(values.shape),
            "data_offsets": [start, start + len(chunk)],
        }
        chunks.append(chunk)
        start += len(chunk)
    header = json.dumps(table).encode()
    file_path.write_bytes(len(header).to_bytes(8, "little") + header + b"".join(chunks))
    return file_path


def assert_maps_agree(network: Vgg19Features, model: nn.Sequential, error: float) -> None:
    """relu1_1, relu2_1 and relu3_1 stand at 1, 6 and 11 of torchvision's list."""
    mean, deviation = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    maps = ((PICTURE - mean) / deviation).permute(2, 0, 1)[None]
    found = network(PICTURE, frozenset({"relu1_1", "relu2_1", "relu3_1"}))
    for name, position in (("relu1_1", 1), ("relu2_1", 6), ("relu3_1", 11)):
        with torch.no_grad():
            wanted = model[: position + 1](maps)
        assert found[name].shape == wanted.shape
        assert torch.allclose(found[name], wanted, atol=error, rtol=error)


def test_a_state_dict_gives_torchvision_s_features(pth_file, model):
    assert_maps_agree(Vgg19Features.from_file(str(pth_file)), model, 1e-5)


def test_a_safetensors_file_gives_the_same_features(tensors, model, tmp_path):
    file_path = write_safetensors(tmp_path / "weights.safetensors", tensors)
    assert_maps_agree(Vgg19Features.from_file(str(file_path)), model, 2e-2)


def test_layers_behind_the_deepest_wanted_are_not_evaluated(pth_file, monkeypatch):
    network = Vgg19Features.from_file(str(pth_file))
    made: list[int] = []
    real = torch.nn.functional.conv2d

    def counted(image: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        made.append(len(weight))
        return real(image, weight, bias)

    monkeypatch.setattr(torch.nn.functional, "conv2d", counted)
    assert set(network(PICTURE, frozenset({"relu2_1"}))) == {"relu2_1"}
    assert made == [64, 64, 128]
    assert network(PICTURE, frozenset()) == {}


def test_pictures_of_one_pixel_pass_all_poolings(pth_file):
    maps = Vgg19Features.from_file(str(pth_file))(torch.ones(1, 1, 3), frozenset({"relu5_4"}))
    assert maps["relu5_4"].shape == (1, 512, 1, 1)


def test_the_style_loss_takes_the_network_like_the_embedded_one(pth_file):
    config = FeaturesConfig(network="vgg19", vgg19_file=str(pth_file))
    target = StyleTarget(PICTURE, build_network(config, 0)(PICTURE), {"relu2_1": 1.0})
    picture = PICTURE.flip(2).requires_grad_()
    loss = target.loss(picture, None)
    (gradient,) = torch.autograd.grad(loss, picture)
    assert loss.item() > 0.05 and torch.isfinite(gradient).all()
    assert target.loss(PICTURE, None).item() < 0.2 * loss.item()


@pytest.fixture
def no_other_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.delenv("USDSMOKE_VGG19", raising=False)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    yield tmp_path


def test_the_file_is_looked_for_in_order(no_other_places, monkeypatch):
    cached = no_other_places / "torch" / "hub" / "checkpoints" / VGG19_FILE_NAME
    with pytest.raises(FeatureError, match=f"no VGG-19 weights at {cached}.*USDSMOKE_VGG19"):
        find_vgg19_file()
    cached.parent.mkdir(parents=True)
    cached.touch()
    assert find_vgg19_file() == cached
    named, configured = no_other_places / "named.pth", no_other_places / "configured.pth"
    named.touch()
    configured.touch()
    monkeypatch.setenv("USDSMOKE_VGG19", str(named))
    assert find_vgg19_file() == named
    assert find_vgg19_file(str(configured)) == configured


def test_a_configured_file_that_is_missing_is_not_replaced_by_another(no_other_places, monkeypatch):
    (no_other_places / "named.pth").touch()
    monkeypatch.setenv("USDSMOKE_VGG19", str(no_other_places / "named.pth"))
    with pytest.raises(FeatureError, match=r"no VGG-19 weights at .*gone\.pth"):
        find_vgg19_file(str(no_other_places / "gone.pth"))


def test_a_file_with_torchvision_s_name_must_have_its_hash(pth_file, tmp_path):
    wrong = tmp_path / VGG19_FILE_NAME
    wrong.write_bytes(pth_file.read_bytes())
    with pytest.raises(FeatureError, match=r"SHA-256 [0-9a-f]{8}\..*dcbb9e9d"):
        Vgg19Features.from_file(str(wrong))


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
@pytest.mark.parametrize(
    "content", [b"", b"\x10", b"not weights at all, but long enough", b"\x7f" * 99]
)
def test_damaged_files_are_refused_without_a_traceback_s_text(content, suffix, tmp_path):
    file_path = tmp_path / f"damaged{suffix}"
    file_path.write_bytes(content)
    with pytest.raises(FeatureError, match=f"damaged{suffix}") as caught:
        Vgg19Features.from_file(str(file_path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "replacement", "message"),
    [
        (
            "features.0.weight",
            None,
            r"features\.0\.weight in .* is missing, .*\[64, 3, 3, 3\]",
        ),
        ("features.5.bias", torch.zeros(64), r"features\.5\.bias in .* is \[64\], .*\[128\]"),
        (
            "features.34.weight",
            torch.zeros(512, 256, 3, 3),
            r"is \[512, 256, 3, 3\], .*\[512, 5",
        ),
        ("features.2.bias", torch.full((64,), torch.nan), r"features\.2\.bias .* NaN or infinity"),
    ],
)
def test_wrong_tensors_are_refused_by_name_and_shape(name, replacement, message, tensors, tmp_path):
    changed = {key: values for key, values in tensors.items() if key != name}
    if replacement is not None:
        changed[name] = replacement
    torch.save(changed, tmp_path / "wrong.pth")
    with pytest.raises(FeatureError, match=message):
        Vgg19Features.from_file(str(tmp_path / "wrong.pth"))


def test_a_file_that_holds_no_state_dict_is_refused(tmp_path):
    torch.save([1, 2, 3], tmp_path / "list.pth")
    with pytest.raises(FeatureError, match=r"features\.0\.weight in .* is missing"):
        Vgg19Features.from_file(str(tmp_path / "list.pth"))
