"""What a look was asked for, read back from its record."""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from usdsmoke.base.settings import Config
from usdsmoke.runs.run import find_runs
from usdsmoke.ui.usdview.looks import Look

__all__ = ["LookRequest", "changed_settings", "read_look_request"]

_GIVEN_OTHERWISE = {"stage.prims", "stage.frames"}  # by options of their own


@dataclass(frozen=True)
class LookRequest:
    """The stage and the style images that a look was made from, and its settings."""

    stage_file: Path | None  # None where it is not known, or gone
    styles: tuple[str, ...]  # absolute; without folders where only the names are known
    settings: Mapping[str, Any]  # by section.key: given for the run, or no default of today
    explicit: frozenset[str] = frozenset()  # those that are stronger than a Volume's own


def read_look_request(look: Look) -> LookRequest:
    """What was asked for, as far as the layer or the run's folder beside it tells.

    Stage and images of older layers stand in the run's record (``vdb/KEY/run.json``); where that
    is gone too, the layer has the images' names.
    """
    folder = Path(look.layer.realPath).parent
    request = _json_mapping(look.record.get("request")) or _in_run_folder(folder, look.run)
    config = _config(look, folder)
    explicit = frozenset(request.get("explicit", ()))
    settings = {
        name: value
        for name, value in changed_settings(config, explicit).items()
        if name not in _GIVEN_OTHERWISE
    }
    try:
        stage_file = (folder / request["stage"]).resolve()
        styles = tuple(str((folder / name).resolve()) for name in request["styles"])
    except (KeyError, TypeError):
        stage_file = None
        pairs = look.record.get("styles", [])
        styles = tuple(str(text).rpartition("=")[0] for text in pairs)
    exists = stage_file is not None and stage_file.is_file()
    return LookRequest(stage_file if exists else None, styles, settings, explicit)


def _config(look: Look, folder: Path) -> Mapping[str, Any]:
    """The recorded sections, with the place of the parameter file as it is now."""
    config = dict(_json_mapping(look.record.get("config")))
    features = config.get("features")
    file = features.get("vgg19_file") if isinstance(features, dict) else None
    if isinstance(file, str) and file.startswith(("./", "../")):
        config["features"] = {**config["features"], "vgg19_file": str((folder / file).resolve())}
    return config


def changed_settings(config: Mapping[str, Any], explicit: Collection[str] = ()) -> dict[str, Any]:
    """Recorded settings by ``section.key`` that differ from the defaults of today.

    Those that this version does not know are left out.

    Args:
        config: sections of a record.
        explicit: names of settings to take in any case.
    """
    return {
        f"{section}.{key}": config[section][key]
        for section, defaults in Config().model_dump().items()
        if isinstance(config.get(section), Mapping)
        for key, default in defaults.items()
        if key in config[section]
        and (config[section][key] != default or f"{section}.{key}" in explicit)
    }


def _in_run_folder(folder: Path, run_id: str) -> Mapping[str, Any]:
    return next((run.request for run in find_runs(folder) if run.run_id == run_id), {})


def _json_mapping(text: Any) -> Mapping[str, Any]:
    """A JSON object of a record; empty where it is missing or cannot be read."""
    try:
        value = json.loads(text)
    except (TypeError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}
