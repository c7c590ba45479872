# Read by the other scripts: installing Debian's packages as whoever runs this may.  The script defines stop().

# by_apt PACKAGE...: as root, or with a sudo that asks for no password; otherwise stops with the command to type.
by_apt() {
    by_hand="Type: sudo apt-get update && sudo apt-get install -y $*"
    if [ "$(id -u)" = 0 ]; then
        as_root=''
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        as_root='sudo -n'
    else
        stop "$by_hand"
    fi
    # Old package lists may do, so a failed update is no reason to stop.
    $as_root apt-get update -qq || true
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" || stop "$by_hand"
}
