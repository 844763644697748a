#!/usr/bin/env bash
# Try the current commit on a bare Debian 12 that has only git and make: setup, `ifo doctor`, the toy pipeline and a
# sample of the tests. Needs root and debootstrap. TMPDIR is the location of the folder (4 GB, or 8 GB with the CUDA
# build of torch); TESTS selects the tests.
set -euo pipefail
cd "$(dirname "$0")/.."
# shellcheck source=.ci/apt.sh
source .ci/apt.sh

readonly SUITE=bookworm
readonly DEFAULT_TESTS="tests/artifacts tests/ifo_cli tests/stages/simulation"

say() { echo "fresh: $*" >&2; }
die() { say "$*"; exit 4; }

outside() {
    local program
    [ "$(id -u)" = 0 ] || die "this needs root, to install Debian in a folder: sudo make fresh"
    for program in debootstrap unshare setpriv git; do
        command -v $program >/dev/null || die "$program is missing: apt-get install -y debootstrap util-linux git"
    done
    [ -z "$(git status --porcelain)" ] || say "uncommitted changes are ignored"
    folder=$(mktemp -d "${TMPDIR:-/tmp}/ifo-fresh.XXXXXX")
    namespace=
    trap clean_up EXIT
    trap 'exit 130' INT
    trap 'exit 143' TERM
    trap 'exit 129' HUP
    # All mounts are in a separate namespace, which ends with its processes, and these end with this script. It runs in
    # the background, because bash does not handle signals while it waits for a command in the foreground.
    setpriv --pdeathsig KILL unshare --mount --pid --fork --kill-child --mount-proc \
        bash .ci/fresh.sh inside "$folder/root" &
    namespace=$!
    wait $namespace
    say "ifo works on a bare Debian"
}

clean_up() {
    trap '' INT TERM HUP
    say "removing $folder"
    if [ -n "$namespace" ]; then
        kill -KILL $namespace 2>/dev/null || true
        wait $namespace 2>/dev/null || true
    fi
    for _ in {1..50}; do  # The processes in the namespace need a moment to end.
        rm -rf --one-file-system "$folder" 2>/dev/null && return
        sleep 0.2
    done
    say "$folder cannot be removed"
}

inside() {
    local root=$1 tests=${TESTS:-$DEFAULT_TESTS}
    unset TMPDIR  # It need not exist in the bare Debian.
    say "installing a minimal Debian ($SUITE) in $root"
    bootstrap "$root"
    hand_on_network "$root"
    hand_on_pip "$root"
    say "cloning $(git rev-parse --short HEAD)"
    git clone --quiet --depth 1 "file://$PWD" "$root/root/ifo"
    say "make setup"
    in_root "$root" make setup
    say "ifo doctor"
    in_root "$root" .venv/bin/ifo doctor
    say "the toy pipeline"
    in_root "$root" bash -o pipefail -c 'PATH=$PWD/.venv/bin:$PATH
        ifo collect-demos reach --preset toy | ifo train-translator | ifo translate | ifo learn-policy | ifo evaluate --json'
    say "tests: $tests"
    # shellcheck disable=SC2086  # several paths
    in_root "$root" .venv/bin/python -m pytest -q -n auto --dist loadfile $tests
}

# Uses the mirror that this machine's apt uses for the suite, or else debootstrap's default.
bootstrap() {
    local root=$1 mirror
    mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' "Release: $SUITE" 2>/dev/null | sed -n 1p) ||
        true
    quietly debootstrap --variant=minbase --include=git,make,ca-certificates $SUITE "$root" ${mirror:+"$mirror"} ||
        die "debootstrap failed (see its messages above)"
    mount -t proc proc "$root/proc"
    mount --rbind /dev "$root/dev"
}

# Copies this machine's network settings: host names, certificates, and apt's proxies and passwords.
hand_on_network() {
    local root=$1 name
    for name in resolv.conf hosts apt/auth.conf apt/auth.conf.d; do
        if [ -e "/etc/$name" ]; then (cd /etc && cp -rL --parents "$name" "$root/etc/"); fi
    done
    if command -v apt-config >/dev/null; then apt-config dump Acquire > "$root/etc/apt/apt.conf.d/99host"; fi
    if [ -d /usr/local/share/ca-certificates ]; then
        cp -rL /usr/local/share/ca-certificates "$root/usr/local/share/"
        quietly chroot "$root" update-ca-certificates
    fi
}

# Copies this machine's pip settings. Package folders are mounted read-only, because they may be large.
hand_on_pip() {
    local root=$1 path
    { python3 -m pip config list || pip config list || true; } 2>/dev/null |
        python3 .ci/pip_settings.py "$root" > "$root/tmp/paths"
    while read -r path; do
        if [ -z "$path" ] || [ -e "$root$path" ]; then continue; fi
        if [ -d "$path" ]; then
            mkdir -p "$root$path"
            mount --bind "$path" "$root$path"
            mount -o remount,bind,ro "$root$path"
        else
            install -D -m 644 "$path" "$root$path"
        fi
    done < "$root/tmp/paths"
}

# Run a command in the clone. From this machine's environment, only the proxy variables are kept.
in_root() {
    local root=$1 name settings=()
    shift
    for name in http_proxy https_proxy no_proxy HTTP_PROXY HTTPS_PROXY NO_PROXY; do
        if [ -n "${!name:-}" ]; then settings+=("$name=${!name}"); fi
    done
    chroot "$root" /usr/bin/env --ignore-environment --chdir=/root/ifo HOME=/root TERM="${TERM:-dumb}" \
        PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin "${settings[@]}" "$@"
}

if [ "${1:-}" = inside ]; then inside "$2"; else outside; fi
