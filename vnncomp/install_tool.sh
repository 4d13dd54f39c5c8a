#!/bin/bash
# install_tool.sh v1: installs setrl from this checkout into a virtual environment beside these scripts.
set -euo pipefail

if [ "${1:-}" != "v1" ]; then
    echo "expected the version string v1, received '${1:-}'" >&2
    exit 1
fi

folder="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
python="${SETRL_BASE_PYTHON:-python3}"
"$python" -m venv "$folder/.venv"
"$folder/.venv/bin/python" -m pip install --quiet "$folder/.."
"$folder/.venv/bin/setrl" --version
