"""A network from ``usdsmoke train`` in a run: painted frames, the record, refusals by name."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import Shot, contents, make_shot
from usdsmoke.audit import prov_document, provenance, rerun, verify
from usdsmoke.base.errors import ConfigError, FeatureError, WriteFailed
from usdsmoke.base.record_format import hash_file
from usdsmoke.core.features.safetensors import read_safetensors
from usdsmoke.core.generator.network import Generator
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.pipeline import StylizeResult, plan, stylize
from usdsmoke.planning.estimate import START
from usdsmoke.runs import window
from usdsmoke.runs.train import train
from usdsmoke.ui.cli.main import main

QUICK = {
    "views.image_size": 16,
    "views.pool": 2,
    "features.layers": ["learned0", "learned1"],
    "colour.iterations": [2, 2],
    "optimize.steps": ["colour"],
    "optimize.threads": 1,
    "style.size": 1.0,
    "optimize.error_budget": False,
    "layer.contact_sheet": 0,
}

pytestmark = pytest.mark.usefixtures("quick_grids")


@pytest.fixture
def shot(tmp_path: Path) -> Shot:
    """Three frames of a ball that rises."""
    made = make_shot(tmp_path)
    axes = np.stack(np.meshgrid(*[np.linspace(-1, 1, 10)] * 3, indexing="ij"), axis=-1)
    for code in (1, 2, 3):
        ball = np.clip(1 - ((axes - [0, 0.1 * code, 0]) ** 2).sum(-1), 0, 1)
        write_raw(made.stage.parent / f"cache/smoke.{code:04d}.vdb", raw_grid(ball))
    return made


def run(shot: Shot, output: str, **more: object) -> StylizeResult:
    settings = {**QUICK, **{name.replace("__", "."): value for name, value in more.items()}}
    return stylize(shot.stage, shot.style, shot.folder / output, settings)


def training(shot: Shot, network: Path) -> list[str]:
    """The command that trains a network on the shot."""
    settings = [f"--set={name}={json.dumps(value)}" for name, value in QUICK.items()]
    return ["train", str(shot.stage), "--style", str(shot.style), "-o", str(network), *settings]


def test_a_trained_network_paints_frames_and_is_in_the_record(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    network = shot.folder / "nets/style.safetensors"
    network.parent.mkdir()
    assert main([*training(shot, network), "--iterations", "60", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["loss"] < told["cold_loss"] and told["n_iterations"] == 60

    result = run(shot, "out", optimize__start=str(network), optimize__iterations=0)
    assert not any("start cold" in warning for warning in result.warnings)
    (found,) = provenance(result.look_layer)
    assert found.record.start_hash == hash_file(network)
    assert found.record.settings["optimize"]["start"] == "../nets/style.safetensors"
    network_entity = next(
        values for name, values in prov_document([found])["entity"].items() if "network" in name
    )
    assert hash_file(network) in network_entity.values()
    assert rerun(result.look_layer, shot.folder / "again").differences == ()

    network.write_bytes(Generator.new(torch.full((3,), 0.5), 0).to_bytes({}))
    assert [change.kind for change in verify(result.look_layer)] == ["start-edited"]
    network.unlink()
    assert [change.kind for change in verify(result.look_layer)] == ["start-missing"]


def test_a_training_tells_its_plan_and_writes_nothing_for_a_dry_run(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    network = shot.folder / "style.safetensors"

    def planned(*more: str) -> dict[str, object]:
        assert main([*training(shot, network), *more, "--dry-run", "--json"]) == 0
        told: dict[str, object] = json.loads(capsys.readouterr().out)
        return told

    few, many = planned("--iterations", "50"), planned("--iterations", "500")
    assert few["time_codes"] == [1, 3] and few["held_out"] == 2
    assert (few["n_iterations"], many["n_iterations"]) == (50, 500)
    most, least = (float(str(told["seconds"])) - START for told in (many, few))
    assert most == pytest.approx(10 * least) and least > 0
    assert not network.exists()


def test_a_network_that_does_not_suit_is_not_written(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    network = shot.folder / "style.safetensors"
    network.write_bytes(b"an old one")
    easy = ["--set", "features.layers=[learned0]"]  # for a few iterations from noise
    assert main([*training(shot, network), *easy, "--iterations", "1", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"]["type"] == "FeatureError"
    assert network.read_bytes() == b"an old one"


def test_what_a_run_has_done_grows_while_it_trains_and_behind_it(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("usdsmoke.runs.train.N_ITERATIONS", 60)
    told: list[tuple[str, float]] = []
    settings = QUICK | {"optimize.start": "network"}
    stylize(
        shot.stage, shot.style, shot.output, settings,
        progress=lambda report: told.append((report.step, report.share)),
    )  # fmt: skip
    shares = [share for _, share in told]
    assert shares == sorted(shares) and shares[-1] == 1
    trained = [share for step, share in told if step == "train"]
    assert len(trained) == 60 and 0 < trained[0] < trained[-1] < 1
    assert all(share >= trained[-1] for step, share in told if step == "colour")


def test_a_training_that_does_not_fit_the_memory_is_refused_at_once(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    network = shot.folder / "style.safetensors"
    named = [str(shot.stage), "--style", str(shot.style), "-o", str(network)]
    assert main(["train", *named, "--set", "optimize.memory_limit_gib=0.001"]) == 1
    told = capsys.readouterr().err
    assert "optimize.memory_limit_gib" in told and "GiB" in told and "%" not in told
    assert not network.exists()


def test_a_run_trains_a_network_of_its_own(shot: Shot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("usdsmoke.runs.train.N_ITERATIONS", 60)
    own = {"optimize__start": "network", "optimize__iterations": 0}
    both = own | {"optimize__steps": ["shape", "colour"]}  # there is nothing to move smoke by
    told = plan(shot.stage, shot.style, shot.output, {**QUICK, "optimize.start": "network"})
    assert any("trained" in sentence for sentence in told.needed)
    result = run(shot, "out", **both)
    assert not any("cold" in text or "no iterations" in text for text in result.warnings)
    (found,) = provenance(result.look_layer)
    (network,) = found.record.networks
    file_path = found.place(network.file)
    assert hash_file(file_path) == network.sha256 and not found.record.start_hash
    assert found.record.settings["optimize"]["start"] == "network"
    assert any(network.sha256 in e.values() for e in prov_document([found])["entity"].values())
    again = rerun(result.look_layer, shot.folder / "again")
    assert again.differences == ()

    # the same bits with the file, taken from the run's folder, in other windows and threads
    other = {"windows__size": 1, "optimize__threads": 2}
    from_file = run(shot, "file", optimize__start=str(file_path), optimize__iterations=0, **other)
    assert contents(from_file.root_stage) == contents(result.root_stage)
    file_path.write_bytes(b"")
    assert [change.kind for change in verify(result.look_layer)] == ["start-edited"]


def test_a_stopped_run_goes_on_behind_the_last_frame_that_a_network_painted(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("usdsmoke.runs.train.N_ITERATIONS", 60)
    own = {"optimize__start": "network", "optimize__iterations": 0}
    whole, painted, written = run(shot, "whole", **own), list[int](), list[int]()

    def paint(self: Generator, smoke: ActiveSmoke, gamma_w: float, seed: int) -> torch.Tensor:
        painted.append(len(smoke.ijk))
        return real_paint(self, smoke, gamma_w, seed)

    def write(*arguments: object) -> object:
        written.append(1)
        if len(written) == 2:
            raise WriteFailed("the disk is full")
        return real_write(*arguments)

    real_paint, real_write = Generator.paint, window.write_result
    with monkeypatch.context() as patch:
        patch.setattr(window, "write_result", write)
        with pytest.raises(WriteFailed):
            run(shot, "out", **own)
    monkeypatch.setattr(Generator, "paint", paint)
    assert contents(run(shot, "out", **own).root_stage) == contents(whole.root_stage)
    assert len(painted) == 2


def test_a_look_grows_with_the_network_that_it_has(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("usdsmoke.runs.train.N_ITERATIONS", 60)
    own = {"optimize__start": "network", "optimize__iterations": 0, "windows__size": 1}
    first = provenance(run(shot, "out", stage__frames="1-2", **own).look_layer)
    monkeypatch.setattr("usdsmoke.runs.train.N_ITERATIONS", 1)
    grown = run(shot, "out", **own)
    (network,) = first[0].record.networks
    assert provenance(grown.look_layer)[0].record.networks[0].sha256 == network.sha256
    assert verify(grown.look_layer) == [] and len(grown.frames) == 3


def test_frames_start_cold_where_the_network_does_not_suit_them(shot: Shot) -> None:
    network = shot.folder / "other.safetensors"
    network.write_bytes(Generator.new(torch.tensor([0.0, 1.0, 0.0]), 0).to_bytes({}))
    result = run(shot, "out", optimize__start=str(network))
    assert any("other.safetensors does not suit them" in text for text in result.warnings)
    cold = run(shot, "cold")
    assert contents(result.root_stage) == contents(cold.root_stage)


def test_a_network_alone_that_does_not_suit_the_smoke_is_refused(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Iterations from noise would take many times as long as the plan says."""
    network = shot.folder / "other.safetensors"
    network.write_bytes(Generator.new(torch.tensor([0.0, 1.0, 0.0]), 0).to_bytes({}))
    alone = {"optimize__iterations": 0}
    told = r"other\.safetensors .*</World/smoke>.*optimize\.iterations"
    with pytest.raises(ConfigError, match=told):
        run(shot, "out", optimize__start=str(network), **alone)
    assert not list(shot.folder.glob("out/**/*.vdb")) and not list(shot.folder.glob("out/*.usda"))
    monkeypatch.setattr("usdsmoke.runs.train.N_ITERATIONS", 1)
    monkeypatch.setattr("usdsmoke.core.generator.network.FAINT", 10.0)  # black and white patches
    with pytest.raises(ConfigError, match=r"</World/smoke>.*optimize\.iterations"):
        run(shot, "own", optimize__start="network", **alone)


