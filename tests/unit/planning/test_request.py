"""What a run can be asked for with: a file or an open stage, settings of every kind in order."""

from pathlib import Path

import pytest
from pxr import Sdf, Usd

from tests.fixtures.usd_fixtures import plume_stage, write_text
from usdsmoke.base.errors import ConfigError, StageError
from usdsmoke.config.settings import Config
from usdsmoke.pipeline import Request


def test_an_open_stage_stands_for_its_file(tmp_path: Path) -> None:
    file_path = plume_stage(tmp_path)
    stage = Usd.Stage.Open(str(file_path))
    assert Request(stage).settled().stage == str(file_path)
    assert Request(file_path).settled().stage == str(file_path)


def edit_root(stage: Usd.Stage) -> None:
    stage.DefinePrim("/World/new")


def edit_session(stage: Usd.Stage) -> None:
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        stage.GetPrimAtPath("/World").SetActive(False)


def mute(stage: Usd.Stage) -> None:
    layer = Sdf.Layer.CreateNew(str(Path(stage.GetRootLayer().realPath).with_name("over.usda")))
    stage.GetRootLayer().subLayerPaths.append(layer.identifier)
    stage.GetRootLayer().Save()
    stage.MuteLayer(layer.identifier)


@pytest.mark.parametrize("change", [edit_root, edit_session, mute])
def test_an_open_stage_that_its_file_does_not_give_is_refused(tmp_path: Path, change) -> None:
    stage = Usd.Stage.Open(str(plume_stage(tmp_path)))
    change(stage)
    with pytest.raises(StageError, match=r"plume\.usda|shot\.usda"):
        Request(stage).settled()


def test_a_stage_in_memory_alone_is_refused() -> None:
    with pytest.raises(StageError, match="memory"):
        Request(Usd.Stage.CreateInMemory()).settled()


def test_settings_come_in_every_form_and_the_last_one_is_the_strongest(tmp_path: Path) -> None:
    file_path = write_text(tmp_path / "s.yaml", "windows: {size: 2}\noptimize: {seed: 4}\n")
    assert Request("s.usda").config == Config()
    assert Request("s.usda", settings=file_path).config.windows.size == 2
    assert Request("s.usda", settings=str(file_path)).config.explicit == frozenset()
    for settings in ({"windows.size": 3}, {"windows": {"size": 3}}, "windows.size=3"):
        request = Request("s.usda", settings=[file_path, settings])
        assert (request.config.windows.size, request.config.optimize.seed) == (3, 4)
        assert request.config.explicit == {"windows.size"}
    request = Request("s.usda", settings=["windows.size=3", file_path])
    assert (request.config.windows.size, len(request.config.explicit)) == (2, 0)


def test_other_settings_keep_what_was_explicit() -> None:
    request = Request("s.usda", settings=["windows.size=3", "optimize.seed=1"])
    other = request.with_config(request.config.with_values({"windows.size": 5, "views.count": 2}))
    assert (other.config.windows.size, other.config.views.count) == (5, 2)
    assert other.config.explicit == {"windows.size", "optimize.seed"}


@pytest.mark.parametrize("settings", [{"windows.sice": 3}, "none.yaml", ["windows=3"]])
def test_settings_that_cannot_be_read_are_refused(settings: object) -> None:
    with pytest.raises(ConfigError):
        Request("s.usda", settings=settings).settled()
