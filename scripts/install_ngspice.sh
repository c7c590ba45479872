#!/bin/sh
# Install ngspice, which checks decks, unless it is installed.  If the installation is not possible, stop with the command
# to run.  NGSPICE_VERSION=46 requests a version: on Debian the version of the backports, from a separate list of sources,
# so that the system's lists are unchanged.  resgrid is tested with 39 (Debian 12) and 46 (its backports).
set -eu
. "${0%/*}/by_apt.sh"

program=${RESGRID_NGSPICE:-ngspice}
version=${NGSPICE_VERSION:-}

stop() {
    printf 'ngspice is missing, and the tests need it. %s\n' "$1" >&2
    exit 1
}

is_there() {
    command -v "$program" >/dev/null 2>&1 || return 1
    [ -z "$version" ] && return 0
    case $("$program" --version 2>/dev/null) in *"ngspice-$version"[!0-9]*) return 0 ;; *) return 1 ;; esac
}

is_there && exit 0
if [ -n "${RESGRID_NGSPICE:-}" ]; then
    stop "RESGRID_NGSPICE names $program, which is not a program${version:+ of version $version}: correct or unset it."
fi

if command -v apt-get >/dev/null 2>&1; then
    by_apt ngspice
    if ! is_there && [ -n "$version" ]; then
        release=$(. "${OS_RELEASE:-/etc/os-release}" && printf '%s' "${VERSION_CODENAME:-}")
        [ -n "$release" ] || stop "This system has no backports: install version $version by hand, and name it in RESGRID_NGSPICE."
        own=$(mktemp -d)
        trap '$as_root rm -rf "$own"' EXIT
        mkdir -p "$own/lists/partial"
        chmod -R a+rX "$own"
        for suite in "$release" "$release-backports"; do
            printf 'deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] http://deb.debian.org/debian %s main\n' "$suite"
        done >"$own/sources.list"
        options="-o Dir::Etc::sourcelist=$own/sources.list -o Dir::Etc::sourceparts=- -o Dir::State::lists=$own/lists"
        $as_root apt-get $options update -qq || stop "The backports of $release cannot be reached."
        $as_root env DEBIAN_FRONTEND=noninteractive apt-get $options install -y -qq --no-install-recommends \
            -t "$release-backports" ngspice || stop "$by_hand"
    fi
elif command -v brew >/dev/null 2>&1; then
    brew install ngspice || stop 'Type: brew install ngspice'
else
    stop "Install it with your system's packages, e.g. type: sudo dnf install ngspice (Fedora), sudo pacman -S ngspice (Arch)"
fi

command -v "$program" >/dev/null 2>&1 || stop "ngspice is installed, but not on PATH; add its folder to PATH."
is_there || stop "The installed ngspice is not version $version: install that version by hand, and name it in RESGRID_NGSPICE."