def test_windows_share_a_coarse_step_only_where_the_network_does_not_suit_the_smoke(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("usdsmoke.runs.train.N_ITERATIONS", 60)
    several = {"windows__size": 2, "windows__shared_octaves": 1, "optimize__start": "network"}
    suits = run(shot, "out", **several)
    assert not list(shot.folder.glob("out/vdb/*/coarse/*.npz"))
    assert verify(suits.look_layer) == []
    monkeypatch.setattr("usdsmoke.runs.train.N_ITERATIONS", 1)
    monkeypatch.setattr("usdsmoke.core.generator.network.FAINT", 10.0)  # black and white patches
    cold = run(shot, "cold", **several)
    assert any("start cold" in text for text in cold.warnings)
    assert list(shot.folder.glob("cold/vdb/*/coarse/*.npz"))


def test_a_network_that_cannot_be_written_is_refused_with_the_plan(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    output = str(shot.folder / "nowhere/style.safetensors")
    asked = ["train", str(shot.stage), "--style", str(shot.style), "-o", output, "--dry-run"]
    assert main([*asked, "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"]["type"] == "WriteFailed"


def test_a_run_without_iterations_needs_a_network_that_can_be_read(shot: Shot) -> None:
    with pytest.raises(ConfigError, match=r"optimize\.start"):
        plan(shot.stage, shot.style, shot.output, {"optimize.iterations": 0})
    with pytest.raises(ConfigError, match=r"optimize\.steps"):
        nothing = {"optimize.iterations": 0, "optimize.steps": ["shape"]}
        plan(shot.stage, shot.style, shot.output, nothing | {"optimize.start": "network"})
    with pytest.raises(FeatureError, match=r"none\.safetensors"):
        plan(shot.stage, shot.style, shot.output, {"optimize.start": "/none.safetensors"})


def test_the_plan_tells_how_many_iterations_follow_the_network(shot: Shot) -> None:
    network = shot.folder / "a.safetensors"
    network.write_bytes(Generator.new(torch.full((3,), 0.5), 0).to_bytes({}))
    for values, count in (({}, 16), ({"colour.iterations": [0, 0, 65]}, 65)):
        settings = {"optimize.start": str(network), **values}
        told = plan(shot.stage, shot.style, shot.output, settings)
        assert any(
            f"colour step with {count} iterations behind a network" in t for t in told.needed
        )


def test_a_network_of_the_shot_is_taken_without_iterations_from_noise(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But not with other settings, nor where it is worse than its file says."""
    asked = list[int]()

    def cold_loss(*arguments: object) -> float:
        asked.append(1)
        return 0.0  # nothing is as good as these iterations

    file_path = shot.folder / "own.safetensors"
    train(shot.stage, shot.style, file_path, QUICK, iterations=60)
    monkeypatch.setattr("usdsmoke.core.training.canvas.cold_loss", cold_loss)
    own = {"optimize__start": str(file_path), "optimize__iterations": 0}
    result = run(shot, "out", **own)
    assert not asked and not any("suit" in text for text in result.warnings)
    run(shot, "one", stage__frames="2", **own)
    assert not asked

    start = {"optimize__start": str(file_path)}
    other = run(shot, "other", losses__nearest=0.5, **start)
    assert len(asked) == 1 and any("does not suit" in text for text in other.warnings)
    bright = np.full((8, 8, 3), 255, np.uint8)
    Image.fromarray(bright).save(shot.folder / "white.png")
    stylize(
        shot.stage, shot.folder / "white.png", shot.folder / "white",
        {**QUICK, "optimize.start": str(file_path)},
    )  # fmt: skip
    assert len(asked) == 2

    _, notes = read_safetensors(file_path)
    kept = ("basis", "loss", "cold_loss")
    worse = Generator.new(torch.tensor([0.0, 1.0, 0.0]), 0)
    file_path.write_bytes(worse.to_bytes({name: notes[name] for name in kept}))
    result = run(shot, "worse", **start)
    assert len(asked) == 3 and any("does not suit" in text for text in result.warnings)

    # trained, but never as good as iterations from noise
    poor = {"basis": notes["basis"], "loss": "9", "cold_loss": "8"}
    # and notes that are not what training writes
    for number, changes in enumerate([{}, {"loss": "x"}, {"cold_loss": ""}, {"loss": "nan"}]):
        file_path.write_bytes(worse.to_bytes({**poor, **changes}))
        run(shot, f"poor{number}", **start)
        assert len(asked) == 4 + number
    file_path.write_bytes(worse.to_bytes({"basis": notes["basis"]}))
    run(shot, "bare", **start)
    assert len(asked) == 8
