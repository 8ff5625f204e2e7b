"""Whether finished pictures show the style: its mean colour, and its contrast."""

from collections.abc import Iterator

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.config.settings import Config
from usdsmoke.planning.remarks import EXTREME_RATE
from usdsmoke.runs.budget.finding import Finding
from usdsmoke.runs.budget.rows import COLOUR_OPTIMISER

OFF = 0.2  # of the range of colours: runs have up to 0.06, drafts of mixed styles up to 0.17
FLAT = 0.2  # of the style's contrast: they have 0.4 to 0.8
FINE = 0.5  # of the style's contrast at the size of pictures: less is lost whatever is done
BLACK = 0.01  # of white's light
NEAR_END = 0.1  # of the loss, that four times as many iterations take off
FAR_SPEED = 1.0  # of the smoke's velocity: a pattern that is so much slower or faster
LIT = 0.1  # of the pictures' light, given by lamps: as much changes their colours


def find_look(name: str, report: FrameReport, config: Config) -> Iterator[Finding]:
    """Whether a stylized frame has another colour than the style, or hardly any pattern."""
    look = report.look
    if look is None or (look.colour_off <= OFF and look.contrast >= FLAT):
        yield from _find_rate(name, config)
        return
    if report.light is not None and report.light.is_tinted:  # which has a finding
        return
    cause = f"the pictures have {look.contrast:.0%} of the style's contrast"
    if is_nearly_black(report):
        cause += ", which is nearly black"
    elif look.colour_off > OFF:
        cause = f"the pictures' mean colour is {look.colour_off:.0%} off the style's"
    elif look.shown < FINE:
        cause += f", and the style itself has {look.shown:.0%} of it at their size"
    setting, remedy = colour_remedy(config, report)
    text = f"Compare the result with the style; {remedy}"
    yield Finding(name, COLOUR_OPTIMISER.name, cause, text, setting)


def _find_rate(name: str, config: Config) -> Iterator[Finding]:
    """Colours that jump keep the style's mean and contrast, but hardly its strokes."""
    if has_high_rate(config):
        rate, usual = config.colour.learning_rate, Config().colour.learning_rate
        yield Finding(
            name,
            COLOUR_OPTIMISER.name,
            f"colour.learning_rate={rate:g} is {rate / usual:.3g} times the default: one step "
            "crosses the whole range of colours",
            "Use the default of colour.learning_rate",
            "colour.learning_rate",
        )


def colour_remedy(config: Config, report: FrameReport) -> tuple[str, str]:
    """The setting that may keep the colour step from the style, and what to do with it."""
    setting, usual = length_of("colour", config), Config().losses
    remedy = f"raise {setting}"
    if _is_done(report):  # more iterations do not help: motifs that fill more pixels may
        setting, remedy = "style.size", "raise style.size above what the record has"
    if is_nearly_black(report):
        setting, remedy = "", "brighten the style image"
    if raised := [n for n in usual.BESIDE_STYLE if getattr(config.losses, n) > getattr(usual, n)]:
        setting = f"losses.{raised[0]}"
        remedy = f"lower {', '.join(f'losses.{name}' for name in raised)}, or {remedy}"
    if config.style.tiling != Config().style.tiling:
        setting, remedy = "style.tiling", "use the default of style.tiling"
    if config.stage.mask:
        remedy += ", or check the values of the mask"
    if has_high_rate(config):
        setting, remedy = "colour.learning_rate", "use the default of colour.learning_rate"
    if has_far_speed(config):
        setting, remedy = "windows.pattern_speed", "use the default of windows.pattern_speed"
    light = report.light
    if light is not None and light.share > LIT and config.colour.target == "emission":
        setting = "optics.albedo"
        remedy = (
            f"lower optics.albedo (lights give {light.share:.0%} of the brightness), or {remedy}"
        )
    return setting, remedy


def _is_done(report: FrameReport) -> bool:
    """Whether the style is too fine for the pictures, or the colour step is near its end."""
    if report.look is not None and report.look.shown < FINE:
        return True
    left = COLOUR_OPTIMISER.of_frame(report)
    return left is not None and left.value < NEAR_END


def is_nearly_black(report: FrameReport) -> bool:
    """Whether strokes of the style are hardly seen."""
    return report.look is not None and report.look.white < BLACK


def length_of(step: str, config: Config) -> str:
    """The setting that makes a step longer."""
    return f"{step if config.optimize.iterations is None else 'optimize'}.iterations"


def has_far_speed(config: Config) -> bool:
    """Whether frames start from smoke that is far from where theirs was."""
    return abs(config.windows.pattern_speed - 1) > FAR_SPEED


def has_high_rate(config: Config) -> bool:
    """Whether steps are so large that colours jump between black and white."""
    return config.colour.learning_rate > EXTREME_RATE * Config().colour.learning_rate
