"""What a Volume prim may ask for, attribute by attribute, and which setting each of them is.

Types, units, ranges and meanings stand in schemas/usdSmoke/schema.usda.
"""

from dataclasses import dataclass

__all__ = [
    "CAMERA",
    "MASK",
    "REQUEST_ATTRIBUTES",
    "REQUEST_PREFIX",
    "STYLE_IMAGES",
    "RequestAttribute",
]

REQUEST_PREFIX = "usdSmoke:request:"

STYLE_IMAGES = f"{REQUEST_PREFIX}styleImages"  # asset[]; no setting, but what --style gives
CAMERA = f"{REQUEST_PREFIX}camera"  # relationship
MASK = f"{REQUEST_PREFIX}mask"  # relationship


@dataclass(frozen=True)
class RequestAttribute:
    """An attribute of UsdSmokeStyleAPI that stands for a setting."""

    name: str  # with the prefix
    section: str
    key: str
    control: str = ""  # field of FrameControls; "" for what may not change over time

    @property
    def setting(self) -> str:
        """The setting's dotted name."""
        return f"{self.section}.{self.key}"


def _row(name: str, setting: str, control: str = "") -> RequestAttribute:
    section, _, key = setting.partition(".")
    return RequestAttribute(f"{REQUEST_PREFIX}{name}", section, key, control)


REQUEST_ATTRIBUTES = (
    _row("styleWeights", "style.weights", "style_weights"),
    _row("styleSize", "style.size"),
    _row("styleTiling", "style.tiling"),
    _row("strength", "optimize.strength", "strength"),
    _row("steps", "optimize.steps"),
    _row("iterations", "optimize.iterations"),
    _row("seed", "optimize.seed"),
    _row("gamma", "optics.gamma", "gamma"),
    _row("gammaShape", "optics.gamma_shape"),
    _row("viewCount", "views.count"),
    _row("viewPool", "views.pool"),
    _row("viewSampling", "views.sampling"),
    _row("azimuth", "views.azimuth"),
    _row("elevation", "views.elevation"),
    _row("centreAzimuth", "views.centre_azimuth"),
    _row("centreElevation", "views.centre_elevation"),
    _row("imageSize", "views.image_size"),
    _row("network", "features.network"),
    _row("featureLayers", "features.layers"),
    _row("featureWeights", "features.weights"),
    _row("statistic", "losses.statistic"),
    _row("displacement", "shape.displacement"),
    _row("reach", "shape.reach"),
    _row("shapeIterations", "shape.iterations"),
    _row("colourInit", "colour.init"),
    _row("colourIterations", "colour.iterations"),
    _row("windowSize", "windows.size"),
    _row("windowOverlap", "windows.overlap"),
    _row("patternSpeed", "windows.pattern_speed", "pattern_speed"),
)
