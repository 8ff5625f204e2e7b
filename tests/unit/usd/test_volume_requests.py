"""Requests on Volumes: composed like any opinion, anchored, checked; controls for each frame."""

import re
from pathlib import Path

import pytest
from pxr import Usd

from tests.fixtures.pipeline_fixtures import make_style
from tests.fixtures.usd_fixtures import HEADER, write_text
from usdsmoke.base.errors import AssetNotResolved, ConfigError, StageError
from usdsmoke.base.volume import FrameControls, StyleRequest
from usdsmoke.usd.schema import STYLE_API
from usdsmoke.usd.stage import open_stage
from usdsmoke.usd.volume_requests import read_request, request_origins, request_problems

_OPEN: list[Usd.Stage] = []  # a prim lives as long as its stage

APPLIED = f'prepend apiSchemas = ["{STYLE_API}"]'


def prim(body: str, kind: str = "def Volume", meta: str = APPLIED) -> str:
    """One prim /smoke; a request's name is given without its prefix, after its type."""
    body = re.sub(r"^(\s*\S+) @@", r"\1 usdSmoke:request:", body, flags=re.M)
    return f'{kind} "smoke" ({meta})\n{{\n{body}\n}}\n'


def volume(folder: Path, text: str, header: str = HEADER) -> Usd.Prim:
    _OPEN[:] = [open_stage(write_text(folder / "s.usda", header + text))]
    return _OPEN[0].GetPrimAtPath("/smoke")


def request(folder: Path, body: str, *codes: float) -> StyleRequest:
    return read_request(volume(folder, prim(body)), codes or (1.0,))[0]


def test_nothing_is_asked_for_by_applying_the_schema(tmp_path: Path) -> None:
    assert request(tmp_path, "") == StyleRequest()


def test_values_become_settings_of_their_sections(tmp_path: Path) -> None:
    found = request(
        tmp_path,
        """
        int64 @@seed = 7
        double @@strength = 0.3
        double[] @@styleWeights = [3, 1]
        token[] @@steps = ["colour"]
        int[] @@shapeIterations = [5, 0]
        token @@colourInit = "density"
        """,
    )
    assert found.settings == {
        "optimize": {"seed": 7, "strength": 0.3, "steps": ["colour"]},
        "style": {"weights": [3.0, 1.0]},
        "shape": {"iterations": [5, 0]},
        "colour": {"init": "density"},
    }


def test_without_the_schema_applied_attributes_do_not_count_and_are_listed(tmp_path: Path) -> None:
    found, controls = read_request(volume(tmp_path, prim("int64 @@seed = 7", meta="")), (1.0, 2.0))
    assert found == StyleRequest(ignored=("usdSmoke:request:seed",))
    assert controls == (FrameControls(), FrameControls())


def test_a_stronger_layer_wins_and_a_blocked_value_says_nothing(tmp_path: Path) -> None:
    write_text(tmp_path / "weak.usda", HEADER + prim("int64 @@seed = 1\nint @@styleTiling = 2"))
    header = HEADER.replace("(\n", "(\n    subLayers = [@./weak.usda@]\n", 1)
    text = prim("int64 @@seed = 2\nint @@styleTiling = None", kind="over", meta="")
    found = read_request(volume(tmp_path, text, header), (1.0,))[0]
    assert found.settings == {"optimize": {"seed": 2}}


@pytest.mark.parametrize("look", ["calm", "wild"])
def test_a_variant_chooses_the_request(tmp_path: Path, look: str) -> None:
    meta = f"""{APPLIED}
    variants = {{ string look = "{look}" }}
    prepend variantSets = "look"
    """
    body = """
    variantSet "look" = {
        "calm" {
            int64 usdSmoke:request:seed = 1
        }
        "wild" {
            int64 usdSmoke:request:seed = 2
        }
    }
    """
    found = read_request(volume(tmp_path, prim(body, meta=meta)), (1.0,))[0]
    assert found.settings == {"optimize": {"seed": {"calm": 1, "wild": 2}[look]}}


def test_a_class_is_inherited_with_its_schema_and_weaker_than_the_prim(tmp_path: Path) -> None:
    text = f"""
class "_fire" ({APPLIED}) {{
    int64 usdSmoke:request:seed = 3
    int usdSmoke:request:windowSize = 5
}}
""" + prim("int64 @@seed = 4", meta="prepend inherits = </_fire>")
    found = read_request(volume(tmp_path, text), (1.0,))[0]
    assert found.settings == {"optimize": {"seed": 4}, "windows": {"size": 5}}


def test_images_are_anchored_to_the_layer_that_names_them(tmp_path: Path) -> None:
    image = make_style(tmp_path / "asset/tex/fire.png")
    body = prim("asset[] @@styleImages = [@./tex/fire.png@]", kind="def Volume")
    write_text(tmp_path / "asset/smoke.usda", HEADER + body)
    text = prim("", kind="def", meta="prepend references = @../asset/smoke.usda@</smoke>")
    found = read_request(volume(tmp_path / "shot", text), (1.0,))[0]
    assert found.styles == (str(image),)


