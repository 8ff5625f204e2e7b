"""Settings: defaults, strict reading, limits, and the way to YAML and back."""

import dataclasses
import math
import typing
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from usdsmoke.base.config import (
    Config,
    StyleConfig,
    config_to_dict,
    config_to_yaml,
    read_config,
    resolve_config,
    style_shares,
)
from usdsmoke.base.errors import ConfigError

EVERY_SETTING = [
    (section.name, setting)
    for section in dataclasses.fields(Config)
    for setting in dataclasses.fields(section.default_factory)  # type: ignore[arg-type]
]


def write(folder: Path, text: str) -> Path:
    file_path = folder / "config.yaml"
    file_path.write_text(text, encoding="utf-8")
    return file_path


def numbers(kind: type, limits: Any) -> st.SearchStrategy[Any]:
    low, high = limits.get("low", limits.get("above")), limits.get("high")
    if kind is int:
        return st.integers(low, high)
    return st.floats(
        low, high, exclude_min="above" in limits, allow_nan=False, allow_infinity=False
    )


def values_of(section_class: Any, setting: Any) -> st.SearchStrategy[Any]:
    """Any value that the setting's annotation and limits allow."""
    limits = setting.metadata
    wanted = typing.get_type_hints(section_class)[setting.name]
    kinds = typing.get_args(wanted) or (wanted,)
    kind = next(kind for kind in kinds if kind is not type(None))
    if "choices" in limits:
        single: st.SearchStrategy[Any] = st.sampled_from(limits["choices"])
    elif "pattern" in limits:
        single = st.from_regex(limits["pattern"], fullmatch=True)
    elif kind is str:
        single = st.text(st.characters(codec="utf-8", exclude_categories=("Cs",)))
    else:
        single = st.booleans() if kind is bool else numbers(kind, limits)
    if typing.get_origin(wanted) is list:
        return st.lists(
            single,
            min_size=limits.get("least", 0),
            max_size=4,
            unique=bool(limits.get("distinct")),
        )
    return st.none() | single if len(kinds) > 1 else single


@st.composite
def configs(draw: st.DrawFn) -> dict[str, dict[str, Any]]:
    sections: dict[str, dict[str, Any]] = {}
    for section, setting in EVERY_SETTING:
        section_class = typing.get_type_hints(Config)[section]
        sections.setdefault(section, {})[setting.name] = draw(values_of(section_class, setting))
    n_layers = len(sections["features"]["layers"])
    sections["features"]["weights"] = [1.0] * n_layers
    return sections


@settings(max_examples=40, deadline=None)
@given(configs(), st.booleans())
def test_every_configuration_survives_yaml(sections: Any, comments: bool) -> None:
    config = resolve_config(sections)
    assert config_to_dict(config) == sections
    text = config_to_yaml(config, comments=comments)
    assert resolve_config(yaml.safe_load(text)) == config


@pytest.mark.parametrize("comments", [True, False])
def test_the_written_file_is_read_back_unchanged(tmp_path: Path, comments: bool) -> None:
    config = resolve_config({"optics": {"gamma": 0.1}, "layer": {"name": "plume"}})
    file_path = write(tmp_path, config_to_yaml(config, comments=comments))
    assert resolve_config(read_config(file_path)) == config


def test_defaults_are_within_their_own_limits() -> None:
    assert resolve_config(config_to_dict(Config())) == Config()


@pytest.mark.parametrize(("section", "setting"), EVERY_SETTING, ids=lambda item: str(item)[:20])
def test_every_setting_says_what_it_means(section: str, setting: Any) -> None:
    assert len(setting.metadata["doc"]) > 10
    assert setting.metadata["doc"] in config_to_yaml(Config())


def test_later_sources_and_assignments_win() -> None:
    weak = {"windows": {"size": 2, "warm_iterations": 0.5}, "optimize": {"seed": 1}}
    config = resolve_config(weak, {"windows": {"size": 3}}, assignments=["optimize.seed=9"])
    assert (config.windows.size, config.windows.warm_iterations, config.optimize.seed) == (
        3,
        0.5,
        9,
    )


