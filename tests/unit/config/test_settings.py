"""Settings: defaults, limits, forms in which they are given, what is explicit, records of them."""

import copy
import json
import math
import pickle
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

import usdsmoke
from usdsmoke.base.errors import ConfigError
from usdsmoke.config.look_sections import StyleConfig, ViewsConfig
from usdsmoke.config.resolve import (
    GivenSettings,
    read_settings,
    recorded_settings,
    resolve_config,
    resolve_settings,
    settings,
    settings_record,
    settings_yaml,
)
from usdsmoke.config.run_sections import WindowsConfig
from usdsmoke.config.setting_model import allowed_values, extra_of, limits_of
from usdsmoke.config.settings import Config, declared_settings, style_shares
from usdsmoke.core.smoke.schedule import view_ranges


def write(folder: Path, text: str) -> Path:
    file_path = folder / "settings.yaml"
    file_path.write_text(text, encoding="utf-8")
    return file_path


def values_of(name: str) -> st.SearchStrategy[Any]:
    """Any value that the setting's declaration allows."""
    field = declared_settings()[name]
    extra, limits = extra_of(field), limits_of(field)
    text = settings()[name]["type"]
    low, high = limits.get("ge", limits.get("gt")), limits.get("le")
    single: st.SearchStrategy[Any]
    if words := allowed_values(field):
        single = st.sampled_from(words)
    elif "pattern" in extra:
        single = st.from_regex(extra["pattern"], fullmatch=True)
    elif "whole number" in text:
        single = st.integers(low, high)  # type: ignore[arg-type]
    elif "number" in text:
        finite = {"allow_nan": False, "allow_infinity": False, "exclude_min": "gt" in limits}
        single = st.floats(low, high, **finite)  # type: ignore[arg-type]
    elif "string" in text:
        single = st.text(st.characters(codec="utf-8", exclude_categories=("Cs",)))
    else:
        single = st.booleans()
    if "list" in text:
        least = max((getattr(m, "min_length", 0) for m in field.metadata), default=0)
        return st.lists(single, min_size=least, max_size=4, unique=bool(extra.get("distinct")))
    return st.none() | single if "null" in text else single


@st.composite
def configs(draw: st.DrawFn) -> dict[str, dict[str, Any]]:
    sections: dict[str, dict[str, Any]] = {}
    for name in declared_settings():
        section, _, key = name.partition(".")
        sections.setdefault(section, {})[key] = draw(values_of(name))
    sections["features"]["weights"] = [1.0] * len(sections["features"]["layers"])
    return sections


@examples(max_examples=40, deadline=None)
@given(configs(), st.booleans())
def test_every_configuration_survives_yaml(sections: Any, comments: bool) -> None:
    config = resolve_config(sections)
    assert config.model_dump() == sections
    assert resolve_config(yaml.safe_load(settings_yaml(config, comments=comments))) == config


@pytest.mark.parametrize("comments", [True, False])
def test_the_written_file_is_read_back_unchanged(tmp_path: Path, comments: bool) -> None:
    config = resolve_config({"optics": {"gamma": 0.1}, "layer": {"name": "plume"}})
    assert resolve_config(write(tmp_path, settings_yaml(config, comments=comments))) == config


def test_defaults_are_within_their_own_limits() -> None:
    assert resolve_config(Config().model_dump()) == Config()


def test_every_setting_is_explained_with_type_default_and_range() -> None:
    told, text = usdsmoke.settings(), settings_yaml(Config())
    for name, about in told.items():
        section, _, key = name.partition(".")
        assert about["default"] == getattr(getattr(Config(), section), key)
        assert len(about["description"]) > 10 and about["description"] in text, name
    assert told["views.count"]["range"] == "1 to 64"
    assert told["shape.iterations"]["range"] == "one or more, each at least 0"
    assert told["views.azimuth"]["unit"] == "degrees"


