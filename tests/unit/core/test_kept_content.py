"""What the colour step keeps of the smoke's own picture when it is asked to."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style, smoke_of
from tests.fixtures.stylize_fixtures import scene_of
from usdsmoke.config.resolve import resolve_config
from usdsmoke.core.smoke.srgb import decode_srgb, luma
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.pictures import ColourView, prepare_views
from usdsmoke.core.steps.targets import StepProblem, make_targets
from usdsmoke.core.style.content import photorealism_distance
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import frame_views


def painted(**weights: Any) -> tuple[ColourView, Tensor, Tensor]:
    """A view of a puff, its picture after the colour step, and the smoke's own grey picture."""
    density = puff(20)
    smoke = smoke_of(density)
    config = resolve_config(
        {
            "views": {"pool": 1},
            "features": {"layers": ["oriented1", "oriented2"]},
            "optimize": {"threads": 1, "tolerance": 0.0},
            "colour": {"iterations": [30, 30]},
            "losses": weights,
        }
    )
    scene = scene_of([frame_of(density)], config, "Y")
    targets = make_targets([random_style(16, 20)], scene, config, torch.device("cpu"))
    problem = StepProblem(smoke, targets, scene, config)
    colours, _ = run_colour_step(problem, config.colour.iterations)
    where = frame_views(smoke, config.views, scene, 1)
    (view,) = prepare_views(smoke, where, scene.gamma_w)
    columns = column_map(smoke.positions, smoke.edges, where[0])
    grey = opacity(scene.gamma_w_shape * columns.apply(smoke.density[:, None])[..., 0])
    return view, view.unpremultiplied(decode_srgb(colours), targets.background), grey


def likeness(view: ColourView, picture: Tensor, grey: Tensor) -> float:
    """Correlation of luminance and grey where there is smoke."""
    inside = view.alpha > 0.3
    return float(np.corrcoef(luma(picture)[inside], grey[inside])[0, 1])


def test_content_and_edges_keep_light_and_dark_where_the_smoke_s_own_picture_has_them():
    free = likeness(*painted())
    assert abs(free) < 0.3
    assert likeness(*painted(content=10.0)) > 0.7
    assert likeness(*painted(laplacian=3e3)) > 0.5


def test_photorealism_keeps_the_picture_locally_affine_in_the_smoke_s_own():
    distances = []
    for weight in (0.0, 1e4):
        view, picture, grey = painted(photorealism=weight)
        content = grey[..., None].expand(-1, -1, 3)
        distances.append(float(photorealism_distance(picture, content, view.guide)))
    assert distances[1] < 0.2 * distances[0]
