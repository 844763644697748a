#!/usr/bin/env bash
# Install the browser that tests of `ifo report` play videos in, where we may. Without one they are skipped.
set -euo pipefail

command -v chromium >/dev/null || command -v google-chrome >/dev/null && exit
[ "$(id -u)" = 0 ] && command -v apt-get >/dev/null || exit 0
echo "setup: installing chromium to test reports with" >&2
apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium >/dev/null ||
    echo "setup: chromium cannot be installed: tests that need it are skipped" >&2
