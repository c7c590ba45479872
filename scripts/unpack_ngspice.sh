#!/bin/sh
# Unpack the ngspice of Debian's backports into a folder, for comparisons, without changes to the system.
# unpack_ngspice.sh FOLDER creates FOLDER/usr/bin/ngspice, or prints the reason why it cannot.
set -eu

folder=$1
[ -x "$folder/usr/bin/ngspice" ] && exit 0
release=$(. "${OS_RELEASE:-/etc/os-release}" && printf '%s' "${VERSION_CODENAME:-}")
if ! command -v apt-get >/dev/null 2>&1 || [ -z "$release" ]; then
    echo "this system has no backports; the benchmarks use the ngspice on PATH" >&2
    exit 1
fi
own=$(mktemp -d)
trap 'rm -rf "$own"' EXIT
mkdir -p "$own/lists/partial" "$folder"
folder=$(cd "$folder" && pwd)
for suite in "$release" "$release-backports"; do
    printf 'deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] http://deb.debian.org/debian %s main\n' "$suite"
done >"$own/sources.list"
cd "$own"
options="-o Dir::Etc::sourcelist=$own/sources.list -o Dir::Etc::sourceparts=- -o Dir::State::lists=$own/lists"
options="$options -o Dir::Cache=$own -o APT::Sandbox::User="
apt-get $options update -qq && apt-get $options download -qq -t "$release-backports" ngspice
dpkg -x ngspice_*.deb "$folder"
