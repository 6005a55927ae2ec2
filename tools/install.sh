#!/usr/bin/env bash
# Installs StrideTwin with some of its extras, from the checkout, into the environment in .venv, as constraints.txt pins
# it: by uv, which is several times as fast as pip, or by pip where uv cannot be had.
#
#     bash tools/install.sh EXTRA,EXTRA
set -euo pipefail

venv=${VENV:-.venv}
extras=$1

python=${PYTHON:-python3.11}
"$python" stridetwin/links.py 2>/dev/null || { "$python" stridetwin/links.py 2>&1 | tail -n 1 >&2; exit 1; }

[ -x "$venv/bin/python" ] || { echo "creating $venv"; "$python" -m venv "$venv"; }
echo "installing the pinned environment into $venv: $extras"

pip=("$venv/bin/python" -m pip install --quiet --disable-pip-version-check)
[ -x "$venv/bin/uv" ] || "${pip[@]}" -c constraints.txt uv || true
if [ -x "$venv/bin/uv" ] &&
    "$venv/bin/uv" pip install --quiet --python "$venv/bin/python" -c constraints.txt -e ".[$extras]"; then
    exit 0
fi
echo "uv could not install it; pip does, which takes longer"
"${pip[@]}" -c constraints.txt -e ".[$extras]"
