"""What a scene does not need is not done by the core: counted calls, elements and voxels.

Each thing is counted twice, where it is left out and where it is not: a counter that counts nothing
would be found out. What files and records have to do with it: test_leaving_out_runs.py.
(``inspect`` and ``validate`` without torch: test_cli.py.)
"""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from tests.counters import Elements, count_calls, watch_calls
from tests.smoke_fixtures import frame_of, puff
from tests.stylize_fixtures import quick_config, run_core, scene_of
from usdsmoke.base.resolve import resolve_config
from usdsmoke.base.volume import CameraSource, VolumeFrame
from usdsmoke.core.steps.move import PADDING
from usdsmoke.core.style.definition import learned_layers, oriented_layers
from usdsmoke.core.style.features import EmbeddedFeatures
from usdsmoke.planning.needs import unneeded_layers

CORE = "usdsmoke.core"
FEATURES = (f"{CORE}.steps.targets:build_network", f"{CORE}.style.losses:StyleTarget.loss")
MAPS = (f"{CORE}.steps.shape:column_map", f"{CORE}.steps.pictures:colour_map")


def test_grey_pictures_know_no_transmittance_along_the_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    rays = [f"{CORE}.views.project:transmittance_before", f"{CORE}.views.project:attenuation_ratio"]
    calls = count_calls(monkeypatch, *rays, f"{CORE}.steps.shape:column_map")
    run_core([frame_of(puff(10))], quick_config(optimize={"steps": ["shape"]}))
    assert set(calls) == {"column_map"}
    run_core([frame_of(puff(10))], quick_config(optimize={"steps": ["colour"]}))
    assert calls["transmittance_before"] == calls["attenuation_ratio"] > 0


@pytest.mark.parametrize("loss", ["total_variation", "histogram", "laplacian", "photorealism"])
def test_a_loss_of_weight_0_is_not_evaluated(loss: str, monkeypatch: pytest.MonkeyPatch) -> None:
    homes = {
        "total_variation": f"{CORE}.style.losses:total_variation",
        "histogram": f"{CORE}.style.losses:quantile_distance",
        "laplacian": f"{CORE}.style.losses:laplacian_distance",
        "photorealism": f"{CORE}.style.losses:photorealism_distance",
    }
    calls = count_calls(monkeypatch, homes[loss])
    run_core([frame_of(puff(8))], quick_config())
    assert not calls
    run_core([frame_of(puff(8))], quick_config(losses={loss: 0.1}))
    assert sum(calls.values()) > 0


