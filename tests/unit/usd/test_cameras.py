"""Cameras of a stage: composed values, refusals, and pictures that agree with Gf's frustum."""

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

from tests.fixtures.usd_fixtures import write_text
from usdsmoke.base.errors import StageError
from usdsmoke.core.views.cameras import view_of_camera
from usdsmoke.usd.stage import open_stage, read_camera

STAGE = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Z"
)
def Xform "rig"
{
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (20, 0, 0) }
    float3 xformOp:rotateXYZ = (10, 20, 30)
    float3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]

    def Camera "camera"
    {
        float focalLength.timeSamples = { 1: 35, 3: 85 }
        float horizontalAperture = 36
        float verticalAperture = 24
        float horizontalApertureOffset = 3
        float verticalApertureOffset = -2
        float2 clippingRange = (0.5, 400)
        double3 xformOp:translate = (1, -4, 2)
        float xformOp:rotateX = 75
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
    }

    def Camera "plan"
    {
        token projection = "orthographic"
        float horizontalAperture = 200
        float verticalAperture = 100
        float horizontalApertureOffset = 30
        float verticalApertureOffset = 10
    }

    def Xform "stretched" (
        kind = "group"
    )
    {
        matrix4d xformOp:transform = ((-2, 0, 0, 0), (0, 0, 1, 0), (0, -3, 0, 0), (4, 5, 6, 1))
        uniform token[] xformOpOrder = ["xformOp:transform"]

        def Camera "mirrored"
        {
        }
    }
}
def Xform "away" (
    active = false
)
{
}
"""
CAMERAS = ["/rig/camera", "/rig/plan", "/rig/stretched/mirrored"]


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    return open_stage(write_text(tmp_path_factory.mktemp("cameras") / "shot.usda", STAGE))


def pixels_of_gf(stage, path, time_code, points, height, width):
    """Where USD's own camera maths puts points, with the picture's width on the film's."""
    camera = UsdGeom.Camera(stage.GetPrimAtPath(path)).GetCamera(Usd.TimeCode(time_code))
    camera.verticalAperture = camera.horizontalAperture * height / width
    frustum = camera.frustum
    matrix = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())
    seen = np.c_[points, np.ones(len(points))] @ matrix
    seen = seen[:, :2] / seen[:, 3:]
    return np.stack([(seen[:, 0] + 1) / 2 * width, (1 - seen[:, 1]) / 2 * height], 1) - 0.5


def pixels_of_view(view, points):
    from_centre = points - view.centre
    depth = from_centre @ view.forward
    scale = 1 / view.pixel_size if view.focal is None else view.focal / depth
    x = view.width / 2 - 0.5 + view.shift[0] + scale * (from_centre @ view.right)
    y = view.height / 2 - 0.5 + view.shift[1] - scale * (from_centre @ view.up)
    return np.stack([x, y], 1)


def test_values_are_composed_at_the_time_code(stage):
    camera = read_camera(stage, "/rig/camera", 2.0)
    assert camera.prim_path == "/rig/camera"
    assert camera.focal_length == 60.0
    assert (camera.horizontal_aperture, camera.vertical_aperture) == (36.0, 24.0)
    assert (camera.horizontal_offset, camera.vertical_offset) == (3.0, -2.0)
    assert camera.clipping_range == (0.5, 400.0)
    assert not camera.is_orthographic
    turn = Gf.Matrix4d().SetRotate(
        Gf.Rotation((1, 0, 0), 10) * Gf.Rotation((0, 1, 0), 20) * Gf.Rotation((0, 0, 1), 30)
    )
    move = Gf.Matrix4d().SetTranslate((10, 0, 0))
    own = Gf.Matrix4d().SetRotate(Gf.Rotation((1, 0, 0), 75))
    own = own * Gf.Matrix4d().SetTranslate((1, -4, 2))
    wanted = own * Gf.Matrix4d().SetScale(2.0) * turn * move
    np.testing.assert_allclose(camera.camera_to_stage, np.array(wanted), atol=1e-12)


def test_what_is_not_authored_is_the_schemas(stage):
    camera = read_camera(stage, "/rig/stretched/mirrored", 1.0)
    assert camera.focal_length == 50.0
    assert camera.horizontal_aperture == pytest.approx(20.955)
    assert camera.clipping_range == (1.0, 1000000.0)


@pytest.mark.parametrize("path", CAMERAS)
@pytest.mark.parametrize("time_code", [1.0, 2.5])
@pytest.mark.parametrize(("height", "width"), [(90, 160), (101, 101), (300, 80)])
def test_points_land_where_usds_own_frustum_puts_them(stage, path, time_code, height, width):
    camera = read_camera(stage, path, time_code)
    view = view_of_camera(camera, height, width)
    points = np.random.default_rng(5).uniform(-3, 3, (50, 3)) + view.centre + 30 * view.forward
    found = pixels_of_view(view, points)
    wanted = pixels_of_gf(stage, path, time_code, points, height, width)
    assert np.ptp(wanted) > 1  # points that fall on one pixel would prove nothing
    np.testing.assert_allclose(found, wanted, atol=2e-3)  # Gf's own numbers are float32


@pytest.mark.parametrize(
    ("path", "found"),
    [
        ("/rig/none", "no prim </rig/none>"),
        ("/rig", "of type Xform"),
        ("rig/camera", "is not a prim path"),
        ("/rig/camera.focalLength", "is not a prim path"),
        ("/away", "is inactive"),
    ],
)
def test_a_missing_camera_is_refused_with_a_list_of_those_there_are(stage, path, found):
    with pytest.raises(StageError) as error:
        read_camera(stage, path, 1.0)
    assert found in str(error.value)
    assert all(f"<{camera}>" in str(error.value) for camera in CAMERAS)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("float focalLength = 0", "focalLength 0"),
        ("float horizontalAperture = -1", "horizontalAperture -1"),
        ("float verticalAperture = nan", "verticalAperture nan"),
        ("float horizontalApertureOffset = inf", "horizontalApertureOffset inf"),
        ("float2 clippingRange = (5, 5)", "clippingRange (5, 5)"),
        (
            'float3 xformOp:scale = (1, 0, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]',
            "singular",
        ),
        (
            "matrix4d xformOp:transform = ((1, 0, 0, .5), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))"
            '\nuniform token[] xformOpOrder = ["xformOp:transform"]',
            "perspective",
        ),
    ],
)
def test_a_camera_that_gives_no_picture_is_refused(tmp_path, line, found):
    text = f'#usda 1.0\ndef Camera "camera"\n{{\n{line}\n}}\n'
    stage = open_stage(write_text(tmp_path / "shot.usda", text))
    with pytest.raises(StageError) as error:
        read_camera(stage, "/camera", 1.0)
    assert found in str(error.value) and "</camera> at timeCode 1" in str(error.value)
