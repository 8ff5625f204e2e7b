#!/bin/sh
# Run tests with another release of OpenUSD than the pinned one; the environment stays as it is.
#
#   sh tools/try_openusd.sh 25.8 [TEST ...]
set -eu
cd "$(dirname "$0")/.."
version=${1:?"usage: try_openusd.sh VERSION [TEST ...], for example 25.8"}
shift
[ $# -gt 0 ] || set -- tests/unit/usd/test_layer.py tests/unit/usd/test_stage.py tests/round_trip
folder=out/openusd-$version

# Found before the environment's own: PYTHONPATH comes first.
.venv/bin/python -m pip install -q --no-deps --upgrade --target "$folder" "usd-core==$version"
PYTHONPATH=$PWD/$folder .venv/bin/python -c 'from pxr import Usd; print("OpenUSD", Usd.GetVersion())'
PYTHONPATH=$PWD/$folder .venv/bin/python -m pytest -q "$@"