@pytest.mark.parametrize(
    ("features", "levels", "depths"),
    [
        ({"layers": ["oriented1"]}, 1, 0),
        ({"layers": ["oriented2", "learned1"]}, 2, 1),
        ({"layers": ["oriented1", "learned2"], "weights": [1.0, 0.0]}, 1, 0),
        ({}, 3, 3),
    ],
)
def test_no_layer_below_the_deepest_style_layer_is_made_or_learned(
    features: dict[str, Any], levels: int, depths: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    evaluated, learned = set(), set()
    watch_calls(
        monkeypatch, f"{CORE}.style.features:OrientedFeatures.__call__",
        lambda _, __, wanted: evaluated.add(max(int(name[-1]) for name in wanted)),
    )  # fmt: skip
    watch_calls(
        monkeypatch, f"{CORE}.style.features:LearnedFeatures._learn_to",
        lambda _, deepest: learned.add(deepest),
    )  # fmt: skip
    made = count_calls(
        monkeypatch, f"{CORE}.style.features:OrientedFeatures._level",
        f"{CORE}.style.features:LearnedFeatures._learn",
        f"{CORE}.style.features:OrientedFeatures.__call__",
    )  # fmt: skip
    config = quick_config(features={"layers": [], **features}, optimize={"steps": ["colour"]})
    run_core([frame_of(puff(8))], config)
    assert evaluated == {levels} and learned == ({depths} if depths else set())
    n_networks = 2  # one for each octave's style
    assert made["LearnedFeatures._learn"] == n_networks * depths
    assert made["OrientedFeatures._level"] <= levels * made["OrientedFeatures.__call__"]
    left_out = {f"oriented{n}" for n in range(levels + 1, 5)}
    left_out |= {f"learned{n}" for n in range(depths + bool(depths), 5)}
    assert set(unneeded_layers(config)) == left_out


def test_the_plan_knows_the_layers_that_the_network_has() -> None:
    assert EmbeddedFeatures.names == oriented_layers() + learned_layers()
    everything = resolve_config({"features": {"layers": list(EmbeddedFeatures.names)}})
    assert unneeded_layers(everything) == ()
    assert set(unneeded_layers(resolve_config())) == {"oriented4", "learned4"}
    kept = {"losses": {"content": 1.0}, "features": {"content_layers": ["learned4"]}}
    assert unneeded_layers(resolve_config(kept)) == ("oriented4",)


def test_an_empty_frame_calls_neither_renderer_nor_network(monkeypatch: pytest.MonkeyPatch) -> None:
    work = [f"{CORE}.views.project:project_voxels", *FEATURES, f"{CORE}.fields.transport:warp"]
    scene = scene_of([frame_of(puff(8))], quick_config(), "Y")
    calls = count_calls(monkeypatch, *work)
    with Elements() as elements:
        run_core([frame_of(np.zeros((8, 8, 8)))] * 3, scene=scene)
    assert not calls
    with Elements() as full:
        run_core([frame_of(puff(8))], scene=scene)
    assert calls["StyleTarget.loss"] > 0 and elements.made < 1e-3 * full.made


def padded(density: np.ndarray, room: int) -> VolumeFrame:
    """The same smoke at the same place in a box with more room around."""
    return frame_of(np.pad(density, room), ijk_min=(-room, -room, -room))


def test_empty_space_is_not_touched(monkeypatch: pytest.MonkeyPatch) -> None:
    projected, boxes = [], []
    watch_calls(
        monkeypatch, f"{CORE}.views.project:project_voxels",
        lambda positions, view: projected.append(len(positions)),
    )  # fmt: skip
    watch_calls(
        monkeypatch, f"{CORE}.steps.shape:SparsePyramid",
        lambda nodes, *_, **__: boxes.append(int(np.prod(nodes.shape))),
    )  # fmt: skip
    made, work = [], []
    for room in (0, 24):
        projected.clear(), boxes.clear()
        with Elements() as elements:
            run_core([padded(puff(10), room)])
        made.append(elements.made)
        work.append((list(projected), list(boxes)))
    assert work[0] == work[1] and max(work[0][0]) <= (10 + 2 * PADDING) ** 3
    assert made[0] == made[1]


def test_an_iteration_of_the_shape_step_costs_the_same_in_any_box(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two lumps far from each other: what is optimised lies in them, and nothing in between.

    Judged by a sum over the moved smoke: pictures grow with what they show.
    """
    told: list[int] = []

    def loss(octave: Any, potential: torch.Tensor, _: int) -> torch.Tensor:
        told.append(elements.made)
        return octave.moved(potential).square().sum()

    monkeypatch.setattr(f"{CORE}.steps.shape._Octave.loss", loss)
    # what leaves the box is looked up in more steps: it moves a little only
    still = {"iterations": [4], "learning_rate": 1e-3}
    config = quick_config(shape=still, optimize={"steps": ["shape"]})
    made = []
    for length in (160, 320):
        density = np.zeros((length, 12, 12), np.float32)
        density[:12] = density[-12:] = puff(12)
        told.clear()
        with Elements(views=False) as elements:
            run_core([frame_of(density)], config)
        made.append([after - before for before, after in itertools.pairwise(told[1:])])
        made[-1].append(elements.made)
    assert made[0][0] == made[0][1] > 0
    assert made[1][:-1] == made[0][:-1]
    assert made[1][-1] > 1.5 * made[0][-1]  # the box is there, once


def test_one_view_is_projected_once_and_looked_at_once_an_iteration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls = count_calls(
        monkeypatch,
        f"{CORE}.steps.shape:column_map",
        f"{CORE}.steps.pictures:colour_map",
        FEATURES[1],
    )
    for views, n_maps, n_looks in (
        ({"azimuth": 0.0, "elevation": 0.0}, 2, 4),
        ({}, 6, 12),
    ):
        calls.clear()
        config = quick_config(views={"pool": 3, "count": 3, "image_size": 16, **views})
        run_core([frame_of(puff(8))], config)
        assert calls["column_map"] == calls["colour_map"] == n_maps  # one for each octave and view
        assert calls["StyleTarget.loss"] == 2 * n_looks  # two steps of two octaves, two iterations


@pytest.mark.parametrize("step", ["shape", "colour"])
def test_a_short_optimisation_makes_no_map_of_a_view_that_it_never_draws(
    step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = {"shape": "shape:column_map", "colour": "pictures:colour_map"}[step]
    calls = count_calls(monkeypatch, f"{CORE}.steps.{target}")
    for iterations, n_maps in ((3, 3), (20, 8)):
        calls.clear()
        config = quick_config(
            **{step: {"iterations": [iterations]}},
            views={"pool": 8, "count": 1, "image_size": 16},
            optimize={"steps": [step], "error_budget": False},
        )
        run_core([frame_of(puff(10))], config)
        assert sum(calls.values()) == n_maps


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slab_is_seen_once_and_moved_and_sampled_along_two_axes(
    axis: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    n_axes, channels = set(), set()
    watch_calls(
        monkeypatch, f"{CORE}.fields.gather:_find_weights",
        lambda _, __, ___, axes, *____, **_____: n_axes.add(len(axes)),
    )  # fmt: skip
    watch_calls(
        monkeypatch, f"{CORE}.steps.shape:SparseDisplacement",
        lambda *arguments: channels.add(arguments[-1]),
    )  # fmt: skip
    calls = count_calls(
        monkeypatch, f"{CORE}.steps.shape:column_map", f"{CORE}.steps.pictures:colour_map"
    )
    slab = np.moveaxis(puff(12)[:, :, 5:6], 2, axis)
    with Elements() as flat:
        result = run_core([frame_of(slab)])[0]
    assert n_axes == {2} and channels == {1}
    assert calls["column_map"] == calls["colour_map"] == 2  # one view for each octave
    assert result.report.transport.largest_displacement > 0
    with Elements() as thick:
        run_core([frame_of(np.repeat(slab, 2, axis))])
    assert n_axes == {2, 3} and channels == {1, 3} and flat.made < 0.6 * thick.made


def test_no_detail_is_optimised_that_a_small_picture_cannot_show(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    place = np.eye(4)
    place[3, :3] = [19.5, 19.5, 120.0]  # looks along -Z
    camera = CameraSource("/cam", place, 36.0, 24.0, 24.0, 0.0, 0.0, (0.1, 1e4), False)
    pixels: list[int] = []
    watch_calls(
        monkeypatch, f"{CORE}.style.losses:StyleTarget.loss",
        lambda _, picture, *__, **___: pixels.append(picture.shape[0] * picture.shape[1]),
    )  # fmt: skip
    seen = []
    for width in (640, 6):
        pixels.clear()
        views = {"image_size": 64, "camera": "/cam", "camera_width": width, "pool": 2}
        run_core(
            [replace(frame_of(puff(40)), camera=camera)],
            quick_config(views=views, colour={"iterations": [1]}, optimize={"steps": ["colour"]}),
        )
        seen.append(max(pixels))
    assert seen[1] < 0.35 * seen[0]  # sixteen pixels along the smoke always stay


def test_a_converged_octave_does_no_more_iterations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls = count_calls(monkeypatch, f"{CORE}.style.losses:StyleTarget.loss")
    done = []
    for tolerance in (0.0, 10.0):
        calls.clear()
        config = quick_config(
            colour={"iterations": [40]}, optimize={"steps": ["colour"], "tolerance": tolerance}
        )
        (result,) = run_core([frame_of(puff(8))], config)
        done.append(calls["StyleTarget.loss"])
        report = result.report.colour
        assert report.iterations == (done[-1],)
        assert report.ended == ("converged" if tolerance else "iterations",)
    assert done[0] == 40 and done[1] < 20
