#!/bin/sh
# Make .venv and install bcapscope into it. With the word "test": from this folder, so that changes count at
# once, together with what its tests need. May be run again at any time. Says what it does on stderr.
set -eu
cd "$(dirname "$0")"

say() { echo "setup: $*" >&2; }

die() {
    say "$*"
    exit 1
}

new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }

find_python() {
    for name in python3 python3.14 python3.13 python3.12 python3.11; do
        if new_enough "$name"; then
            command -v "$name"
            return
        fi
    done
    return 1
}

as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi
}

# Debian and Ubuntu keep the part of Python that makes environments in a package of its own.
install_venv() {
    package=$("$1" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
    command -v apt-get >/dev/null || die "$1 has no ensurepip; install $package or its like, then run this again"
    [ "$(id -u)" = 0 ] || command -v sudo >/dev/null || die "as root: apt-get install $package, then run this again"
    say "installing $package"
    as_root apt-get -qq update >/dev/null
    as_root env DEBIAN_FRONTEND=noninteractive apt-get -qq -y -o Dpkg::Use-Pty=0 \
        install --no-install-recommends "$package" >/dev/null || die "apt-get could not install $package"
}

case "${1-}" in
    "") what=. ;;
    test) what='-e .[test]' ;;
    *) die "usage: sh setup.sh [test]" ;;
esac

if ! new_enough .venv/bin/python || ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
    python=$(find_python) || die "no Python 3.11 or newer found; apt-get install python3.11 may give one"
    "$python" -c 'import ensurepip, venv' 2>/dev/null || install_venv "$python"
    say "making .venv with $python"
    "$python" -m venv --clear .venv
fi
say "installing into .venv: pip install $what"
# shellcheck disable=SC2086 # two words where there are two
.venv/bin/python -m pip install --quiet --disable-pip-version-check $what
