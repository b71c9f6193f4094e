#!/bin/sh
# Bring .venv up to date: a Python of 3.11 to 3.13, the system libraries Open3D loads, the project and its packages.
#
#   sh tools/setup.sh          what running semmap needs
#   sh tools/setup.sh dev      the same, and what testing it needs
#
# Does nothing, quickly, when nothing changed since the last time. PYTHON=... chooses an interpreter.
set -eu
cd "$(dirname "$0")/.."
extra=${1:-run}
venv=.venv
say() { echo "semmap setup: $*" >&2; }
die() { say "$*"; exit 1; }

# --- already done? ----------------------------------------------------------------------------------------------
fingerprint=$(cat pyproject.toml tools/setup.sh | cksum | tr -c '0-9\n' '-')$(pwd | cksum | cut -d' ' -f1)
done_for() { [ "$(cat "$venv/.semmap-$1" 2>/dev/null)" = "$fingerprint" ] && [ -x "$venv/bin/python" ]; }
if done_for dev || done_for "$extra"; then exit 0; fi

# --- Debian packages, where we may install them -----------------------------------------------------------------
as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi
}
may_install() {
    command -v apt-get >/dev/null 2>&1 || return 1
    [ "$(id -u)" = 0 ] || { command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; }
}
apt_updated=no
apt_update() {
    [ $apt_updated = yes ] || as_root apt-get update -q >&2 || say "apt-get update failed; trying with the old list"
    apt_updated=yes
}
apt_install() {
    apt_update
    say "installing $*"
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "$@" >&2
}

# --- a Python -----------------------------------------------------------------------------------------------------
fits() {  # an interpreter of the right version
    "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' >/dev/null 2>&1
}
makes_venvs() { "$1" -c 'import ensurepip, venv' >/dev/null 2>&1; }
find_python() {
    python=
    for candidate in ${PYTHON:-} python3 python3.12 python3.13 python3.11; do
        if fits "$candidate" && makes_venvs "$candidate"; then python=$candidate; return 0; fi
    done
    return 1
}
install_python() {
    apt_update
    for version in $(python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) 3.12 3.13 3.11; do
        case $version in 3.11 | 3.12 | 3.13) ;; *) continue ;; esac
        if apt-cache show "python$version-venv" >/dev/null 2>&1; then
            apt_install "python$version" "python$version-venv" && return 0
        fi
    done
    return 1
}
if ! find_python; then
    if may_install; then install_python || true; fi
    find_python || die "needs Python 3.11, 3.12 or 3.13 with venv: install it" \
        "(Debian 12: apt-get install python3 python3-venv; Ubuntu 22.04: python3.11 python3.11-venv) or set PYTHON=..."
fi

# --- the libraries Open3D loads -----------------------------------------------------------------------------------
missing_packages() {
    ldconfig=$(command -v ldconfig || echo /sbin/ldconfig)
    [ -x "$ldconfig" ] || return 0
    known=$("$ldconfig" -p)
    for pair in libusb-1.0.so.0:libusb-1.0-0 libGL.so.1:libgl1 libEGL.so.1:libegl1 libX11.so.6:libx11-6 \
        libudev.so.1:libudev1 libgomp.so.1:libgomp1; do
        case $known in *"${pair%%:*} "*) ;; *) printf '%s ' "${pair##*:}" ;; esac
    done
}
missing=$(missing_packages)
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086  # a list of package names
    if may_install; then apt_install $missing || true; fi
    missing=$(missing_packages)
    [ -z "$missing" ] || die "Open3D needs system libraries; run: sudo apt-get install $missing"
fi

# --- the virtual environment ------------------------------------------------------------------------------------
if ! fits "$venv/bin/python"; then
    say "making $venv with $("$python" --version)"
    rm -rf "$venv"
    "$python" -m venv "$venv"
fi
case $extra in dev) what='.[dev]' ;; *) what=. ;; esac
say "installing Python packages (the first time takes a few minutes)"
"$venv/bin/python" -m pip install -q --disable-pip-version-check --no-input -e "$what" ||
    die "pip could not install the packages; see its message above"
"$venv/bin/python" -c 'import open3d, gtsam' >/dev/null || die "Open3D or gtsam does not load; see the message above"
echo "$fingerprint" >"$venv/.semmap-$extra"
