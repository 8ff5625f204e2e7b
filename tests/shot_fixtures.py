"""A shot as departments assemble one: sublayers with offsets, references, payloads, variants.

shot/shot.usda            root: camera, materials, classes, the shot's own opinions
  shot/fx.usda            sublayer, 100 timeCodes later: references the plume, 10 later still
  shot/layout.usda        sublayer: an instanced asset, a Volume with its field elsewhere
assets/plume.usda         the fx asset: a payload and a variant set ``sim``
assets/steam.usda         the asset that is instanced
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.pipeline_fixtures import make_style
from tests.usd_fixtures import density_prim, sampled, write_text, write_vdb

__all__ = ["FOG", "PLUME", "BigShot", "make_big_shot"]

PLUME, FOG = "/World/fx/plume/smoke", "/World/set/fog"
_HEADER = """#usda 1.0
(
    timeCodesPerSecond = 25
    framesPerSecond = 25
    upAxis = "Z"
    metersPerUnit = 0.5
    defaultPrim = "{prim}"
    {more}
)
"""


@dataclass(frozen=True)
class BigShot:
    """Where everything is."""

    folder: Path
    stage: Path
    style: Path
    output: Path


def make_big_shot(folder: Path) -> BigShot:
    """The shot with its files; the plume has timeCodes 111 to 113, the fog has none."""
    for sim in ("wide", "narrow"):
        for code in (1, 2, 3):
            write_vdb(folder / f"in/assets/cache/{sim}.{code:04d}.vdb", value=0.5 + code / 8)
    for name in ("steam", "fog"):
        write_vdb(folder / f"in/assets/cache/{name}.vdb")
    _write_assets(folder / "in/assets")
    _write_layout(folder / "in/shot")
    _write_fx(folder / "in/shot")
    stage = _write_shot(folder / "in/shot")
    return BigShot(folder, stage, make_style(folder / "style.png"), folder / "out")


def _header(prim: str, more: str = "") -> str:
    return _HEADER.format(prim=prim, more=more)


def _files(sim: str, codes: Sequence[int] = (1, 2, 3)) -> str:
    names = {code: f"@./cache/{sim}.{code:04d}.vdb@" for code in codes}
    return sampled("asset filePath", names)


def _write_assets(folder: Path) -> None:
    variants = "".join(
        f"""
        "{sim}" {{
            over "fields"
            {{
                over "density"
                {{
                    {_files(sim)}
                }}
            }}
        }}"""
        for sim in ("wide", "narrow")
    )
    write_text(
        folder / "plume.usda",
        _header("Plume")
        + f"""
class "_class_plume"
{{
    double wind = 1
    double gust = 1
}}
def Xform "Plume" (
    kind = "component"
    payload = @./plume_payload.usda@</Plume>
    inherits = </_class_plume>
    variants = {{
        string sim = "narrow"
    }}
    prepend variantSets = "sim"
)
{{
    double gust = 2
    variantSet "sim" = {{{variants}
    }}
}}
""",
    )
    _write_payload(folder)
    write_text(
        folder / "steam.usda",
        _header("Steam")
        + f"""
def Xform "Steam"
{{
    def Volume "smoke"
    {{
        rel field:density = </Steam/smoke/density>
        {density_prim("asset filePath = @./cache/steam.vdb@")}
    }}
}}
""",
    )


def _write_payload(folder: Path) -> None:
    write_text(
        folder / "plume_payload.usda",
        _header("Plume")
        + f"""
def Xform "Plume"
{{
    def Volume "smoke" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        float3[] extent = [(-9, -9, -9), (9, 9, 9)]
        rel field:density = </Plume/fields/density>
        rel material:binding = </Plume/materials/fog>
    }}
    def Scope "fields"
    {{
        {density_prim("")}
    }}
    def Scope "materials"
    {{
        def Material "fog"
        {{
        }}
    }}
}}
""",
    )


def _write_layout(folder: Path) -> None:
    write_text(
        folder / "layout.usda",
        _header("World")
        + f"""
def Xform "World"
{{
    def Xform "set"
    {{
        def "steam" (
            instanceable = true
            prepend references = @../assets/steam.usda@
        )
        {{
            double3 xformOp:translate = (5, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }}
        def Volume "fog"
        {{
            rel field:density = </Caches/fog>
            pathExpression reach = "/World// /Materials//"
        }}
    }}
}}
def Scope "Caches"
{{
    {density_prim("asset filePath = @../assets/cache/fog.vdb@", "fog")}
}}
""",
    )


def _write_fx(folder: Path) -> None:
    write_text(
        folder / "fx.usda",
        _header("World")
        + """
over "World"
{
    def Xform "fx"
    {
        def "plume" (
            prepend references = @../assets/plume.usda@ (offset = 10)
            variants = {
                string sim = "wide"
            }
        )
        {
            double3 xformOp:translate.timeSamples = {
                11: (0, 0, 0), 13: (0, 0, 2)
            }
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }
    }
}
""",
    )


def _write_shot(folder: Path) -> Path:
    more = """startTimeCode = 111
    endTimeCode = 113
    customLayerData = {
        string shot = "sh010"
    }
    subLayers = [
        @./fx.usda@ (offset = 100),
        @./layout.usda@
    ]"""
    return write_text(
        folder / "shot.usda",
        _header("World", more)
        + """
class "_class_plume"
{
    double wind = 7
    double gust = 7
}
class "_class_light"
{
    float size = 1
    float power = 1
}
over "World"
{
    def Camera "camera" (
        inherits = </_class_light>
    )
    {
        float size = 2
        custom rel looksAt = [</World/fx/plume>, </Materials/dust>]
    }
    over "set"
    {
        over "fog" (
            prepend apiSchemas = ["MaterialBindingAPI"]
        )
        {
            rel material:binding = </Materials/dust>
        }
    }
}
def Scope "Materials"
{
    def Material "dust"
    {
        token outputs:volume.connect = </Shaders/dust.outputs:out>
    }
}
def Scope "Shaders"
{
    def Shader "dust"
    {
        token outputs:out
    }
}
""",
    )
