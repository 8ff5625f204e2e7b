"""One frame stylized by the core of this checkout or of be60f8a, for ``error_against_time``.

    PYTHONPATH=CHECKOUT python benchmarks/core_run.py JOB.pickle RESULT.pickle

be60f8a is the version before the error budget held true errors. Job and result are plain values
and arrays, which both versions read.
"""

import pickle
import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch

VIEW = ("right", "up", "forward", "centre", "height", "width", "pixel_size")


def main() -> None:
    """Read the job, run it, write the result."""
    job = pickle.loads(Path(sys.argv[1]).read_bytes())
    torch.set_num_threads(1)
    is_new = find_spec("usdsmoke.core.sequence") is not None
    result = _run_new(job) if is_new else _run_be60f8a(job)
    Path(sys.argv[2]).write_bytes(pickle.dumps(result))


def _run_new(job: dict[str, Any]) -> dict[str, Any]:
    from usdsmoke.base.volume import DenseField, VolumeFrame
    from usdsmoke.config.resolve import resolve_config
    from usdsmoke.core.sequence.error_estimates import painted_frame
    from usdsmoke.core.sequence.frame_loop import run_frames
    from usdsmoke.core.sequence.frame_state import make_context
    from usdsmoke.core.sequence.picture_errors import fit_blocks
    from usdsmoke.core.sequence.stylize import stylized_frame
    from usdsmoke.core.views.cameras import orbit_view
    from usdsmoke.core.views.scene import fit_view, measure_scene

    frame = VolumeFrame(1.0, DenseField("density", *job["density"]), np.eye(4))
    # the smoke as it is, as be60f8a sees it and the truth has it
    config = resolve_config(*job["settings"], "optimize.threads=1", "optics.thicken=1")
    begun = time.process_time()
    scene = measure_scene([frame], config.views, config.optics, "Y", config.grids.parts)
    context = make_context([job["style"]], scene, config, None, 24.0, None, 1)
    (done,) = run_frames([frame], context)
    result = stylized_frame(done, context)
    seconds = time.process_time() - begun

    def seen_from(angles: tuple[float, float]) -> Any:
        view = orbit_view(*angles, "Y", np.zeros(3), 1, 1, scene.pixel_size)
        return fit_blocks(fit_view(view, done.smoke))

    painted = painted_frame(done, seen_from(job["views"][0]))
    return {"seconds": seconds, **_found(job, done, result, scene, painted, seen_from)}


def _run_be60f8a(job: dict[str, Any]) -> dict[str, Any]:
    from usdsmoke.core.calibrate import calibrate
    from usdsmoke.core.chain import run_chain
    from usdsmoke.core.error_estimates import painted_frame
    from usdsmoke.core.picture_errors import fit_blocks
    from usdsmoke.core.scene import fit_view, measure_scene
    from usdsmoke.core.stylize import finished_frame, make_job, open_frame
    from usdsmoke.error_choice import choose_settings
    from usdsmoke.volume import DenseField, VolumeFrame

    from usdsmoke.config import Config, config_to_dict, resolve_config
    from usdsmoke.core.views import orbit_view

    frame, styles = (
        VolumeFrame(1.0, DenseField("density", *job["density"]), np.eye(4)),
        [job["style"]],
    )
    config = resolve_config(assignments=["optimize.threads=1"])
    begun = time.process_time()
    if job["tolerance"] is not None:
        measured = calibrate(frame, styles, config, "Y")
        planned = {"shape": Config().shape.iterations, "colour": Config().colour.iterations}
        chosen = choose_settings(measured, job["tolerance"], planned, {})
        config = resolve_config(config_to_dict(config), chosen.settings)
    scene = measure_scene([frame], config, "Y")
    context = make_job(styles, scene, config, None, 24.0, None, 1)
    (done,) = run_chain([frame], context, open_frame)
    result = finished_frame(done, context)
    seconds = time.process_time() - begun

    def seen_from(angles: tuple[float, float]) -> Any:
        view = orbit_view(*angles, "Y", np.zeros(3), 1, 1, scene.pixel_size)
        return fit_blocks(fit_view(view, done.smoke))

    found = _found(job, done, result, scene, painted_frame(done), seen_from)
    return {"seconds": seconds, **found}


def _found(
    job: dict[str, Any], done: Any, result: Any, scene: Any, painted: Any, seen_from: Any
) -> dict[str, Any]:
    """Fields, displacement and the version's own pictures; the first one at half the size too.

    Without a shape step the displacement is 0.
    """
    low, source = result.density.ijk_min, result.density.values
    u = np.zeros((*source.shape, 3), np.float32)
    if done.displacement is not None:
        lattice = done.displacement.lattice
        u = lattice.from_stage(done.displacement.values).numpy() / np.asarray(lattice.spacing)
        low, source = lattice.low, lattice.fill(done.source).numpy()
    views = [seen_from(angles) for angles in job["views"]]
    half = replace(
        views[0],
        pixel_size=2 * views[0].pixel_size,
        height=views[0].height // 2,
        width=views[0].width // 2,
    )
    return {
        "density": (result.density.values, tuple(map(int, result.density.ijk_min))),
        "emission": (result.emission.values, tuple(map(int, result.emission.ijk_min))),
        "index_to_world": np.asarray(result.density.index_to_world),
        "gamma_w": scene.gamma_w,
        "u": u,
        "low": tuple(map(int, low)),
        "source": source,
        "views": [{name: getattr(view, name) for name in VIEW} for view in views],
        "pictures": [painted.picture(view, scene.gamma_w).numpy() for view in views],
        "half": painted.halved().picture(half, scene.gamma_w).numpy(),
    }


if __name__ == "__main__":
    main()
