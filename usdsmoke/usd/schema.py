"""The codeless schemas UsdSmokeLookAPI and UsdSmokeStyleAPI: names, and making them known to USD.

Their source is schemas/usdSmoke/schema.usda; ``make schema`` makes the files in
``usdsmoke/plugin`` from it, which are part of the package.
"""

from pathlib import Path

from pxr import Plug, Usd

PLUGIN_FOLDER = Path(__file__).resolve().parents[1] / "plugin"

LOOK_API = "UsdSmokeLookAPI"  # the schemas' names, as they stand in apiSchemas
STYLE_API = "UsdSmokeStyleAPI"

EXTINCTION_PER_DENSITY = "usdSmoke:extinctionPerDensity"  # float, 1/(stage unit) per density
STAGE_UNITS = "usdSmoke:stageUnitsPerUnit"  # float, of that stage in one unit of the Volume's space
ALBEDO = "usdSmoke:albedo"  # float, of a look that lights of the stage light
ANISOTROPY = "usdSmoke:anisotropy"  # float, likewise
BOUNCES = "usdSmoke:bounces"  # bool, likewise
LIGHTS = "usdSmoke:lights"  # float3[], direction and colour in turn, of lights that settings name
SCATTER_FIELD = "usdSmoke:scatterField"  # token, relationship of the field that holds the albedo
EXPOSURE = "usdSmoke:exposure"  # float, stops
EMISSION_MODE = "usdSmoke:emissionMode"  # token
COLOR_SPACE = "usdSmoke:colorSpace"  # token
RUN = "usdSmoke:run"  # string
STYLE = "usdSmoke:style"  # string[], "name sha256" each
SEED = "usdSmoke:seed"  # int64

EMISSION_ABSOLUTE = "absolute"  # EMISSION_MODE: radiance per stage unit of length
EMISSION_PER_DENSITY = "perDensity"  # EMISSION_MODE: the same, divided by density
LIN_REC709 = "lin_rec709"  # COLOR_SPACE: scene-linear, Rec.709 primaries


def register_schema() -> bool:
    """Make the schemas known to this process; True when USD knows them afterwards.

    ``import usdsmoke`` does so too, as long as no stage was opened before.

    USD reads all schemas once, when the first stage is opened or the schema registry is first
    asked; call this before. When that has happened already without ours (and it was not found
    through PXR_PLUGINPATH_NAME either) the answer is False: attributes can still be authored and
    read by their names, but have no fallbacks, and ``Usd.Prim.CanApplyAPI`` does not know LOOK_API.
    Calling it again does no harm.
    """
    Plug.Registry().RegisterPlugins(str(PLUGIN_FOLDER))
    return Usd.SchemaRegistry().FindAppliedAPIPrimDefinition(LOOK_API) is not None


def late_note() -> str:
    """A note if USD does not know the schemas because they were registered too late; else ""."""
    if register_schema():
        return ""
    return (
        f"USD does not know {STYLE_API} and {LOOK_API} in this process, because a stage was opened "
        "before usdsmoke was imported. Their attributes are read, but the schemas cannot be "
        "applied. To apply them, import usdsmoke first, or set PXR_PLUGINPATH_NAME to "
        f"{PLUGIN_FOLDER}."
    )
