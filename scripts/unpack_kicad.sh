#!/bin/sh
# Unpack KiCad 9 of Debian's backports into a folder, to check boards, without changes to the system.
# unpack_kicad.sh FOLDER creates FOLDER/kicad-cli, or prints the reason why it cannot.
# A system-wide installation would replace the system's ngspice, so KiCad and the libraries that it needs are unpacked.
set -eu

stop() {
    printf 'kicad-cli cannot be unpacked. %s\n' "$1" >&2
    exit 1
}

folder=$1
[ -x "$folder/kicad-cli" ] && exit 0
release=$(. "${OS_RELEASE:-/etc/os-release}" && printf '%s' "${VERSION_CODENAME:-}")
by_hand="Install KiCad 9 or newer (https://www.kicad.org/download), and name its kicad-cli in RESGRID_KICAD_CLI."
if ! command -v apt-get >/dev/null 2>&1 || [ "$release" != bookworm ]; then
    stop "This system is not Debian 12. $by_hand"
fi
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
own=$(mktemp -d)
trap 'rm -rf "$own"' EXIT
mkdir -p "$own/lists/partial" "$own/archives/partial"
for suite in "$release" "$release-backports"; do
    printf 'deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] http://deb.debian.org/debian %s main\n' "$suite"
done >"$own/sources.list"
options="-o Dir::Etc::sourcelist=$own/sources.list -o Dir::Etc::sourceparts=- -o Dir::State::lists=$own/lists"
options="$options -o Dir::Cache=$own -o APT::Sandbox::User= -o Debug::NoLocking=true"
apt-get $options update -qq || stop "The backports of $release cannot be reached; try again later."
# The packages that KiCad needs and the system lacks; ngspice is upgraded only in a system-wide installation.
apt-get $options install --download-only --yes -qq --no-install-recommends -t "$release-backports" kicad >/dev/null ||
    stop "Its packages cannot be downloaded; try again later. $by_hand"
for package in "$own"/archives/*.deb; do
    case $package in */ngspice_*) continue ;; esac
    dpkg-deb --extract "$package" "$folder" || stop "$package cannot be unpacked; is the disk full?"
done

# KiCad writes its settings into a folder of its own, so that a person's settings neither change nor matter.
cat >"$folder/kicad-cli.new" <<'END'
#!/bin/sh
root=$(cd "$(dirname "$(readlink -f "$0")")" && pwd)
libraries=$(echo "$root"/usr/lib/*-linux-gnu)
LD_LIBRARY_PATH="$libraries:$libraries/kicad${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"
KICAD_CONFIG_HOME=${KICAD_CONFIG_HOME:-$root/settings}
KICAD_STOCK_DATA_HOME=$root/usr/share/kicad
export LD_LIBRARY_PATH KICAD_CONFIG_HOME KICAD_STOCK_DATA_HOME
exec "$root/usr/bin/kicad-cli" "$@"
END
chmod +x "$folder/kicad-cli.new"
version=$("$folder/kicad-cli.new" version) || stop "The unpacked program does not start. $by_hand"
mv "$folder/kicad-cli.new" "$folder/kicad-cli"
echo "unpacked kicad-cli $version into $folder"
