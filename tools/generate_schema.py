"""Make the schema and the plug-in's files from the settings and schemas/usdSmoke/schema.usda.

    python tools/generate_schema.py [--out FOLDER]

First writes the attributes of UsdSmokeStyleAPI that stand for settings into schema.usda. Then runs
USD's own usdGenSchema on the schema, which is codeless, and fills in the paths that a build of C++
would have filled in.
"""

import argparse
import importlib.util
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from pydantic.fields import FieldInfo

from usdsmoke.config.setting_model import ValueType, allowed_values, extra_of, limits_of, range_text
from usdsmoke.config.settings import declared_settings

__all__ = ["generate", "main", "schema_text"]

PROJECT = Path(__file__).resolve().parent.parent
SCHEMA = PROJECT / "schemas" / "usdSmoke" / "schema.usda"
PLUGIN_FOLDER = PROJECT / "usdsmoke" / "plugin"
CAPABILITIES = {
    "usdSmoke": {
        "docstring": "Smoke that usdsmoke has stylized.",
        "name": "usdSmoke",
        "predecessors": ["usd"],
        "style": "core",
        "subgraph": "usdSmoke",
    },
    "usdSmoke.look": {
        "docstring": "Volumes with the density and the emission of a look (UsdSmokeLookAPI).",
        "name": "Look of a Volume",
        "predecessors": ["usdSmoke"],
        "style": "core",
        "subgraph": "usdSmoke",
    },
}
RESOURCES = "resources/usdSmoke"  # where plugInfo.json says that generatedSchema.usda is

PLACEHOLDERS = {
    "@PLUG_INFO_LIBRARY_PATH@": "",  # codeless: there is no library
    "@PLUG_INFO_RESOURCE_PATH@": RESOURCES,
    "@PLUG_INFO_ROOT@": ".",
}


MARK = "    # The rest is written by tools/generate_schema.py from usdsmoke/config.\n"


def schema_text() -> str:
    """The schema with an attribute for every setting that a Volume may request."""
    head, mark, _ = SCHEMA.read_text(encoding="utf-8").partition(MARK)
    settings = declared_settings().values()
    attributes = [_attribute(field) for field in settings if "request" in extra_of(field)]
    return f"{head}{mark}\n{chr(10).join(attributes)}}}\n"


def _attribute(field: FieldInfo) -> str:
    value, extra, limits = ValueType.of(field), extra_of(field), limits_of(field)
    kind = {int: "int", float: "double", str: "token"}[value.element]
    if kind == "int" and limits.get("le", 0) >= 2**31:
        kind = "int64"
    text = str(field.description)
    about = [f"{text[0].upper()}{text[1:]}."]
    about += ["May be animated."] if "control" in extra else []
    about += [f"Units: {extra.get('unit', 'none')}.", f"Range: {range_text(field) or 'any'}."]
    variability = "" if "control" in extra else "uniform "
    words = ", ".join(f'"{word}"' for word in allowed_values(field))
    return (
        f"    {variability}{kind}{'[]' * value.is_list} usdSmoke:request:{extra['request']} (\n"
        + (f"        allowedTokens = [{words}]\n" if words else "")
        + "        customData = {\n"
        + f'            string userDocBrief = "{" ".join(about)}"\n        }}\n    )\n'
    )


def run_generator(schema: Path, out_folder: Path) -> None:
    """Run usdGenSchema, which comes with usd-core, on the schema."""
    usd = importlib.util.find_spec("pxr.Usd")
    if usd is None or usd.origin is None:
        sys.exit("usd-core is not installed; run 'make env'")
    script = Path(usd.origin).parent / "usdGenSchema.py"
    done = subprocess.run(
        [sys.executable, str(script), str(schema), str(out_folder)], capture_output=True, text=True
    )
    if done.returncode != 0:
        sys.exit(f"usdGenSchema refused {schema}:\n{done.stdout}{done.stderr}")


def with_aliases(plug_info: str) -> str:
    """``plugInfo.json`` with other names for the types, and the schemas' names as their aliases.

    OpenUSD before 24.11 finds a codeless schema only by an alias, and no type may have that name.
    """
    pattern = re.compile(r'^( +)"(UsdSmoke\w+API)": \{$', re.MULTILINE)
    alias = r'\1"UsdSmoke\2": {\n\1    "alias": {\n\1        "UsdSchemaBase": "\2"\n\1    },'
    return pattern.sub(alias, plug_info)


def with_capabilities(plug_info: str) -> str:
    """``plugInfo.json`` with the capability that a Volume with a look claims (UsdProfiles, 26.11).

    Older releases ignore it.
    """
    head, brace, rest = plug_info.partition("{")
    plugins = json.loads(brace + rest)
    info = plugins["Plugins"][0]["Info"]
    kinds = info["Types"]
    look = next(name for name in kinds if name.endswith("UsdSmokeLookAPI"))
    kinds[look]["impliesCapabilities"] = ["usdSmoke.look"]
    plugins["Plugins"][0]["Info"] = {"Profiles": {"Capabilities": CAPABILITIES}, **info}
    return head + json.dumps(plugins, indent=4)


def generate(plugin_folder: Path, schema: Path) -> list[Path]:
    """Write the schema, and plugInfo.json and generatedSchema.usda below ``plugin_folder``."""
    schema.write_text(schema_text(), encoding="utf-8")
    with tempfile.TemporaryDirectory() as scratch:
        run_generator(schema, Path(scratch))
        plug_info = (Path(scratch) / "plugInfo.json").read_text(encoding="utf-8")
        generated = (Path(scratch) / "generatedSchema.usda").read_text(encoding="utf-8")
    for placeholder, value in PLACEHOLDERS.items():
        plug_info = plug_info.replace(placeholder, value)
    plug_info = with_capabilities(with_aliases(plug_info))
    contents = {
        plugin_folder / "plugInfo.json": plug_info,
        plugin_folder / RESOURCES / "generatedSchema.usda": generated,
    }
    for file_path, text in contents.items():
        file_path.parent.mkdir(parents=True, exist_ok=True)
        lines = [line.rstrip() for line in text.rstrip().splitlines()]
        file_path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [schema, *contents]


def main() -> None:
    """Read the command line, generate, and print what was written."""
    parser = argparse.ArgumentParser(description="Make the schema and the plug-in's files.")
    parser.add_argument("--out", type=Path, help="a folder for all files, not the usual places")
    folder = parser.parse_args().out
    schema = folder / "schema.usda" if folder else SCHEMA
    for file_path in generate(folder or PLUGIN_FOLDER, schema):
        print(file_path)


if __name__ == "__main__":
    main()
