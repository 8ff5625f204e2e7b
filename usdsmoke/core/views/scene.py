"""Extinction and image scale, measured once for all frames of a shot.

If they were measured for every frame, exposure and the style's size would jump.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from usdsmoke.base.errors import ShapeError
from usdsmoke.base.volume import CameraSource, VolumeFrame
from usdsmoke.config.look_sections import OpticsConfig, ViewsConfig
from usdsmoke.core.smoke.levels import bounded
from usdsmoke.core.smoke.schedule import SIDEWAYS, pool_size, view_ranges
from usdsmoke.core.smoke.thicken import Thickening
from usdsmoke.core.smoke.voxels import Placed, Voxels, occupied
from usdsmoke.core.views.cameras import View, camera_orbit, orbit_view, sample_angles
from usdsmoke.core.views.column_depths import (
    SeenSmoke,
    checked_extinctions,
    column_percentile,
    find_curve,
    weighted_median,
)
from usdsmoke.core.views.frustum import nearest_footprint, visible_part

if TYPE_CHECKING:
    from usdsmoke.core.smoke.active import ActiveSmoke

PICTURE_MARGIN = 2  # pixels around the smoke
LEAST_OPACITY = 1e-12  # thinner smoke is not brightened: float32 pictures hold no more
TINY = 1e-300  # in place of 0 in a quotient
LEAST_PIXELS = 16  # along the smoke, even if the camera is far away: fewer hold no structure
EXPOSED_OPACITY = 0.7  # thick columns with less opacity are exposed to this one


@dataclass(frozen=True)
class Scene:
    """Lengths in stage units, extinctions in 1/stage unit per density."""

    gamma_w: float  # colour step
    gamma_w_shape: float  # shape step
    pixel_size: float  # of the finest octave's pictures
    up_axis: str
    reference_voxel_size: float  # of the source, before any refinement; gamma = gamma_w * this
    image_size: int  # pixels of the largest picture's longer side, which the style is scaled to
    grey_mean: float = 0.5  # of the grey pictures inside the smoke; grey styles are matched to it
    grey_deviation: float = 0.2
    exposure: float = 1.0  # brightens the pictures of thin smoke, >= 1: colour step
    exposure_shape: float = 1.0
    camera: CameraSource | None = None  # of the current frame; None: around up
    thick: float = 0.0  # column of the thick ones, density x stage unit; 0: not measured
    thick_share: float = 1.0  # share of all columns with smoke that are as thick
    # Longer side of the pictures over that of pictures of the largest lump of smoke alone, where
    # pixels are larger because of the rest; else 1.
    widened: float = 1.0
    hidden: float = 0.0  # share of the mass in far thicker columns than ``thick``, if many
    stops: float = 0.0  # exposure of the pictures: 2^stops times the light of the stage
    misfit: str = ""  # why frames do not start from the network that they should; "": they do
    network: str = ""  # SHA-256 of the network's file that the run has trained; "": none
    thicken: float = 1.0  # times that the thinnest smoke becomes as dense
    knee: float = 0.0  # density, of the curve of thickening; 0: density stays as it is
    refine: int = 1  # subdivisions of the source's voxels along an axis
    style_size: float = 1.0  # size of the style, if ``style.size`` is unset
    style_refine: int = 0  # ``grids.refine`` with which that would be less; 0: none is known
    # Visible voxels of the largest frame, refined: they decide what the shape step moves, in all
    # frames alike. In a run they are the plan's, of the frames that ``optics.frames`` names or all
    most_voxels: int = 0
    is_coarse_step: bool = False  # whose finest octave is a coarse one of the windows

    @property
    def thickening(self) -> Thickening | None:
        """What is done to the density of the source; None: nothing."""
        return Thickening(self.thicken, self.knee) if self.knee > 0 else None

    @property
    def voxels(self) -> float:
        """Of the source, along the longer side of the largest picture."""
        return self.image_size * self.pixel_size / self.reference_voxel_size

    def without_thickening(self) -> "Scene":
        """The scene for smoke that is thickened already."""
        return replace(self, knee=0.0)

    def coarser(self, factor: float) -> "Scene":
        """The scene for voxels and pixels that are so many times as wide; slabs count as less."""
        return replace(
            self,
            pixel_size=self.pixel_size * factor,
            image_size=max(1, round(self.image_size / factor)),
            most_voxels=round(self.most_voxels / factor**3),
        )


def _corners(smoke: Placed) -> np.ndarray:
    """The eight corners of the active box, half a voxel padded, [8 3], stage space."""
    low, high = smoke.box
    choice = np.array([[n >> 2 & 1, n >> 1 & 1, n & 1] for n in range(8)])
    ijk = np.where(choice, high + 0.5, low - 0.5)
    return ijk @ smoke.index_to_stage[:3, :3] + smoke.index_to_stage[3, :3]


def fit_view(view: View, smoke: Placed, margin: int = PICTURE_MARGIN) -> View:
    """The same orthographic view, moved and sized so that its image just contains the smoke."""
    corners = _corners(smoke)
    across, up = (corners @ axis for axis in (view.right, view.up))
    middle = corners.mean(0)  # from any direction, the box is symmetric around it
    width, height = (
        max(1, math.ceil(float(np.ptp(side)) / view.pixel_size - 1e-6)) + 2 * margin
        for side in (across, up)
    )
    return View(
        view.right, view.up, view.forward, middle, height, width, view.pixel_size,
        azimuth=view.azimuth, elevation=view.elevation,
    )  # fmt: skip


def crop_view(view: View, smoke: "ActiveSmoke", margin: int = PICTURE_MARGIN) -> View:
    """Like ``fit_view``, but around the voxels themselves: a cut leaves their box half empty."""
    axes = np.stack([view.right, view.up, view.forward])
    places = smoke.outline @ axes.T
    half = 0.5 * np.abs(smoke.index_to_stage[:3, :3] @ axes.T).sum(0)  # of a voxel
    low, high = places.min(0) - half, places.max(0) + half
    width, height = (
        max(1, math.ceil(float(side) / view.pixel_size - 1e-6)) + 2 * margin
        for side in (high - low)[:2]
    )
    return replace(view, centre=(low + high) / 2 @ axes, height=height, width=width)


def _trimmed(view: View, smoke: "ActiveSmoke") -> View:
    """The same pixels without those around the smoke, which a turned box leaves in its corners."""
    axes = np.stack([view.right, -view.up])
    half = 0.5 * np.abs(smoke.index_to_stage[:3, :3] @ axes.T).sum(0)  # of a voxel
    places = smoke.outline @ axes.T - view.centre @ axes.T
    size = np.array([view.width, view.height])
    low, high = (
        np.rint((places.min(0) - half) / view.pixel_size + size / 2) - PICTURE_MARGIN,
        np.rint((places.max(0) + half) / view.pixel_size + size / 2) + PICTURE_MARGIN,
    )
    low, high = np.maximum(low, 0), np.minimum(high, size)
    moved = ((low + high - size) / 2 * view.pixel_size) @ axes
    width, height = (int(n) for n in high - low)
    return replace(view, centre=view.centre + moved, height=height, width=width)


def face_view(smoke: Placed, up_axis: str, pixel_size: float) -> View:
    """The view perpendicular to a slab one voxel thick: pixels are aligned with its axes."""
    axis = smoke.thin_axis
    if axis is None:
        raise ShapeError("the smoke is not one voxel thick along exactly one axis. Use orbit_view.")
    sides = [smoke.index_to_stage[n, :3] for n in range(3) if n != axis]
    world_up = np.array([0.0, 1.0, 0.0] if up_axis == "Y" else [0.0, 0.0, 1.0])
    sides.sort(key=lambda side: abs(side @ world_up) / np.linalg.norm(side))
    up = sides[1] * (1.0 if sides[1] @ world_up >= 0 else -1.0)
    up = up / np.linalg.norm(up)
    right = sides[0] - (sides[0] @ up) * up
    right = right / np.linalg.norm(right)
    if right[np.argmax(np.abs(right))] < 0:
        right = -right
    view = View(right, up, np.cross(up, right), np.zeros(3), 1, 1, pixel_size)
    return fit_view(view, smoke)


def frame_views(
    smoke: "ActiveSmoke",
    views: ViewsConfig,
    scene: Scene,
    seed: int,
    factor: int = 1,
    n_aside: int = 0,
) -> list[View]:
    """The pool of views of one frame and octave, each just large enough for the smoke.

    With a camera they lie around its own direction, without one around the stage's up axis.

    Args:
        smoke: determines the images' extent; smoke one voxel thick gets a single face-on view.
        views: angles and their number; ranges of 0 leave one view, whatever the pool's size.
        factor: pixels are this many times the scene's.
        n_aside: the last so many of the views are from the other sides, see ``angles_aside``.
    """
    pixel_size = scene.pixel_size * factor
    if smoke.thin_axis is not None:
        return [face_view(smoke, scene.up_axis, pixel_size)]
    angles = sample_angles(views, pool_size(views), seed, n_aside)
    if scene.camera is not None:
        target = _middle(smoke.voxels)
        return [
            crop_view(camera_orbit(scene.camera, float(a), float(e), target, pixel_size), smoke)
            for a, e in angles
        ]
    around = (
        orbit_view(float(a), float(e), scene.up_axis, np.zeros(3), 1, 1, pixel_size)
        for a, e in angles
    )
    return [_trimmed(fit_view(view, smoke), smoke) for view in around]


def _middle(smoke: Voxels) -> np.ndarray:
    """Centre of mass [3]: unlike a box's centre, it does not jump when a wisp becomes visible."""
    density = bounded(smoke).density.astype(np.float64)
    found: np.ndarray = density @ smoke.positions / density.sum()
    return found