def test_an_empty_file_and_an_empty_section_are_the_defaults(tmp_path: Path) -> None:
    assert resolve_config(read_config(write(tmp_path, ""))) == Config()
    assert resolve_config(read_config(write(tmp_path, "windows:\n"))) == Config()


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
def test_assignments_are_read_as_yaml(assignment: str, section: str, key: str, value: Any) -> None:
    config = resolve_config(assignments=[assignment])
    assert getattr(getattr(config, section), key) == value
    assert type(getattr(getattr(config, section), key)) is type(value)


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("windows.sise=3", r"unknown setting windows\.sise; did you mean 'size'\?"),
        ("window.size=3", r"unknown section 'window'; did you mean 'windows'\?"),
        ("xyz.size=3", r"unknown section 'xyz'; there are: stage, grids, windows"),
        ("windows.size", r"wanted section\.key=value"),
        ("size=3", r"wanted section\.key=value"),
        ("windows.size=three", r"windows\.size is 'three', of type str; wanted int"),
        ("windows.size=2.5", r"windows\.size is 2\.5, of type float; wanted int"),
        ("windows.size=true", r"windows\.size is True, of type bool; wanted int"),
        ("windows.size=null", r"windows\.size is None, of type NoneType; wanted int"),
        ("windows.size=0", r"windows\.size is 0; wanted >= 1"),
        ("views.azimuth=181", r"views\.azimuth is 181\.0; wanted <= 180\.0"),
        ("optics.depth=0", r"optics\.depth is 0\.0; wanted > 0\.0"),
        ("optics.depth=.nan", r"optics\.depth is nan; wanted a finite number"),
        ("optics.depth=.inf", r"optics\.depth is inf; wanted a finite number"),
        ("optics.depth=1" + "0" * 400, r"of type int; wanted float"),
        ("optics.depth=[1, 2]", r"of type list; wanted float"),
        ("windows.size={a: 1}", r"of type dict; wanted int"),
        ("optimize.steps=[]", r"optimize\.steps has 0 elements; wanted at least 1"),
        ("optimize.steps=[shape, shape]", r"wanted every element once"),
        ("optimize.steps=[color]", r"optimize\.steps\[0\] is 'color'; wanted one of shape, colour"),
        ("colour.iterations=[3, -1]", r"colour\.iterations\[1\] is -1; wanted >= 0"),
        ("layer.name=../elsewhere", r"layer\.name is '\.\./elsewhere'; wanted letters"),
        ("windows.size=[3", r"cannot read the value of windows\.size: .*; wanted YAML"),
        ("windows.size=!!python/name:os.system", r"cannot read the value of windows\.size"),
        ("losses.statistic=Gram", r"losses\.statistic is 'Gram'; wanted one of gram, sliced_wass"),
        ("losses.histogram=-0.1", r"losses\.histogram is -0\.1; wanted >= 0"),
        ("losses.content=-1", r"losses\.content is -1\.0; wanted >= 0"),
        ("losses.laplacian=.inf", r"losses\.laplacian is inf; wanted a finite number"),
        ("losses.photorealism=yes", r"losses\.photorealism is True, of type bool; wanted float"),
        ("losses.sliced=1", r"unknown setting losses\.sliced"),
        ("style.weights=[1, -1]", r"style\.weights\[1\] is -1\.0; wanted >= 0"),
        ("style.weights=[1, half]", r"style\.weights\[1\] is 'half', of type str; wanted float"),
        ("features.content_layers=[a, a]", r"content_layers.* wanted every element once"),
        ("optimize.error_budget=1", r"optimize\.error_budget is 1, of type int; wanted bool"),
        ("features.weights=[1, 2]", r"features\.weights has 2 elements but features\.layers has 0"),
    ],
)
def test_a_wrong_assignment_is_refused_saying_what_was_wanted(
    assignment: str, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        resolve_config(assignments=[assignment])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- 1\n- 2\n", r"holds a list; wanted sections such as 'optimize:'"),
        ("optimize: [1]\n", r"section optimize holds \[1\]; wanted settings below it"),
        ("a: b: c\n", r"cannot read the configuration .*config\.yaml: .*; wanted YAML"),
        ("optimize: {seed: 1}\noptimize: {seed: 2}\n", r"the key 'optimize' stands here twice"),
        ("optimize:\n  seed: 1\n  seed: 2\n", r"the key 'seed' stands here twice.*line 3"),
        ("1: {seed: 1}\n", r"unknown section 1"),
        ("optimize: {seed: " + "1" * 5000 + "}\n", r"cannot read the configuration"),
    ],
)
def test_a_wrong_file_is_refused_saying_what_was_wanted(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        resolve_config(read_config(write(tmp_path, text)))


def test_a_missing_or_binary_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml: No such file.*--config or --overrides"):
        read_config(tmp_path / "nowhere.yaml")
    (tmp_path / "config.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(ConfigError, match=r"cannot read the configuration .*config\.yaml"):
        read_config(tmp_path / "config.yaml")


def test_a_float_keeps_every_bit_on_its_way_through_yaml() -> None:
    for value in (0.1, math.pi, 5e-324, 1.7976931348623157e308, 1e-7):
        config = resolve_config({"optics": {"depth": value}})
        again = resolve_config(yaml.safe_load(config_to_yaml(config)))
        assert again.optics.depth == value


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
    ("weights", "message"),
    [
        ([1.0], r"style\.weights holds 1 numbers for 2 style images; give one for each or none"),
        ([1.0, 2.0, 3.0], r"style\.weights holds 3 numbers for 2 style images"),
        ([0.0, 0.0], r"style\.weights are all 0; wanted at least one above 0"),
    ],
)
def test_weights_that_do_not_fit_the_styles_are_refused(weights: list[float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        style_shares(StyleConfig(weights=weights), 2)
