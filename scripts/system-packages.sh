#!/usr/bin/env bash
# Makes sure that the system libraries behind Open3D (pictures) and its CPU renderer are there.
# On Debian and its relatives, as root, it installs exactly what is missing; otherwise it names it and stops.
# Usage: scripts/system-packages.sh [FURTHER_PACKAGE...]     e.g. chromium postgresql, for the tests that need them
set -euo pipefail

packages=(libusb-1.0-0 libvulkan1 mesa-vulkan-drivers libgl1 libegl1 "$@")

# What tells that a package's content is there, however it came.
present() {
    case "$1" in
        libusb-1.0-0) has_library libusb-1.0.so.0 ;;
        libvulkan1) has_library libvulkan.so.1 ;;
        libgl1) has_library libGL.so.1 ;;
        libegl1) has_library libEGL.so.1 ;;
        mesa-vulkan-drivers) compgen -G '/usr/share/vulkan/icd.d/*.json' >/dev/null ;;
        chromium) command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null ;;
        postgresql) compgen -G '/usr/lib/postgresql/*/bin/initdb' >/dev/null || command -v initdb >/dev/null ;;
        *) dpkg-query -W -f='${Status}' "$1" 2>/dev/null | grep -q 'install ok installed' ;;
    esac
}

has_library() {
    local known
    known="$("$(command -v ldconfig || echo /sbin/ldconfig)" -p)"
    [[ "$known" == *"$1"* ]]
}

missing=()
for package in "${packages[@]}"; do
    present "$package" || missing+=("$package")
done
[ "${#missing[@]}" -eq 0 ] && exit 0

if ! command -v apt-get >/dev/null; then
    echo "error: install with your package manager what Debian calls: ${missing[*]}" >&2
    exit 1
fi
if [ "$(id -u)" -ne 0 ]; then
    echo "error: system packages are missing; run: sudo apt-get update && sudo apt-get install ${missing[*]}" >&2
    exit 1
fi
echo "installing system packages: ${missing[*]}"
export DEBIAN_FRONTEND=noninteractive
apt-get update -qq
apt-get install -y -qq --no-install-recommends "${missing[@]}"