def _middle_view(
    smoke: Voxels,
    views: ViewsConfig,
    up_axis: str,
    pixel_size: float,
    camera: CameraSource | None = None,
) -> View:
    if smoke.thin_axis is not None:
        return face_view(smoke, up_axis, pixel_size)
    azimuth, elevation = views.centre_azimuth, views.centre_elevation
    if camera is not None:
        view = camera_orbit(camera, azimuth, elevation, _middle(smoke), pixel_size)
    else:
        view = orbit_view(azimuth, elevation, up_axis, np.zeros(3), 1, 1, pixel_size)
    return fit_view(view, smoke)


def _seen_smoke(
    smoke: Sequence[tuple[Voxels, CameraSource | None, float]],
    views: ViewsConfig,
    up_axis: str,
    coarse: float,
) -> list[SeenSmoke]:
    """The main part of each frame's smoke, from the middle view.

    Args:
        smoke: with its camera, and the density of the floor of all of the frame.
        coarse: pixels, stage units.
    """
    found = []
    for part, camera, floor in smoke:
        main = part.main_part()
        found.append(SeenSmoke(main, _middle_view(main, views, up_axis, coarse, camera), floor))
    return found


def measure_scene(
    frames: Sequence[VolumeFrame],
    views: ViewsConfig,
    optics: OpticsConfig,
    up_axis: str,
    refine: int = 1,
) -> Scene:
    """Extinction and pixel size from a few frames of the shot; empty frames are skipped.

    An unset ``optics.gamma`` is chosen so that the thick columns (``optics.percentile``) have the
    optical depth ``optics.depth``, seen from the middle view, in the median of the frames, which
    count by how many voxels they have; likewise ``gamma_shape``. A set gamma is per voxel, the
    paper's meaning, and is divided by the voxel size. Where it leaves the thick columns fainter
    than an opacity of 0.7, the pictures are exposed to that: the paper divides each by its own
    maximum, after which exposure jumps with the frame.
    With cameras, columns are those that they see, and no pixel is finer than their nearest ones.
    Remains far away widen the pictures, but are no columns. ``optics.thicken`` is applied before.

    Args:
        frames: sampled over the *whole* shot, so that windows and machines agree.
        views, optics: see above.
        up_axis: "Y" or "Z".
        refine: subdivisions of the source's voxels along an axis.

    Returns:
        The scene; with defaults if all frames are empty.
    """
    filled, stops = _filled(frames), optics.exposure or 0.0
    if not filled:
        return Scene(1.0, 1.0, 1.0, up_axis, 1.0, views.image_size, stops=stops, refine=refine)
    voxel = float(np.median([smoke.voxel_size for smoke, _ in filled]))
    longest, near = _picture_sides(filled, views, up_axis)
    whole = [(smoke, camera, smoke.floor) for smoke, camera in filled]
    parts = [(visible_part(s, c, views.camera_margin), c, floor) for s, c, floor in whole]
    shown = [item for item in parts if not item[0].is_empty]
    visible = [item[:2] for item in shown]
    shortest = float(np.median([smoke.shortest_edge for smoke, _ in filled]))
    pixel_size = _pixel_size(longest, shortest, visible, views, refine)
    fine = _pixel_size(near, shortest, visible, views, refine) if near < longest else pixel_size
    seen = _seen_smoke(shown or whole, views, up_axis, max(fine, voxel))
    curve = find_curve(seen, optics)
    columns = [one.columns(curve) for one in seen]
    thick = column_percentile(columns, seen, optics.percentile)
    pairs = zip(columns, seen, strict=True)
    share = weighted_median([float((c >= thick).sum() / one.n_columns) for c, one in pairs], seen)
    asked = ((optics.gamma, optics.depth), (optics.gamma_shape, optics.depth_shape))
    gamma_w, gamma_w_shape = checked_extinctions(
        depth / max(thick, TINY) if gamma is None else gamma / voxel for gamma, depth in asked
    )
    exposure, exposure_shape = (_exposure(gamma, thick) for gamma in (gamma_w, gamma_w_shape))
    grey = -np.expm1(-gamma_w_shape * np.concatenate(columns)) * exposure_shape
    inside = grey[grey > 0.3] if (grey > 0.3).any() else grey
    return Scene(
        gamma_w, gamma_w_shape, pixel_size, up_axis, voxel, math.ceil(longest / pixel_size - 1e-6),
        float(inside.mean()), float(inside.std()), exposure, exposure_shape,
        thick=thick, thick_share=share, widened=longest / near if fine < pixel_size else 1.0,
        hidden=weighted_median([one.hidden_mass(curve, thick) for one in seen], seen),
        stops=stops, thicken=curve.times if curve else 1.0, knee=curve.knee if curve else 0.0,
        most_voxels=max(_n_refined(part, refine) for part, _, _ in parts), refine=refine,
    )  # fmt: skip


