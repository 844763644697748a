# Functions that install Debian packages, for the other scripts in this folder. Output is printed only on failure.

root_with_apt() { [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; }

quietly() {
    local output
    output=$("$@" 2>&1) && return
    printf '%s\n' "$output" >&2
    return 1
}

apt_install() {
    quietly apt-get update -qq &&
        DEBIAN_FRONTEND=noninteractive quietly apt-get install -qq -y --no-install-recommends "$@"
}
