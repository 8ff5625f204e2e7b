"""A puff of smoke and cameras that look at it."""

import dataclasses
from typing import Any

import numpy as np

from tests.smoke_fixtures import frame_of, puff
from usdsmoke.base.volume import CameraSource, VolumeFrame
from usdsmoke.core.views.cameras import View, view_of_camera

__all__ = ["DENSITY", "FRAME", "MIDDLE", "N", "camera_picture", "looking", "seen_by"]

N = 24
DENSITY = puff(N)
FRAME = frame_of(DENSITY)
MIDDLE = np.full(3, (N - 1) / 2)


def looking(
    eye: Any, at: Any, film: float = 36.0, parallel: bool = False, roll_up: Any = (0, 1, 0)
) -> CameraSource:
    """A camera with a square film that looks from one place at another; 36 mm of focal length."""
    back = np.subtract(eye, at) / np.linalg.norm(np.subtract(eye, at))
    right = np.cross(roll_up, back)
    right /= np.linalg.norm(right)
    place = np.eye(4)
    place[:3, :3] = [right, np.cross(back, right), back]
    place[3, :3] = eye
    return CameraSource("/camera", place, 36.0, film, film, 0.0, 0.0, (0.1, 1e4), parallel)


def camera_picture(
    place: np.ndarray, focal_length: float, film: float, height: int, width: int
) -> View:
    """What a perspective camera shows; the film is as wide as the picture."""
    camera = CameraSource("/camera", place, focal_length, film, film, 0.0, 0.0, (0.1, 1e4))
    return view_of_camera(camera, height, width)


def seen_by(camera: CameraSource, frame: VolumeFrame = FRAME) -> VolumeFrame:
    """The frame through a camera."""
    return dataclasses.replace(frame, camera=camera)
