#!/bin/sh
# Installs ngspice, which checks the decks, unless it is there; otherwise stops with the command to type.
set -eu

program=${RESGRID_NGSPICE:-ngspice}

stop() {
    printf 'ngspice is missing, and the tests need it. %s\n' "$1" >&2
    exit 1
}

if command -v "$program" >/dev/null 2>&1; then
    exit 0
fi
if [ -n "${RESGRID_NGSPICE:-}" ]; then
    stop "RESGRID_NGSPICE names $program, which is no program: correct or unset it."
fi

if command -v apt-get >/dev/null 2>&1; then
    by_hand='Type: sudo apt-get update && sudo apt-get install -y ngspice'
    if [ "$(id -u)" = 0 ]; then
        as_root=''
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        as_root='sudo -n'
    else
        stop "$by_hand"
    fi
    # Old package lists may do, so a failed update is no reason to stop.
    $as_root apt-get update -qq || true
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends ngspice || stop "$by_hand"
elif command -v brew >/dev/null 2>&1; then
    brew install ngspice || stop 'Type: brew install ngspice'
else
    stop "Install it with your system's packages, e.g. type: sudo dnf install ngspice (Fedora), sudo pacman -S ngspice (Arch)"
fi

command -v "$program" >/dev/null 2>&1 || stop "It was installed, but is not on PATH; add its folder to PATH."
