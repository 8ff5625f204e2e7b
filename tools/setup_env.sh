#!/bin/sh
# Make the environment in .venv: Python packages at the pinned versions, and OpenVDB's bindings.
#
#   sh tools/setup_env.sh          (run by `make env`; PYTHON=... chooses the interpreter)
#
# OpenVDB's official bindings come from no package index. If no Python here has them, Debian's
# package is installed with apt-get, and its one extension file is linked into .venv: the system's
# package folder stays off the path, because the NumPy in it must not meet ours.
set -eu
cd "$(dirname "$0")/.."

VENV=.venv
SYSTEM_PACKAGES=/usr/lib/python3/dist-packages
APT_UPDATED=no

say() { printf 'usdsmoke: %s\n' "$*" >&2; }
fail() { say "$*"; exit 1; }

# The interpreters to try, best first; those that are missing or too old are left out.
pythons() {
    for name in ${PYTHON:-python3 /usr/bin/python3 python3.11 python3.12 python3.13 python3.10}; do
        "$name" -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null && echo "$name"
    done
    return 0
}

# The file (or package folder) of OpenVDB's bindings that fits the interpreter $1; empty if none.
# Nothing is imported here: bindings for another NumPy end the interpreter when they are.
binding_of() {
    "$1" - "$SYSTEM_PACKAGES" <<'END'
import importlib.util, os, sys, sysconfig
def main():
    for name in ("openvdb", "pyopenvdb"):
        spec = importlib.util.find_spec(name)
        if spec and spec.origin:
            is_folder = spec.submodule_search_locations is not None
            return os.path.dirname(spec.origin) if is_folder else spec.origin
        suffix = sysconfig.get_config_var("EXT_SUFFIX")
        for folder in sys.argv[1:]:
            if os.path.exists(os.path.join(folder, name + suffix)):
                return os.path.join(folder, name + suffix)
    return ""
print(main())
END
}

# Install Debian packages; says what is missing where that cannot be done.
apt_install() {
    command -v apt-get >/dev/null || fail "apt-get is not here, so $* cannot be installed;" \
        "install OpenVDB's Python bindings for Python 3.10 or newer by hand (conda-forge has them" \
        "as 'openvdb'), and run 'PYTHON=/that/python make env'"
    as_root=
    if [ "$(id -u)" != 0 ]; then
        command -v sudo >/dev/null || fail "installing $* needs root and sudo is not here;" \
            "run as root: apt-get install $*   and then 'make env' again"
        as_root=sudo
    fi
    if [ $APT_UPDATED = no ]; then
        say "updating the package lists (apt-get update)"
        $as_root apt-get -qq update || fail "apt-get update failed; is the network there?"
        APT_UPDATED=yes
    fi
    say "installing $* (apt-get)"
    $as_root env DEBIAN_FRONTEND=noninteractive \
        apt-get -qq -y install --no-install-recommends "$@" >/dev/null ||
        fail "apt-get install $* failed; what it said stands above"
}

# Set python and binding: the first interpreter that has bindings which fit it.
choose_python() {
    python= binding=
    for candidate in $(pythons); do
        binding=$(binding_of "$candidate")
        if [ -n "$binding" ]; then python=$candidate; return 0; fi
    done
    return 0
}

make_venv() {
    wanted=$("$python" -c 'import sysconfig; print(sysconfig.get_config_var("EXT_SUFFIX"))')
    if "$VENV/bin/python" -c "import pip, sys, sysconfig
sys.exit(sysconfig.get_config_var('EXT_SUFFIX') != '$wanted')" 2>/dev/null; then
        return 0
    fi
    # Absent, broken by an interrupted run, or of another Python than the bindings are for.
    rm -rf "$VENV"
    if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
        apt_install "$("$python" -c 'import sys; print("python3.%d-venv" % sys.version_info[1])')"
    fi
    "$python" -m venv "$VENV" || fail "$python cannot make an environment in $VENV"
}

install_packages() {
    say "installing torch (the largest download)"
    "$VENV/bin/pip" install -q -c constraints.txt torch setuptools ||
        fail "pip could not install torch; what it said stands above; is the network there?"
    say "installing the other packages"
    "$VENV/bin/pip" install -q -c constraints.txt --no-build-isolation -e '.[dev]' ||
        fail "pip could not install the packages; what it said stands above"
}

link_binding() {
    packages=$("$VENV/bin/python" -c 'import sysconfig; print(sysconfig.get_path("platlib"))')
    target=$packages/$(basename "$binding")
    # When .venv's own Python is the one that has it, there is nothing to link.
    if [ "$binding" != "$target" ]; then ln -sfn "$binding" "$target"; fi
    # In a process of its own: bindings that were built for another NumPy end it.
    "$VENV/bin/python" - <<'END' || fail "OpenVDB's bindings ($binding) do not work with the" \
        "NumPy that constraints.txt pins; bindings built for NumPy 1 need numpy<2, and the reverse"
import numpy
try:
    import openvdb
except ImportError:
    import pyopenvdb as openvdb
grid, back = openvdb.FloatGrid(), numpy.zeros((2, 3, 4), numpy.float32)
grid.copyFromArray(numpy.arange(24, dtype=numpy.float32).reshape(2, 3, 4))
grid.copyToArray(back)
raise SystemExit(int(back.sum() != 276))
END
}

if [ -z "$(pythons)" ]; then
    found=$("${PYTHON:-python3}" -V 2>/dev/null || echo "not here")
    fail "Python 3.10 or newer is needed; ${PYTHON:-python3} is $found;" \
        "install a newer one, or name it: PYTHON=/that/python make env"
fi
choose_python
if [ -z "$python" ]; then
    apt_install python3-openvdb
    choose_python
fi
[ -n "$python" ] || fail "python3-openvdb is installed, but for $(/usr/bin/python3 -V 2>&1)," \
    "and usdsmoke needs Python 3.10 or newer; bring OpenVDB's bindings for a newer Python," \
    "and run 'PYTHON=/that/python make env'"
make_venv
install_packages
link_binding
touch "$VENV/.ready"
say "the environment is in $VENV ($("$VENV/bin/python" -V), $(basename "$binding"))"
