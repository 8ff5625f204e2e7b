"""Make the plug-in's files in usdsmoke/plugin from schemas/usdSmoke/schema.usda.

    python tools/generate_schema.py [--out FOLDER]

Runs USD's own usdGenSchema on the schema, which is codeless, and fills in the paths that a build of
C++ would have filled in.
"""

import argparse
import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

__all__ = ["generate", "main"]

PROJECT = Path(__file__).resolve().parent.parent
SCHEMA = PROJECT / "schemas" / "usdSmoke" / "schema.usda"
PLUGIN_FOLDER = PROJECT / "usdsmoke" / "plugin"
RESOURCES = "resources/usdSmoke"  # where plugInfo.json says that generatedSchema.usda is

PLACEHOLDERS = {
    "@PLUG_INFO_LIBRARY_PATH@": "",  # codeless: there is no library
    "@PLUG_INFO_RESOURCE_PATH@": RESOURCES,
    "@PLUG_INFO_ROOT@": ".",
}


def run_generator(out_folder: Path) -> None:
    """Run usdGenSchema, which comes with usd-core, on the schema."""
    usd = importlib.util.find_spec("pxr.Usd")
    if usd is None or usd.origin is None:
        sys.exit("usd-core is not installed; run 'make env'")
    script = Path(usd.origin).parent / "usdGenSchema.py"
    done = subprocess.run(
        [sys.executable, str(script), str(SCHEMA), str(out_folder)], capture_output=True, text=True
    )
    if done.returncode != 0:
        sys.exit(f"usdGenSchema refused {SCHEMA}:\n{done.stdout}{done.stderr}")


def generate(plugin_folder: Path) -> list[Path]:
    """Write plugInfo.json and generatedSchema.usda below ``plugin_folder``; their files."""
    with tempfile.TemporaryDirectory() as scratch:
        run_generator(Path(scratch))
        plug_info = (Path(scratch) / "plugInfo.json").read_text(encoding="utf-8")
        schema = (Path(scratch) / "generatedSchema.usda").read_text(encoding="utf-8")
    for placeholder, value in PLACEHOLDERS.items():
        plug_info = plug_info.replace(placeholder, value)
    contents = {
        plugin_folder / "plugInfo.json": plug_info,
        plugin_folder / RESOURCES / "generatedSchema.usda": schema,
    }
    for file_path, text in contents.items():
        file_path.parent.mkdir(parents=True, exist_ok=True)
        lines = [line.rstrip() for line in text.rstrip().splitlines()]
        file_path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return list(contents)


def main() -> None:
    """Read the command line, generate, and print what was written."""
    parser = argparse.ArgumentParser(description="Make the schema plug-in's files.")
    parser.add_argument("--out", type=Path, default=PLUGIN_FOLDER, help="the plug-in's folder")
    for file_path in generate(parser.parse_args().out):
        print(file_path)


if __name__ == "__main__":
    main()
