"""A sum of six terms in place of many bounces, fitted to Mitsuba 3 on one smoke, tried on another.

    python -m benchmarks.light_bounces plume.0002.vdb [--report results/light_bounces.md]

Light that is scattered k more times arrives as if from smoke a^k as thick:

    L = sum over k of (b albedo s)^k p(g^(k+1)) exp(-a^k tau)

with s, the share of light from all around that the smoke around a voxel takes away. The constants a
and b are those of the least rms error of the mean light on a lumpy ball; ``core.views.bounces``
holds them. The table's errors are the model's (``optics.bounces``), and those on the smoke of the
file are what counts.
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.circumstances import circumstances
from benchmarks.lights import field_of, lumpy_ball, our_picture
from usdsmoke.base.volume import DenseField, LightSource, Scattering
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.core.smoke.active import activate
from usdsmoke.core.views.bounces import KEPT, SOFTER, TERMS
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.lighting import light_smoke
from usdsmoke.core.views.project import colour_map
from usdsmoke.core.views.scene import fit_view
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.work_precision.path_tracer import MOST_BOUNCES, TracedSmoke

DEPTHS = (1.0, 4.0, 10.0)  # that are fitted
OPAQUE = 30.0  # of the default setting
SIDES = ((0.8, 0.5, 0.33), (0.3, 0.4, -0.87))  # the sun's: beside the eye, opposite it
SMALL = 24  # voxels of the ball, a side
A, B = np.arange(0.3, 0.81, 0.1), np.arange(0.4, 1.21, 0.1)


@dataclass(frozen=True, eq=False)
class _Case:
    """One smoke under one sun."""

    name: str
    depth: float
    scattering: Scattering
    field: DenseField
    gamma_w: float
    view: View

    def reference(self, samples: int) -> float:
        traced = TracedSmoke(self.field, self.gamma_w, self.scattering)
        return float(traced.lit(self.view, samples, 0, MOST_BOUNCES).mean())

    def terms(self, a: float) -> np.ndarray:
        """Mean picture of each term but for b, [K]; the first is light that is scattered once."""
        smoke = activate(self.field, np.eye(4), torch.device("cpu"))
        image, _ = colour_map(
            smoke.positions, smoke.density, smoke.edges, self.gamma_w, self.view, smoke.voxel_size
        )
        dome = Scattering((LightSource("/sky", (1.0, 1.0, 1.0)),), 1.0)
        around = light_smoke(smoke, self.gamma_w, dome)
        assert around is not None
        taken = 1 - around.on(smoke.positions).scattered(self.view.forward)[:, :1]
        found = []
        for k in range(TERMS):
            softer = replace(self.scattering, anisotropy=self.scattering.anisotropy ** (k + 1))
            lit = light_smoke(smoke, self.gamma_w * a**k, softer)
            assert lit is not None
            light = lit.on(smoke.positions).scattered(self.view.forward)
            found.append(float(image.apply(light * (self.scattering.albedo * taken) ** k).mean()))
        return np.array(found)

    def modelled(self, bounces: bool) -> float:
        """Mean picture by the model."""
        scattering = replace(self.scattering, bounces=bounces)
        return float(our_picture(self.field, self.gamma_w, scattering, self.view).mean())


def _cases(
    name: str, field: DenseField, gs: Sequence[float], depths: Sequence[float]
) -> Iterator[_Case]:
    smoke = activate(field, np.eye(4), torch.device("cpu"))
    view = orbit_view(0.0, 0.0, "Y", np.zeros(3), 1, 1, smoke.voxel_size)
    view = fit_view(view, smoke)
    image, alpha = colour_map(smoke.positions, smoke.density, smoke.edges, 1e-6, view, 1.0)
    del image
    thickest = float(alpha.max()) / 1e-6
    for depth in depths:
        for albedo in (0.5, 0.9):
            for side in SIDES:
                for g in gs:
                    towards = np.array(side) / np.linalg.norm(side)
                    sun = LightSource("/sun", (1.0, 1.0, 1.0), tuple(towards.tolist()))
                    scattering = Scattering((sun,), albedo, g)
                    yield _Case(name, depth, scattering, field, depth / thickest, view)


def _rms(ratios: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.log(ratios) ** 2)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit, try, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("vdb", help="a frame of smoke, with a grid density")
    parser.add_argument("--samples", type=int, default=8, help="a pixel")
    parser.add_argument("--report", type=Path)
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    (density,) = read_grids(given.vdb, [GridRequest("density")], GridsConfig())
    fitted = list(_cases("ball", field_of(lumpy_ball(SMALL)), (0.0,), DEPTHS))
    other = list(_cases("file", density, (0.0, 0.6), (*DEPTHS, OPAQUE)))
    references = {case: case.reference(given.samples) for case in (*fitted, *other)}
    terms = {(case, a): case.terms(a) for case in fitted for a in A}
    powers = np.arange(TERMS)
    errors = {
        (a, b): _rms([float(terms[case, a] @ b**powers) / references[case] for case in fitted])
        for a in A
        for b in B
    }
    a, b = min(errors, key=lambda pair: errors[pair])
    rows, ratios = [], dict[str, list[tuple[float, float]]]()
    for case in (*fitted, *other):
        once, summed = (case.modelled(more) / references[case] for more in (False, True))
        ratios.setdefault(case.name, []).append((once, summed))
        rows.append(
            f"| {case.name} | {case.depth:g} | {case.scattering.albedo} | "
            f"{case.scattering.anisotropy} | {once - 1:+.0%} | {summed - 1:+.0%} |"
        )
        print(rows[-1], flush=True)
    said = [
        f"{name}: rms {_rms([once for once, _ in pairs]):.0%} scattered once, "
        f"{_rms([summed for _, summed in pairs]):.0%} with {TERMS} terms"
        for name, pairs in ratios.items()
    ]
    assert math.isclose(a, SOFTER) and math.isclose(b, KEPT), "fit the model's constants anew"
    lines = [
        "# Bounces of light as a sum of terms",
        "",
        f"Mean light of a picture against Mitsuba with {MOST_BOUNCES} bounces. Fitted on the ball:",
        f"a = {a:.1f}, b = {b:.1f}. {'; '.join(said)}.",
        "",
        "| smoke | optical depth | albedo | g | scattered once | six terms |",
        "| --- | --- | --- | --- | --- | --- |",
        *rows,
        "",
        *circumstances(["python", "-m", "benchmarks.light_bounces", given.vdb]),
    ]
    print("\n".join(lines[2:4]))
    if given.report:
        given.report.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