def test_an_image_that_is_not_there_names_prim_attribute_path_and_layer(tmp_path: Path) -> None:
    with pytest.raises(
        AssetNotResolved,
        match=r"</smoke\.usdSmoke:request:styleImages> names @\./no\.png@, authored in .*s\.usda",
    ):
        request(tmp_path, "asset[] @@styleImages = [@./no.png@]")


def test_time_samples_are_interpolated_into_a_control_for_each_frame(tmp_path: Path) -> None:
    body = """
    double @@strength.timeSamples = { 1: 0, 5: 1 }
    double[] @@styleWeights.timeSamples = { 1: [1, 0], 3: [0, 1] }
    double @@gamma.timeSamples = { 1: 0.5, 9: 0.5 }
    """
    found, controls = read_request(volume(tmp_path, prim(body)), (1.0, 2.0, 5.0))
    assert [control.strength for control in controls] == [0.0, 0.25, 1.0]
    assert [control.style_weights for control in controls] == [(1, 0), (0.5, 0.5), (0, 1)]
    assert [control.gamma for control in controls] == [None] * 3  # it does not change
    assert found.settings == {
        "optimize": {"strength": 1.0},  # the largest: is there any effect?
        "style": {"weights": [1.0, 0.0]},
        "optics": {"gamma": 0.5},
    }


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            "double @@reach = 0.7",
            r"is 0\.7 \(from </smoke\.usdSmoke:request:reach>\).* at most 0\.5",
        ),
        ('token @@displacement = "swirl"', "is 'swirl' .*displacement>.* stream"),
        ("swirl @@strength = 0.5", r"0\.5.*strength>"),  # a type that USD does not know
        ('string @@seed = "one"', "is 'one' .*seed>"),
        ("int[] @@shapeIterations = []", r"is \[\] .*shapeIterations>.* one or more"),
        ("double @@stength = 1", "'usdSmoke:request:strength'"),
        ("double @@camera = 1", "camera> is an attribute.* a relationship"),
        ("int64 @@seed.timeSamples = { 1: 1, 2: 2 }", r"seed> changes over time .*timeCode 2\b"),
        (
            "double @@strength.timeSamples = { 1: 1, 2: 2 }",
            r"is 2\.0 \(from .*strength> at timeCode 2\).* 0 to 1",
        ),
    ],
)
def test_a_wrong_request_is_refused_by_prim_and_attribute(
    tmp_path: Path, body: str, message: str
) -> None:
    smoke = volume(tmp_path, prim(body))
    with pytest.raises(ConfigError, match=message):
        read_request(smoke, (1.0, 2.0))
    assert any(re.search(message, text) for text in request_problems(smoke).values())


def test_time_samples_that_do_not_change_are_no_change(tmp_path: Path) -> None:
    body = "int64 @@seed.timeSamples = { 1: 6, 2: 6 }"
    assert request(tmp_path, body, 1.0, 2.0).settings == {"optimize": {"seed": 6}}


def test_a_relationship_with_two_targets_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StageError, match=r"request:mask> has 2 targets \(</a>, </b>\)"):
        request(tmp_path, "rel @@mask = [</a>, </b>]")


def test_the_mask_is_named_by_the_volumes_own_relationship_where_there_is_one(
    tmp_path: Path,
) -> None:
    rel = "rel @@mask = </smoke/fade>\n"
    own = request(tmp_path, rel + "rel field:fade = </smoke/fade>")
    assert own.settings == {"stage": {"mask": "fade"}}
    foreign = request(tmp_path / "b", rel)
    assert foreign.settings == {"stage": {"mask": "usdSmoke:request:mask"}}


def test_the_camera_is_named_by_its_path(tmp_path: Path) -> None:
    found = request(tmp_path, "rel @@camera = </shot/camera>")
    assert found.settings == {"views": {"camera": "/shot/camera"}}


def test_origins_name_the_attribute_and_the_layer_of_the_strongest_opinion(tmp_path: Path) -> None:
    weak = write_text(
        tmp_path / "weak.usda", HEADER + prim("int64 @@seed = 1\nint @@iterations = 2")
    )
    header = HEADER.replace("(\n", "(\n    subLayers = [@./weak.usda@]\n", 1)
    smoke = volume(tmp_path, prim("int64 @@seed = 2", kind="over", meta=""), header)
    origins = request_origins(smoke)
    assert origins["optimize.seed"] == {
        "attribute": "/smoke.usdSmoke:request:seed",
        "layer": str(tmp_path / "s.usda"),
    }
    assert origins["optimize.iterations"]["layer"] == str(weak)