@pytest.mark.parametrize(
    "given",
    [
        {"windows": {"size": 3}, "optics": {"gamma": 1}},
        {"windows.size": 3, "optics.gamma": 1},
        ["windows.size=3", "optics.gamma=1"],
        resolve_config({"windows.size": 3, "optics.gamma": 1}),
    ],
    ids=["nested", "dotted", "texts", "ready made"],
)
def test_the_forms_of_settings_mean_the_same(given: Any) -> None:
    for config in (resolve_settings(given), resolve_settings([{}, given]), resolve_config(given)):
        assert (config.windows.size, config.optics.gamma) == (3, 1.0)


def test_a_single_text_is_one_setting_and_a_path_a_file(tmp_path: Path) -> None:
    file_path = write(tmp_path, "windows.size: 3\noptimize:\n  seed: 4\n")
    config = resolve_settings([str(file_path), "optimize.seed=9"])
    assert (config.windows.size, config.optimize.seed) == (3, 9)
    assert config.explicit == {"optimize.seed"}


def test_later_sources_win() -> None:
    weak = {"windows": {"size": 2, "warm_iterations": 0.5}, "optimize": {"seed": 1}}
    config = resolve_config(weak, {"windows": {"size": 3}}, ["optimize.seed=9"])
    found = (config.windows.size, config.windows.warm_iterations, config.optimize.seed)
    assert found == (3, 0.5, 9)


def test_what_is_explicit_survives_copies_changes_and_records(tmp_path: Path) -> None:
    weak = resolve_config({"windows": {"size": 3}})
    config = resolve_settings([weak, {"optimize.seed": 0}, ["views.pool=4"]])
    names = {"optimize.seed", "views.pool"}
    changed = config.replace(views=config.views.replace(count=2)).with_values({"shape.reach": 0.1})
    record = json.loads(json.dumps(settings_record(changed, tmp_path)))
    again = recorded_settings(record, tmp_path)
    for kept in (config, copy.deepcopy(config), pickle.loads(pickle.dumps(config)), changed, again):
        assert kept.explicit == names
    assert again == changed
    assert again.explicit_values() == {"optimize": {"seed": 0}, "views": {"pool": 4}}
    assert again.given_values().keys() == {*names, "windows.size", "views.count", "shape.reach"}
    assert resolve_settings(again).explicit == names
    assert not again.with_explicit().explicit and again.with_explicit() == again


def test_fields_that_a_model_is_made_with_are_explicit() -> None:
    assert Config(windows={"size": 8}).explicit == {"windows.size"}
    assert Config(windows=WindowsConfig(size=8)).explicit == {"windows.size"}
    assert not Config().explicit


def test_settings_cannot_be_changed_in_place() -> None:
    with pytest.raises(ValueError):
        Config().windows.size = 3


def test_the_parameter_file_is_recorded_relative_to_the_record(tmp_path: Path) -> None:
    (tmp_path / "vgg.pth").touch()
    config = resolve_config({"features.vgg19_file": str(tmp_path / "vgg.pth")})
    record = settings_record(config, tmp_path / "out")
    assert record["config"]["features"]["vgg19_file"] == "../vgg.pth"
    moved = recorded_settings(record, tmp_path / "other")
    assert moved.features.vgg19_file == str(tmp_path / "vgg.pth")


def test_an_empty_file_and_an_empty_section_are_the_defaults(tmp_path: Path) -> None:
    assert resolve_config(write(tmp_path, "")) == Config()
    assert resolve_config(write(tmp_path, "windows:\n")) == Config()


@pytest.mark.parametrize(
    ("assignment", "section", "key", "value"),
    [
        ("optics.gamma=1e-3", "optics", "gamma", 0.001),
        ("optics.gamma=null", "optics", "gamma", None),
        ("optics.gamma=1", "optics", "gamma", 1.0),
        ("stage.prims=/shot/plume", "stage", "prims", ["/shot/plume"]),
        ("stage.frames=12", "stage", "frames", "12"),
        ("stage.frames=", "stage", "frames", ""),
        ("optimize.steps=[colour]", "optimize", "steps", ["colour"]),
        ("colour.iterations=[8, 4]", "colour", "iterations", [8, 4]),
        (" grids.half = true", "grids", "half", True),
    ],
)
def test_texts_are_read_as_yaml(assignment: str, section: str, key: str, value: Any) -> None:
    found = getattr(getattr(resolve_config(assignment), section), key)
    assert found == value and type(found) is type(value)


