"""The seal of a look layer: blind to what does not matter, broken by every other edit."""

from pathlib import Path

import pytest
from pxr import Sdf

from tests.fixtures.usd_fixtures import make_look, plume_stage
from usdsmoke.usd.layer_record import LAYER_HASH, RECORD_HASH, layer_digest, record_digest


def sealed(layer: Sdf.Layer) -> tuple[bool, bool]:
    """Whether layer and record are as they were sealed."""
    record = layer.customLayerData["usdsmoke"]
    return (
        record[LAYER_HASH] == layer_digest(layer),
        record[RECORD_HASH] == record_digest(layer),
    )


def opened(tmp_path: Path, layer_format: str = "usda") -> Sdf.Layer:
    files = make_look(plume_stage(tmp_path / "in"), tmp_path / "out", layer_format=layer_format)
    return Sdf.Layer.OpenAsAnonymous(str(files.look_layer))


@pytest.mark.parametrize("layer_format", ["usda", "usdc"])
def test_a_look_that_was_written_is_sealed(tmp_path, layer_format):
    assert sealed(opened(tmp_path, layer_format)) == (True, True)


def test_both_formats_have_one_digest(tmp_path):
    first, second = opened(tmp_path / "a"), opened(tmp_path / "b", "usdc")
    assert layer_digest(first) == layer_digest(second)


def test_a_note_and_the_data_of_other_programs_break_nothing(tmp_path):
    layer = opened(tmp_path)
    layer.comment = "approved"
    layer.customLayerData = {**layer.customLayerData, "pipeline": {"version": 7}}
    assert sealed(layer) == (True, True)


def test_an_authored_value_breaks_the_layer_s_seal_alone(tmp_path):
    layer = opened(tmp_path)
    layer.GetAttributeAtPath("/World/smoke.usdSmoke:extinctionPerDensity").default = 2.0
    assert sealed(layer) == (False, True)


def test_stage_metadata_and_documentation_belong_to_the_layer(tmp_path):
    layer = opened(tmp_path)
    layer.documentation += " Edited."
    assert sealed(layer) == (False, True)


def test_an_edited_record_breaks_the_record_s_seal_alone(tmp_path):
    layer = opened(tmp_path)
    data = dict(layer.customLayerData)
    data["usdsmoke"] = {
        **data["usdsmoke"],
        "record": data["usdsmoke"]["record"].replace('"seed": 7', '"seed": 8'),
    }
    layer.customLayerData = data
    assert sealed(layer) == (True, False)
