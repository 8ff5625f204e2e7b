"""Presets: settings files that are weaker than everything else that is given."""

import json
from pathlib import Path

import pytest
import yaml

from tests.fixtures.pipeline_fixtures import FakeCore, Shot
from tests.fixtures.usd_fixtures import write_text
from usdsmoke.audit import provenance
from usdsmoke.base.errors import ConfigError
from usdsmoke.config.presets import PRESETS, preset_file
from usdsmoke.config.resolve import resolve_settings
from usdsmoke.config.settings import Config
from usdsmoke.core.features.layers import style_layers
from usdsmoke.ui.cli.main import main


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_holds_settings_that_exist_and_is_not_explicit(name: str) -> None:
    config = resolve_settings(preset_file(name))
    assert config.explicit == frozenset()
    assert (config == Config()) == (name == "daily")


def test_a_draft_iterates_less_and_a_final_more() -> None:
    draft, daily, final = (resolve_settings(preset_file(name)) for name in PRESETS[:3])
    for step in ("shape", "colour"):
        counts = [
            sum(getattr(config, step).iterations) if step in config.optimize.steps else 0
            for config in (draft, daily, final)
        ]
        assert counts == sorted(counts) and len(set(counts)) == 3
    assert draft.views.image_size < daily.views.image_size < final.views.image_size


def test_the_paper_preset_has_the_published_layers_rate_iterations_and_views() -> None:
    config = resolve_settings(preset_file("paper"))
    assert list(style_layers(config.features)) == ["relu2_1", "relu3_1"]
    assert config.colour.learning_rate == pytest.approx(1 / 255, rel=0.01)
    assert sum(config.shape.iterations) == sum(config.colour.iterations) == 300
    assert (config.views.count, config.losses.statistic) == (9, "gram")
    assert (config.losses.keep, config.shape.mass_correction) == (0, False)


def test_an_unknown_preset_is_refused_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match="draft, daily, final, paper"):
        preset_file("best")


def test_a_settings_file_and_options_override_a_preset(
    shot: Shot, core: FakeCore, capsys: pytest.CaptureFixture[str]
) -> None:
    file_path = write_text(shot.folder / "own.yaml", "views: {pool: 3}\n")
    words = ["--preset", "draft", "--config", str(file_path), "--set", "layer.contact_sheet=0"]
    assert main(shot.arguments(*words, "--json")) == 0
    capsys.readouterr()
    (found,) = provenance(shot.output / "look.usda")
    given = yaml.safe_load(preset_file("draft").read_text(encoding="utf-8"))
    config = json.loads(json.dumps(found.record.settings))
    assert config["colour"]["iterations"] == given["colour"]["iterations"]
    assert config["views"]["image_size"] == given["views"]["image_size"]
    assert config["views"]["pool"] == 3 and config["layer"]["contact_sheet"] == 0


def test_a_preset_is_printed_as_the_file_that_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["settings", "--preset", "draft"]) == 0
    copied = write_text(tmp_path / "copy.yaml", capsys.readouterr().out)
    assert resolve_settings(copied) == resolve_settings(preset_file("draft"))
    assert copied.read_text(encoding="utf-8") == preset_file("draft").read_text(encoding="utf-8")
