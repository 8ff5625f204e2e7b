"""The settings of a run by section, and which of them the user gave explicitly."""

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from usdsmoke.base.errors import ConfigError, count_text
from usdsmoke.base.naming import EMISSION, SCATTER_COLOURS, SCATTERING, colour_names
from usdsmoke.config.look_sections import (
    ColourConfig,
    FeaturesConfig,
    LossesConfig,
    OpticsConfig,
    ShapeConfig,
    StyleConfig,
    ViewsConfig,
)
from usdsmoke.config.run_sections import (
    GridsConfig,
    LayerConfig,
    OptimizeConfig,
    StageConfig,
    WindowsConfig,
)
from usdsmoke.config.setting_model import Section, nearest

# Of lit smoke where ``optics.albedo`` is unset. Scattered light is grey, and no emission takes it
# away: where the smoke of fires has 0.3 to 0.9 [Liu2014], dark and saturated styles are washed out
# (decision 081). Where the scattered light has colours itself, half of it is scattered.
LIT_ALBEDO, COLOURED_ALBEDO = 0.1, 0.5


class Config(BaseModel):
    """All settings, by section, and which of them the user gave explicitly."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    stage: StageConfig = Field(default_factory=StageConfig)
    grids: GridsConfig = Field(default_factory=GridsConfig)
    windows: WindowsConfig = Field(default_factory=WindowsConfig)
    views: ViewsConfig = Field(default_factory=ViewsConfig)
    optics: OpticsConfig = Field(default_factory=OpticsConfig)
    style: StyleConfig = Field(default_factory=StyleConfig)
    features: FeaturesConfig = Field(default_factory=FeaturesConfig)
    losses: LossesConfig = Field(default_factory=LossesConfig)
    shape: ShapeConfig = Field(default_factory=ShapeConfig)
    colour: ColourConfig = Field(default_factory=ColourConfig)
    optimize: OptimizeConfig = Field(default_factory=OptimizeConfig)
    layer: LayerConfig = Field(default_factory=LayerConfig)

    def __init__(self, **sections: Any) -> None:
        """Sections by name, each as its model or as a mapping of its settings.

        Raises:
            ConfigError: a setting is unknown, of a wrong type or out of range, or contradicts
                another one.
        """
        try:
            super().__init__(**sections)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            section, *rest = first["loc"]
            if not rest:
                raise ConfigError(_section_problem(str(section), first["input"], "")) from None
            model = SECTIONS[str(section)]
            text = model.explain(str(section), {**first, "loc": tuple(rest)}, {})
            raise ConfigError(text) from None
        n_weights, n_layers = len(self.features.weights), len(self.features.layers)
        if n_weights not in (0, n_layers):
            raise ConfigError(
                f"features.weights has {n_weights} elements, but features.layers has {n_layers}. "
                "Give one weight for each style layer, or none."
            )

    @property
    def explicit(self) -> frozenset[str]:
        """Dotted names of the settings that the user gave for this run.

        They are stronger than what a Volume on the stage requests. Those of a configuration file
        are weaker, and are not among them.
        """
        return frozenset(
            f"{name}.{key}" for name in SECTIONS for key in getattr(self, name).model_fields_set
        )

    @property
    def albedo(self) -> float:
        """The share of light that lit smoke scatters: ``optics.albedo``, or what stands for it."""
        if self.optics.albedo is not None:
            return self.optics.albedo
        return {"albedo": 1.0, "both": COLOURED_ALBEDO}.get(self.colour.target, LIT_ALBEDO)

    @property
    def chooses_exposure(self) -> bool:
        """Whether the exposure of a painted albedo is measured, and not set."""
        return self.colour.target == "albedo" and self.optics.exposure is None

    @property
    def painted(self) -> tuple[str, ...]:
        """What the colour step makes: ``naming.EMISSION``, ``naming.SCATTERING``, both or none."""
        if "colour" not in self.optimize.steps:
            return ()
        kinds = {"emission": (EMISSION,), "albedo": (SCATTERING,)}
        return kinds.get(self.colour.target, (EMISSION, SCATTERING))

    @property
    def scatter_colours(self) -> tuple[str, ...]:
        """The grids of scattering colours: those that are asked for, Cd where it is painted."""
        names = tuple(self.layer.scatter_colour)
        return names or (SCATTER_COLOURS[:1] if SCATTERING in self.painted else ())

    @property
    def colour_grids(self) -> tuple[str, ...]:
        """The names of a result's colour grids after a colour step, in their order."""
        emits = self.colour.target != "albedo"
        return colour_names(self.scatter_colours, self.layer.split_rgb, emits)

    @property
    def lit_optics(self) -> OpticsConfig | None:
        """How light is scattered; None where none is: smoke without colours is not drawn lit."""
        return self.optics if self.albedo > 0 and "colour" in self.optimize.steps else None

    def explicit_values(self) -> dict[str, dict[str, Any]]:
        """The explicit settings, by section and key."""
        dumped = {name: getattr(self, name).model_dump(exclude_unset=True) for name in SECTIONS}
        return {name: values for name, values in dumped.items() if values}

    def given_values(self) -> dict[str, Any]:
        """The settings that are explicit or not the default, by dotted name."""
        defaults, explicit = flatten_settings(Config().model_dump()), self.explicit
        return {
            name: value
            for name, value in flatten_settings(self.model_dump()).items()
            if name in explicit or value != defaults[name]
        }

    def replace(self, **sections: Section) -> "Config":
        """The configuration with other sections, for code: nothing becomes explicit.

        >>> config = Config()
        >>> config.replace(views=config.views.replace(pool=1)).views.pool
        1
        """
        return type(self)(**{name: getattr(self, name) for name in SECTIONS} | sections)

    def with_values(
        self,
        values: Mapping[str, Any],
        sources: Mapping[str, str] | None = None,
        explicit: bool = False,
    ) -> "Config":
        """The configuration with other values.

        Args:
            values: by section and key, or by dotted name.
            sources: where values come from, by dotted name, for messages.
            explicit: whether these become explicit; all others stay what they are.

        Raises:
            ConfigError: see ``Config``.
        """
        by_section: dict[str, dict[str, Any]] = {}
        for name, value in flatten_settings(values).items():
            section, _, key = name.partition(".")
            by_section.setdefault(section, {})[key] = value
        changed = {}
        for name, new in by_section.items():
            old = getattr(self, name)
            checked = old.checked(name, {**old.__dict__, **new}, sources or {})
            names = old.model_fields_set | (new.keys() if explicit else set())
            changed[name] = checked.model_construct(set(names), **checked.__dict__)
        return self.replace(**changed)

    def with_explicit(self, names: Iterable[str] | None = None) -> "Config":
        """The configuration in which exactly these dotted names are explicit; None: no setting."""
        known, names = set(declared_settings()), set(names or ())
        sections = {}
        for name in SECTIONS:
            old = getattr(self, name)
            keys = {full.partition(".")[2] for full in names & known if full.startswith(f"{name}.")}
            sections[name] = old.model_construct(keys, **old.__dict__)
        return self.replace(**sections)