def thick_column(
    smoke: "ActiveSmoke", views: ViewsConfig, scene: Scene, percentile: float
) -> float:
    """This percentile of a frame's column integrals from the middle view, density x stage unit.

    Args:
        smoke: of the frame, not empty.
        scene: its own, with its camera.
    """
    coarse = max(scene.pixel_size, scene.reference_voxel_size)
    voxels = smoke.voxels.main_part()
    view = _middle_view(voxels, views, scene.up_axis, coarse, scene.camera)
    return float(np.percentile(SeenSmoke(voxels, view).columns(), percentile))


def frame_scene(scene: Scene, gamma: float | None) -> Scene:
    """The scene with the colour step's extinction and exposure that one frame's gamma asks for.

    gamma_w = gamma / reference voxel size; the exposure follows from it and the *shot's*
    thick columns, so it changes as smoothly as gamma does and not with the frame's smoke.

    Args:
        scene: measured; returned as it is where gamma is unset.
        gamma: ``optics.gamma`` of the frame, per voxel.
    """
    if gamma is None:
        return scene
    gamma_w = gamma / scene.reference_voxel_size
    exposure = _exposure(gamma_w, scene.thick) if scene.thick > 0 else scene.exposure
    return replace(scene, gamma_w=gamma_w, exposure=exposure)


