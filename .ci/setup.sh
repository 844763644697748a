#!/usr/bin/env bash
# Make .venv: pinned packages, a CPU build of torch where there is no GPU, and a library to draw with.
# `make` runs it when pyproject.toml or constraints.txt is newer than the last run.
set -euo pipefail
cd "$(dirname "$0")/.."

readonly VENV=.venv
readonly GL_PACKAGES="libegl1 libgl1-mesa-dri"
readonly TORCH_CPU_INDEX=https://download.pytorch.org/whl/cpu

say() { echo "setup: $*" >&2; }
die() { say "$*"; exit 4; }
root_with_apt() { [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; }
apt_install() { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y "$@" >/dev/null; }

find_python() {
    local candidate
    for candidate in ${PYTHON:-} python3 python3.13 python3.12 python3.11; do
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
    if root_with_apt && [ -z "${1:-}" ]; then
        say "installing python3"
        apt_install python3 python3-venv || true
        find_python again
        return
    fi
    die "ifo needs Python 3.11 or later, found $(python3 --version 2>&1 || true): install it, or name it: make PYTHON=python3.12"
}

make_venv() {
    [ -x $VENV/bin/python ] && $VENV/bin/python -m pip --version >/dev/null 2>&1 && return
    local python
    python=$(find_python)
    say "making $VENV with $("$python" --version)"
    if ! "$python" -m venv --clear $VENV >/dev/null 2>&1; then
        root_with_apt && apt_install python3-venv || true
        "$python" -m venv --clear $VENV >&2 || die "no virtual environment can be made: on Debian, sudo apt-get install python3-venv"
    fi
}

# Whether an index answers within seconds: one that does not would hold up every package.
answers() {
    $VENV/bin/python - "$1" <<'PYTHON' 2>/dev/null
import sys, urllib.request
urllib.request.urlopen(urllib.request.Request(sys.argv[1], method="HEAD"), timeout=5)
PYTHON
}

pip_install() { $VENV/bin/python -m pip install --quiet --disable-pip-version-check "$@" >&2; }

install_packages() {
    local torch
    torch=$(grep -E '^torch==' constraints.txt)
    if ! command -v nvidia-smi >/dev/null; then
        if answers $TORCH_CPU_INDEX/torch/; then
            say "installing $torch, the CPU build"
            pip_install "$torch" -c constraints.txt --extra-index-url $TORCH_CPU_INDEX
        else
            say "$TORCH_CPU_INDEX does not answer: $torch comes from the usual index"
        fi
    fi
    say "installing ifo and what it needs"
    pip_install -e '.[dev]' -c constraints.txt
}

gl_works() {
    $VENV/bin/python -c 'from stages.simulation.gl import choose_backend; choose_backend()' 2>/dev/null
}

install_gl() {
    gl_works && return
    if root_with_apt; then
        say "installing $GL_PACKAGES to draw with"
        # shellcheck disable=SC2086  # two packages
        apt_install $GL_PACKAGES || true
        gl_works && return
    fi
    say "nothing here can draw yet; run: sudo apt-get update && sudo apt-get install -y $GL_PACKAGES"
    say "(then \`$VENV/bin/ifo doctor\` should be content)"
}

make_venv
install_packages
install_gl
touch $VENV/.stamp