SECTIONS: dict[str, type[Section]] = {
    name: field.annotation  # type: ignore[misc]
    for name, field in Config.model_fields.items()
}


def declared_settings() -> dict[str, FieldInfo]:
    """The declaration of every setting, by dotted name."""
    return {
        f"{name}.{key}": field
        for name, model in SECTIONS.items()
        for key, field in model.model_fields.items()
    }


def flatten_settings(values: Mapping[str, Any], source: str = "") -> dict[str, Any]:
    """Settings by dotted name.

    >>> flatten_settings({"windows": {"size": 3}, "optimize.seed": 7})
    {'windows.size': 3, 'optimize.seed': 7}

    Args:
        values: by section and key, or by dotted name; a section that is None is empty.
        source: where they come from, for messages.

    Raises:
        ConfigError: an unknown section, or one that is not a mapping, or a setting given twice.
            Keys are not checked.
    """
    flat: dict[str, Any] = {}
    for name, value in values.items():
        section, dot, _ = str(name).partition(".")
        if section not in SECTIONS or not (dot or value is None or isinstance(value, Mapping)):
            raise ConfigError(_section_problem(section, value, source))
        found = {name: value} if dot else {f"{name}.{key}": value[key] for key in value or ()}
        if twice := flat.keys() & found.keys():
            raise ConfigError(f"{min(twice)} is given twice. Give it once.")
        flat |= found
    return flat


def checked_setting(name: str, value: Any, source: str) -> Any:
    """A value for one setting, checked, as the type that the setting has.

    Raises:
        ConfigError: see ``Section.checked``.
    """
    section, _, key = name.partition(".")
    return getattr(SECTIONS[section].checked(section, {key: value}, {name: source}), key)


def style_shares(config: StyleConfig, n_styles: int) -> list[float]:
    """The share of each style image; they add up to 1.

    >>> style_shares(StyleConfig(weights=[3, 1]), 2)
    [0.75, 0.25]

    Raises:
        ConfigError: not one weight for each image, or none above 0.
    """
    weights = config.weights or [1.0] * n_styles
    if len(weights) != n_styles:
        raise ConfigError(
            f"style.weights has {count_text(len(weights), 'number')} for "
            f"{count_text(n_styles, 'style image')}. Give one for each image, or none."
        )
    if not max(weights) > 0:
        raise ConfigError("all style.weights are 0. Set at least one above 0.")
    relative = [weight / max(weights) for weight in weights]  # their sum cannot overflow
    return [weight / sum(relative) for weight in relative]


def _section_problem(section: str, value: object, source: str) -> str:
    origin = f" (from {source})" if source else ""
    if section not in SECTIONS:
        return f"unknown settings section {section!r}{origin}. {nearest(section, list(SECTIONS))}"
    example = next(iter(SECTIONS[section].model_fields))
    return (
        f"section {section} is {value!r:.99}{origin}, not a list of settings. "
        f"Write them below it, such as '{example}: VALUE'."
    )
