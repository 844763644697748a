#!/usr/bin/env bash
# Make .venv: pinned packages, the CPU build of torch if there is no GPU, and the OpenGL libraries for rendering.
# `make` runs it when pyproject.toml or constraints.txt is newer than the last run that succeeded.
set -euo pipefail
cd "$(dirname "$0")/.."
# shellcheck source=.ci/apt.sh
source .ci/apt.sh

readonly VENV=.venv
readonly TORCH_CPU_INDEX=https://download.pytorch.org/whl/cpu

say() { echo "setup: $*" >&2; }
die() { say "$*"; exit 4; }

# dm-control needs labmaze, which has no wheel for later versions. The same range as requires-python in pyproject.toml.
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

# --use-pep517: what comes as a source distribution without pyproject.toml is built by the supported route.
pip_install() {
    quietly $VENV/bin/python -m pip install --quiet --disable-pip-version-check --use-pep517 "$@" ||
        die "pip cannot install the packages (its messages are above)"
}

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

# Prints why nothing can be rendered, on one line, and fails; succeeds if a picture was rendered just now.
gl_problem() {
    $VENV/bin/python -c '
from artifacts.errors import IfoError
from stages.simulation.gl import choose_backend, forget_backend
forget_backend()  # The remembered answer may be older than the libraries.
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
