#!/bin/sh
# Installs Chromium, in which the tests draw on the live page, unless a browser is there; otherwise stops with the command
# to type.  RESGRID_CHROMIUM names another.
set -eu

stop() {
    printf 'Chromium is missing, and the tests of the live page need it. %s\n' "$1" >&2
    exit 1
}

if [ -n "${RESGRID_CHROMIUM:-}" ]; then
    command -v "$RESGRID_CHROMIUM" >/dev/null 2>&1 && exit 0
    stop "RESGRID_CHROMIUM names $RESGRID_CHROMIUM, which is no program: correct or unset it."
fi
for browser in chromium chromium-browser google-chrome google-chrome-stable; do
    command -v "$browser" >/dev/null 2>&1 && exit 0
done

if command -v apt-get >/dev/null 2>&1; then
    packages='chromium libatomic1 fonts-dejavu-core'
    by_hand="Type: sudo apt-get update && sudo apt-get install -y $packages"
    if [ "$(id -u)" = 0 ]; then
        as_root=''
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        as_root='sudo -n'
    else
        stop "$by_hand"
    fi
    # Old package lists may do, so a failed update is no reason to stop.
    $as_root apt-get update -qq || true
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $packages || stop "$by_hand"
elif command -v brew >/dev/null 2>&1; then
    brew install --cask chromium || stop 'Type: brew install --cask chromium'
else
    stop "Install it with your system's packages, e.g. type: sudo dnf install chromium (Fedora), sudo pacman -S chromium (Arch)"
fi
