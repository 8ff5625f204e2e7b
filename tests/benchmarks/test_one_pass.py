"""The comparison of a network with iterations, on a puff: in its losses and in its pictures."""

from dataclasses import replace

import numpy as np
import torch

from benchmarks.one_pass import Ways, measure_frame
from benchmarks.one_pass_pictures import SHOWN, Gallery
from tests.fixtures.smoke_fixtures import frame_of, puff, random_style
from tests.fixtures.stylize_fixtures import problem_of, quick_config, scene_of
from usdsmoke.core.generator.network import Generator


def test_iterations_lower_the_loss_of_noise_and_of_an_untrained_network() -> None:
    config = quick_config()
    problem = problem_of(puff(10), scene_of([frame_of(puff(10))], config), config)
    generator = Generator.new(torch.tensor([0.5, 0.3, 0.5]), 0)
    rows = measure_frame(problem, generator, [0], Ways(cold=[(8, 8)], after=[8]))
    noise, cold, network, after = (row.loss for row in rows)
    assert cold < noise and after < network
    assert [row.way for row in rows] == ["noise", "cold, 16 iterations", "network", "network + 8"]


def test_ways_are_drawn_from_the_sides_that_are_shown_with_their_colours() -> None:
    frame = frame_of(puff(10))
    light = np.zeros((*frame.density.values.shape, 3), np.float32)
    light[..., 1] = frame.density.values
    emission = replace(frame.density, name="emission", values=light, background=(0.0,) * 3)
    gallery, scene = Gallery(), scene_of([frame], quick_config())
    gallery.add_style("puff", random_style())
    gallery.add("puff", "network", frame.density, emission, scene)
    gallery.add("puff", "no such way", frame.density, emission, scene)
    drawn = [panel.picture for panel in gallery.rows["puff"][1:]]
    assert len(drawn) == len(SHOWN["network"])
    for picture in drawn:
        assert picture[..., 1].max() > 0 and picture[..., [0, 2]].max() == 0
