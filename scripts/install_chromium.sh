#!/bin/sh
# Install Chromium for the tests of the live page, unless a browser is installed.  If the installation is not possible,
# stop with the command to run.  RESGRID_CHROMIUM selects another binary.
set -eu
. "${0%/*}/by_apt.sh"

stop() {
    printf 'Chromium is missing, and the tests of the live page need it. %s\n' "$1" >&2
    exit 1
}

if [ -n "${RESGRID_CHROMIUM:-}" ]; then
    command -v "$RESGRID_CHROMIUM" >/dev/null 2>&1 && exit 0
    stop "RESGRID_CHROMIUM names $RESGRID_CHROMIUM, which is not a program: correct or unset it."
fi
for browser in chromium chromium-browser google-chrome google-chrome-stable; do
    command -v "$browser" >/dev/null 2>&1 && exit 0
done

if command -v apt-get >/dev/null 2>&1; then
    by_apt chromium libatomic1 fonts-dejavu-core
elif command -v brew >/dev/null 2>&1; then
    brew install --cask chromium || stop 'Type: brew install --cask chromium'
else
    stop "Install it with your system's packages, e.g. type: sudo dnf install chromium (Fedora), sudo pacman -S chromium (Arch)"
fi