def _exposure(gamma_w: float, thick: float) -> float:
    return max(1.0, EXPOSED_OPACITY / max(-math.expm1(-gamma_w * thick), LEAST_OPACITY))


def _filled(frames: Sequence[VolumeFrame]) -> list[tuple[Voxels, CameraSource | None]]:
    """Every frame's smoke, where there is any, and its camera."""
    pairs = [(occupied(frame.density, frame.density_to_stage), frame.camera) for frame in frames]
    return [(smoke, camera) for smoke, camera in pairs if not smoke.is_empty]


def _n_refined(smoke: Voxels, refine: int) -> int:
    """Number of voxels after a subdivision, which leaves thin axes alone."""
    low, high = smoke.box if not smoke.is_empty else (np.zeros(3), np.zeros(3))
    return len(smoke.ijk) * refine ** int((high > low).sum())


def _pixel_size(
    longest: float,
    shortest: float,
    visible: Sequence[tuple[Voxels, CameraSource | None]],
    views: ViewsConfig,
    refine: int,
) -> float:
    """Of the finest octave's pictures, stage units; ``visible`` is each camera's visible smoke."""
    # whole voxels a pixel: with any other pitch, voxels have to be split (``footprint``)
    fine = shortest / refine
    finest = min((nearest_footprint(*pair, views.camera_width) for pair in visible), default=0.0)
    asked = round(longest / views.image_size / fine)
    resolved = min(math.ceil(finest / fine - 1e-6), math.floor(longest / LEAST_PIXELS / fine))
    return fine * max(1, asked, resolved)


def _picture_sides(
    filled: Sequence[tuple[Voxels, CameraSource | None]], views: ViewsConfig, up_axis: str
) -> tuple[float, float]:
    """Longest side of all pictures, stage units, of the smoke and of its largest lump."""
    sides = [
        [
            _longest_side(part, views, up_axis, camera)
            for part in (smoke, smoke.main_part().largest_lump())
        ]
        for smoke, camera in filled
    ]
    longest, near = np.max(sides, axis=0).tolist()
    return longest, near


def _longest_side(
    smoke: Voxels, views: ViewsConfig, up_axis: str, camera: CameraSource | None
) -> float:
    """Of the pictures, stage units; views all round see smoke from the side as well."""
    shown = [_middle_view(smoke, views, up_axis, 1e-3 * smoke.voxel_size, camera)]
    if camera is None and smoke.thin_axis is None and view_ranges(views)[0] > SIDEWAYS:
        aside = views.replace(centre_azimuth=views.centre_azimuth + 90.0)
        shown.append(_middle_view(smoke, aside, up_axis, 1e-3 * smoke.voxel_size))
    return max(max(view.height, view.width) * view.pixel_size for view in shown)