@pytest.mark.parametrize(
    ("assignment", "facts"),
    [
        ("windows.sise=3", ["windows.sise", "windows.size"]),
        ("window.size=3", ["'window'", "'windows'"]),
        ("xyz.size=3", ["'xyz'", "stage, grids, windows"]),
        ("windows.size", ["windows.size"]),
        ("size=3", ["'size'", "windows.size", "style.size"]),
        ("optimize.device=tpu", ["optimize.device is 'tpu'", "auto, cpu or cuda"]),
        ("windows.size=three", ["windows.size is 'three'", "whole number of at least 1"]),
        ("windows.size=2.5", ["windows.size is 2.5", "whole number"]),
        ("windows.size=true", ["windows.size is True", "whole number"]),
        ("windows.size=null", ["windows.size is None", "whole number"]),
        ("windows.size=0", ["windows.size is 0", "at least 1"]),
        ("views.azimuth=181", ["views.azimuth is 181.0", "0 to 180"]),
        ("optics.depth=0", ["optics.depth is 0.0", "above 0"]),
        ("optics.depth=.nan", ["optics.depth is nan", "a number"]),
        ("optics.depth=.inf", ["optics.depth is inf", "a number"]),
        ("optics.depth=1" + "0" * 400, ["optics.depth is 1000", "a number"]),
        ("optics.depth=[1, 2]", ["optics.depth is [1, 2]", "a number"]),
        ("optics.gamma=true", ["optics.gamma is True", "null or a number above 0"]),
        ("windows.size={a: 1}", ["windows.size is {'a': 1}"]),
        ("optimize.steps=[]", ["optimize.steps is []", "one or more"]),
        ("optimize.steps=[shape, shape]", ["optimize.steps", "without repeats"]),
        ("optimize.steps=[color]", ["optimize.steps[0] is 'color'", "shape, colour"]),
        ("colour.iterations=[3, -1]", ["colour.iterations[1] is -1", "at least 0"]),
        ("colour.iterations=[true]", ["colour.iterations[0] is True", "whole numbers"]),
        ("layer.name=../elsewhere", ["layer.name is '../elsewhere'", "letters"]),
        ("layer.look=original", ["layer.look is 'original'", "letters"]),
        ("windows.size=[3", ["windows.size", "YAML"]),
        ("windows.size=!!python/name:os.system", ["windows.size", "YAML"]),
        ("losses.statistic=Gram", ["losses.statistic is 'Gram'", "gram, sliced_wasserstein"]),
        ("losses.histogram=-0.1", ["losses.histogram is -0.1", "at least 0"]),
        ("losses.photorealism=yes", ["losses.photorealism is True"]),
        ("losses.sliced=1", ["losses.sliced"]),
        ("style.weights=[1, half]", ["style.weights[1] is 'half'"]),
        ("features.content_layers=[a, a]", ["content_layers", "without repeats"]),
        ("grids.half=1", ["grids.half is 1", "true or false"]),
        ("features.weights=[1, 2]", ["features.weights has 2", "features.layers has 0"]),
    ],
)
def test_a_wrong_setting_is_refused_with_what_it_is_and_may_be(
    assignment: str, facts: list[str]
) -> None:
    with pytest.raises(ConfigError) as refused:
        resolve_config(assignment)
    assert not [fact for fact in facts if fact not in str(refused.value)], refused.value


