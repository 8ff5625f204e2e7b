"""Whether finished pictures show the style: its mean colour, and its contrast."""

from collections.abc import Iterator

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.base.settings import Config
from usdsmoke.planning.remarks import EXTREME_RATE
from usdsmoke.runs.budget.finding import Finding
from usdsmoke.runs.budget.rows import COLOUR_OPTIMISER

OFF = 0.2  # of the range of colours: runs have up to 0.06, drafts of mixed styles up to 0.17
FLAT = 0.2  # of the style's contrast: they have 0.4 to 0.8


def find_look(name: str, report: FrameReport, config: Config) -> Iterator[Finding]:
    """Whether a stylized frame has another colour than the style, or hardly any pattern."""
    look = report.look
    if look is None or (look.colour_off <= OFF and look.contrast >= FLAT):
        return
    if report.light is not None and report.light.is_tinted:  # which has a finding
        return
    cause = f"the pictures have {look.contrast:.0%} of the style's contrast"
    if look.colour_off > OFF:
        cause = f"the pictures' mean colour is {look.colour_off:.0%} off the style's"
    setting, remedy = colour_remedy(config)
    text = f"Compare the result with the style; {remedy}"
    yield Finding(name, COLOUR_OPTIMISER.name, cause, text, setting)


def colour_remedy(config: Config) -> tuple[str, str]:
    """The setting that may keep the colour step from the style, and what to do with it."""
    setting = length_of("colour", config)
    remedy, usual = f"raise {setting}", Config().losses
    if raised := [n for n in usual.BESIDE_STYLE if getattr(config.losses, n) > getattr(usual, n)]:
        setting = f"losses.{raised[0]}"
        remedy = f"lower {', '.join(f'losses.{name}' for name in raised)}, or {remedy}"
    if config.style.tiling != Config().style.tiling:
        setting, remedy = "style.tiling", "use the default of style.tiling"
    if config.stage.mask:
        remedy += ", or check the values of the mask"
    if has_high_rate(config):
        setting, remedy = "colour.learning_rate", "use the default of colour.learning_rate"
    return setting, remedy


def length_of(step: str, config: Config) -> str:
    """The setting that makes a step longer."""
    return f"{step if config.optimize.iterations is None else 'optimize'}.iterations"


def has_high_rate(config: Config) -> bool:
    """Whether steps are so large that colours jump between black and white."""
    return config.colour.learning_rate > EXTREME_RATE * Config().colour.learning_rate
