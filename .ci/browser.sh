#!/usr/bin/env bash
# Install the browser in which tests of `ifo report` play videos, if apt-get can. Without a browser they are skipped.
set -euo pipefail
# shellcheck source=.ci/apt.sh
source "$(dirname "$0")/apt.sh"

for browser in chromium google-chrome; do
    if command -v $browser >/dev/null; then exit; fi
done
root_with_apt || exit 0
echo "setup: installing chromium for the tests of reports" >&2
apt_install chromium || echo "setup: chromium cannot be installed: tests that need it are skipped" >&2
