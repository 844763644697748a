#!/usr/bin/env bash
# Create .venv: pinned packages, the CPU build of torch if there is no GPU, and the OpenGL libraries for rendering.
# `make` runs it if pyproject.toml, constraints.txt or this file is newer than the last successful run.
set -euo pipefail
cd "$(dirname "$0")/.."
# shellcheck source=.ci/apt.sh
source .ci/apt.sh

readonly VENV=.venv
readonly TORCH_CPU_INDEX=https://download.pytorch.org/whl/cpu

say() { echo "setup: $*" >&2; }
die() { say "$*"; exit 4; }

# dm-control needs labmaze, which has no wheel for later versions. Same range as requires-python in pyproject.toml.
readonly PYTHONS="Python 3.11 or 3.12"
suits() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' 2>/dev/null; }

find_python() {
    local candidate
    if [ -n "${PYTHON:-}" ]; then
        suits "$PYTHON" || die "PYTHON=$PYTHON is $("$PYTHON" --version 2>&1 || true): ifo needs $PYTHONS"
        echo "$PYTHON"
        return
    fi
    for candidate in python3 python3.12 python3.11; do
        if suits "$candidate"; then
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
    die "ifo needs $PYTHONS, found $(python3 --version 2>&1 || true): install one, or name it: make PYTHON=/path/to/python3.12"
}

make_venv() {
    suits $VENV/bin/python && $VENV/bin/python -m pip --version >/dev/null 2>&1 && return
    local python
    python=$(find_python)
    say "creating $VENV with $("$python" --version)"
    if ! "$python" -m venv --clear $VENV >/dev/null 2>&1; then
        root_with_apt && apt_install python3-venv || true
        "$python" -m venv --clear $VENV >&2 || die "cannot create a virtual environment: on Debian, sudo apt-get install python3-venv"
    fi
}

# Succeeds if an index answers within seconds: one that does not would delay the installation of every package.
answers() {
    $VENV/bin/python - "$1" <<'PYTHON' 2>/dev/null
import sys, urllib.request
urllib.request.urlopen(urllib.request.Request(sys.argv[1], method="HEAD"), timeout=5)
PYTHON
}

# --use-pep517: source distributions without pyproject.toml are built in the supported way.
pip_install() {
    quietly $VENV/bin/python -m pip install --quiet --disable-pip-version-check --use-pep517 "$@" ||
        die "pip cannot install the packages (see its messages above)"
}

install_packages() {
    local torch
    torch=$(grep -E '^torch==' constraints.txt)
    if ! command -v nvidia-smi >/dev/null; then
        if answers $TORCH_CPU_INDEX/torch/; then
            say "installing $torch, the CPU build"
            pip_install "$torch" -c constraints.txt --extra-index-url $TORCH_CPU_INDEX
        else
            say "$TORCH_CPU_INDEX does not answer: installing $torch from the default index"
        fi
    fi
    say "installing ifo and its dependencies"
    pip_install -e '.[dev]' -c constraints.txt
}

# Succeeds if an image can be rendered; otherwise prints the reason in one line, and fails.
gl_problem() {
    $VENV/bin/python -c '
from artifacts.errors import IfoError
from stages.simulation.gl import choose_backend, forget_backend
forget_backend()  # The cached answer may be older than the libraries.
try:
    choose_backend()
except IfoError as error:
    raise SystemExit(str(error)) from None
' 2>&1 | tail -n 1
}

install_gl() {
    local problem packages
    problem=$(gl_problem) && return
    packages=$($VENV/bin/python -c 'from stages.simulation.gl import PACKAGES; print(*PACKAGES)')
    if root_with_apt; then
        say "installing $packages for rendering"
        # shellcheck disable=SC2086  # several packages
        apt_install $packages || true
        problem=$(gl_problem) && return
    fi
    die "$problem; then run \`make setup\` again"
}

make_venv
install_packages
install_gl
touch $VENV/.stamp