def test_a_refusal_names_where_the_setting_comes_from(tmp_path: Path) -> None:
    file_path = write(tmp_path, "windows: {size: 0}\n")
    with pytest.raises(ConfigError, match=r"windows\.size is 0 \(from .*settings\.yaml\)"):
        resolve_settings(file_path)
    with pytest.raises(ConfigError, match=r"windows\.size is 0 \(from --set\)"):
        resolve_settings(read_settings("windows.size=0", "--set"))
    with pytest.raises(ConfigError, match=r"'window' \(from --set\).*'windows'"):
        read_settings("window.size=0", "--set")
    with pytest.raises(ConfigError, match=r"--seed is -1.*from 0 to") as refused:
        resolve_settings(GivenSettings({"optimize.seed": -1}, {"optimize.seed": "--seed"}))
    assert "optimize.seed" not in str(refused.value)
    with pytest.raises(ConfigError, match=r"windows\.sise \(from .*settings\.yaml\)"):
        resolve_settings(write(tmp_path, "windows: {sise: 0}\n"))


@pytest.mark.parametrize(
    "sections", [{"windows": {"size": 0}}, {"windows": 3}, {"window": {}}, {"windows": {"sise": 3}}]
)
def test_a_model_made_in_python_is_checked_too(sections: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="window"):
        Config(**sections)
    with pytest.raises(ConfigError, match="window"):
        resolve_config(sections)


@pytest.mark.parametrize(
    ("text", "fact"),
    [
        ("- 1\n- 2\n", "no settings"),
        ("optimize: [1]\n", "optimize"),
        ("a: b: c\n", "YAML"),
        ("optimize: {seed: 1}\noptimize: {seed: 2}\n", "'optimize'"),
        ("optimize:\n  seed: 1\n  seed: 2\n", "line 3"),
        ("1: {seed: 1}\n", "'1'"),
        ("optimize: {seed: " + "1" * 5000 + "}\n", "YAML"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path: Path, text: str, fact: str) -> None:
    with pytest.raises(ConfigError) as refused:
        resolve_config(write(tmp_path, text))
    assert fact in str(refused.value) and "settings.yaml" in str(refused.value)


def test_a_missing_or_binary_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml \(No such file"):
        read_settings(tmp_path / "nowhere.yaml")
    (tmp_path / "config.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(ConfigError, match=r"config\.yaml"):
        read_settings(tmp_path / "config.yaml")


def test_a_float_keeps_every_bit_on_its_way_through_yaml() -> None:
    for value in (0.1, math.pi, 5e-324, 1.7976931348623157e308, 1e-7):
        config = resolve_config({"colour": {"learning_rate": value}})
        again = resolve_config(yaml.safe_load(settings_yaml(config)))
        assert again.colour.learning_rate == value


@pytest.mark.parametrize(
    ("weights", "n_styles", "shares"),
    [
        ([], 1, [1.0]),
        ([], 4, [0.25] * 4),
        ([3.0, 0.0, 1.0], 3, [0.75, 0.0, 0.25]),
        ([1.7e308, 1.7e308], 2, [0.5, 0.5]),
        ([5e-324, 0.0], 2, [1.0, 0.0]),
    ],
)
def test_shares_of_styles_are_their_weights_over_the_sum(
    weights: list[float], n_styles: int, shares: list[float]
) -> None:
    assert style_shares(StyleConfig(weights=weights), n_styles) == pytest.approx(shares)


@pytest.mark.parametrize(
    ("weights", "fact"),
    [([1.0], "1 number for 2"), ([1.0, 2, 3], "3 numbers for 2"), ([0, 0], "0")],
)
def test_weights_that_do_not_fit_the_styles_are_refused(weights: list[float], fact: str) -> None:
    with pytest.raises(ConfigError, match=rf"style\.weights.*{fact}"):
        style_shares(StyleConfig(weights=weights), 2)


@pytest.mark.parametrize("camera", ["", "/cameras/front"])
def test_what_settings_say_of_ranges_that_are_unset_is_what_views_have(camera: str) -> None:
    ranges = view_ranges(ViewsConfig(camera=camera))
    for name, half in zip(("azimuth", "elevation"), ranges, strict=True):
        told = ViewsConfig.model_fields[name].description or ""
        assert f"{half:g}" in re.findall(r"\d+", told)
