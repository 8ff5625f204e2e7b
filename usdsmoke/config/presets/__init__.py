"""Settings for a purpose, as YAML files that may be copied.

- ``draft.yaml``: a first look
- ``daily.yaml``: the defaults
- ``final.yaml``: more iterations and views
- ``paper.yaml``: what the paper publishes
"""

from pathlib import Path

from usdsmoke.base.errors import ConfigError

__all__ = ["PRESETS", "preset_file"]

PRESETS = ("draft", "daily", "final", "paper")


def preset_file(name: str) -> Path:
    """The settings file of a preset.

    Raises:
        ConfigError: there is none of this name.
    """
    if name not in PRESETS:
        raise ConfigError(f"there is no preset {name!r}. Use one of {', '.join(PRESETS)}.")
    return Path(__file__).with_name(f"{name}.yaml")
