#!/usr/bin/env bash
# Install the browser that tests of `ifo report` play videos in, where we may. Without one they are skipped.
set -euo pipefail

for browser in chromium google-chrome; do
    if command -v $browser >/dev/null; then exit; fi
done
if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then exit; fi
echo "setup: installing chromium to test reports with" >&2
export DEBIAN_FRONTEND=noninteractive
if ! { apt-get update -qq && apt-get install -qq -y --no-install-recommends chromium; } >/dev/null; then
    echo "setup: chromium cannot be installed: tests that need it are skipped" >&2
fi
