"""PROV-JSON as an independent reader takes it: entities, the run, agents, derivations."""

import json
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from prov.model import (
    ProvActivity,
    ProvAgent,
    ProvAssociation,
    ProvDerivation,
    ProvDocument,
    ProvEntity,
    ProvGeneration,
    ProvUsage,
)

from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot, run
from usdsmoke.pipeline import StylizeResult
from usdsmoke.ui.cli.main import main


@pytest.fixture
def finished(shot: Shot, core: FakeCore) -> tuple[Shot, StylizeResult]:
    return shot, run(shot, "optimize.seed=3")


def read(result: StylizeResult, capsys: pytest.CaptureFixture[str]) -> ProvDocument:
    """The command's output, through the reader of the package ``prov``."""
    assert main(["provenance", str(result.root_stage), "--prov"]) == 0
    return ProvDocument.deserialize(content=capsys.readouterr().out, format="json")


def labels(document: ProvDocument, kind: type) -> dict[str, str]:
    return {str(item.identifier): str(item.label) for item in document.get_records(kind)}


def ends(document: ProvDocument, kind: type) -> set[tuple[str, str]]:
    """The first two ends of every relation of a kind."""
    return {
        (str(relation.args[0]), str(relation.args[1])) for relation in document.get_records(kind)
    }


def test_the_run_is_an_activity_with_its_times(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    (activity,) = read(finished[1], capsys).get_records(ProvActivity)
    begun, ended = activity.get_startTime(), activity.get_endTime()
    assert isinstance(begun, datetime) and isinstance(ended, datetime) and begun <= ended


def test_stage_sources_styles_and_results_are_entities(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    found = labels(read(finished[1], capsys), ProvEntity)
    assert found["run1:stage"] == "shot.usda" and found["run1:style1"] == "style.png"
    assert found["run1:source2"] == "smoke.0002.vdb density"
    assert found["run1:result2"] == "smoke.0002.vdb" and found["run1:look"] == "look.usda"


def test_the_run_used_the_inputs_and_made_the_results(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    document = read(finished[1], capsys)
    used = {entity for _, entity in ends(document, ProvUsage)}
    made = {entity for entity, _ in ends(document, ProvGeneration)}
    sources = {f"run1:source{n}" for n in (1, 2, 3)}
    assert used == sources | {"run1:stage", "run1:style1", "run1:settings", "run1:features"}
    assert made == {"run1:look", "run1:result1", "run1:result2", "run1:result3"}


def test_every_frame_derives_from_its_own_source_and_the_style(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    derived = ends(read(finished[1], capsys), ProvDerivation)
    frames = {(f"run1:result{n}", f"run1:source{n}") for n in (1, 2, 3)}
    styles = {(f"run1:result{n}", "run1:style1") for n in (1, 2, 3)}
    assert derived == frames | styles | {("run1:look", "run1:stage")}


def test_usdsmoke_and_the_packages_beneath_it_are_software_agents(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    document = read(finished[1], capsys)
    agents = labels(document, ProvAgent)
    assert set(agents.values()) == {"usdsmoke", "usd-core", "torch", "numpy", "openvdb", "python"}
    assert {agent for _, agent in ends(document, ProvAssociation)} == set(agents)
    kinds = {
        str(kind)
        for agent in document.get_records(ProvAgent)
        for kind in agent.get_asserted_types()
    }
    assert kinds == {"prov:SoftwareAgent"}


def test_the_document_survives_a_round_trip_through_the_reader(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    document = read(finished[1], capsys)
    text = document.serialize(format="json")
    assert ProvDocument.deserialize(content=text, format="json") == document


def test_no_folder_of_this_machine_is_named(
    finished: tuple[Shot, StylizeResult], capsys: pytest.CaptureFixture[str]
) -> None:
    shot, result = finished
    main(["provenance", str(result.root_stage), "--prov"])
    assert str(shot.folder) not in capsys.readouterr().out


def test_without_the_package_the_error_says_how_to_install_it(
    finished: tuple[Shot, StylizeResult],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "prov", None)
    assert main(["provenance", str(finished[1].root_stage), "--prov"]) == 1
    out, err = capsys.readouterr()
    assert out == "" and "pip install prov" in err and "Traceback" not in err


@pytest.mark.usefixtures("core")
def test_a_look_upon_a_look_gives_one_document_of_two_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = make_shot(tmp_path)
    result = run(first)
    upon = Shot(tmp_path, result.root_stage, first.style, tmp_path / "again")
    again = run(upon, "stage.restylize=true")
    document: dict[str, Any] = {}
    assert main(["provenance", str(again.root_stage), "--prov"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document["activity"]) == {"run1:run", "run2:run"}
    assert document["prefix"]["run1"] != document["prefix"]["run2"]
