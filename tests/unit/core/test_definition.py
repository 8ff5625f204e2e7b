"""The hash of the embedded features stands for every number they are made of."""

import ast
from pathlib import Path

import pytest

from usdsmoke.core.features import definition
from usdsmoke.core.features.definition import embedded_hash
from usdsmoke.core.features.learned import LearnedFeatures
from usdsmoke.core.features.oriented import OrientedFeatures

FOLDER = Path(definition.__file__).parent
NUMBERS = [name for name in vars(definition) if name.isupper()]


def test_the_hash_is_the_same_every_time():
    assert embedded_hash() == embedded_hash() and len(embedded_hash()) == 64


@pytest.mark.parametrize("name", NUMBERS)
def test_every_number_counts(name, monkeypatch):
    before = embedded_hash()
    value = getattr(definition, name)
    changed = (*value[:-1], value[-1] * 2) if isinstance(value, tuple) else value * 2
    monkeypatch.setattr(definition, name, changed)
    assert embedded_hash() != before


@pytest.mark.parametrize("name", [name for name in NUMBERS if name != "REVISION"])
def test_every_number_is_used_by_the_features(name):
    read = set()
    for module in ("oriented", "learned", "definition"):
        tree = ast.parse((FOLDER / f"{module}.py").read_text(encoding="utf-8"))
        names = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
        read |= {node.id for node in names if isinstance(node.ctx, ast.Load)}
    assert name in read


def test_there_is_an_entry_for_every_layer():
    learned = len(LearnedFeatures.names) - 1
    for numbers in (
        definition.N_FILTERS,
        definition.PATCH_SIZES,
        definition.N_PATCHES,
        definition.N_CLUSTERINGS,
    ):
        assert len(numbers) == learned
    assert len(OrientedFeatures.names) == definition.N_LEVELS
