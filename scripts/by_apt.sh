# Sourced by the other scripts: install Debian packages.  The calling script defines stop().

# by_apt PACKAGE...: run as root, or with sudo without a password; otherwise stop with the command to run.
by_apt() {
    by_hand="Type: sudo apt-get update && sudo apt-get install -y $*"
    if [ "$(id -u)" = 0 ]; then
        as_root=''
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        as_root='sudo -n'
    else
        stop "$by_hand"
    fi
    # Old package lists can be sufficient, so a failed update is not an error.
    $as_root apt-get update -qq || true
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" || stop "$by_hand"
}
