#!/usr/bin/env bash
# Installs the system libraries that rendering and Open3D load, and the display of a test, where that is possible; else
# says what to install.
set -euo pipefail

libraries=(libEGL.so.1 libGLESv2.so.2 libOSMesa.so libusb-1.0.so.0 libX11.so.6 libgomp.so.1 libGL.so.1)
packages=(libegl1 libgles2 libosmesa6 libgl1-mesa-dri libusb-1.0-0 libx11-6 libgomp1 libgl1 xvfb)

if ! command -v "${PYTHON:-python3.11}" >/dev/null; then
    echo "StrideTwin needs Python 3.11: install it (Debian 12: apt-get install python3 python3-venv) or run make PYTHON=/path/to/python3.11" >&2
    exit 1
fi
if ! "${PYTHON:-python3.11}" -c 'import ensurepip, venv' 2>/dev/null; then
    packages+=(python3-venv)
    need_venv=1
fi

[ "$(uname -s)" = Linux ] || exit 0 # elsewhere the graphics libraries come with the system

missing=${need_venv:-}
known=$({ /sbin/ldconfig -p || ldconfig -p; } 2>/dev/null || true)
for library in "${libraries[@]}"; do
    grep -qF "$library" <<<"$known" || missing="$missing $library"
done
command -v Xvfb >/dev/null || missing="$missing Xvfb"
if [ -z "$missing" ] && find /usr/lib* -name 'swrast_dri.so' -print -quit 2>/dev/null | grep -q .; then
    exit 0
fi

as_root=()
if [ "$(id -u)" -ne 0 ]; then
    if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
        as_root=(sudo)
    else
        as_root=(false)
    fi
fi
if ! command -v apt-get >/dev/null || [ "${as_root[*]:-}" = false ]; then
    echo "StrideTwin needs system packages that this account cannot install. On Debian or Ubuntu run:" >&2
    echo "    sudo apt-get install ${packages[*]}" >&2
    exit 1
fi
echo "installing system packages: ${packages[*]}"
"${as_root[@]}" apt-get update -qq
DEBIAN_FRONTEND=noninteractive "${as_root[@]}" apt-get install -y -qq --no-install-recommends "${packages[@]}" >/dev/null
