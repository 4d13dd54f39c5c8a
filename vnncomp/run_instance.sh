#!/bin/bash
# run_instance.sh v1 CATEGORY ONNX VNNLIB RESULTS_FILE TIMEOUT
# Writes sat (and the counterexample), unsat, unknown, timeout or error to RESULTS_FILE. SETRL names another program.
set -uo pipefail

if [ "${1:-}" != "v1" ]; then
    echo "expected the version string v1, received '${1:-}'" >&2
    exit 1
fi
if [ "$#" -ne 6 ]; then
    echo "expected v1 CATEGORY ONNX VNNLIB RESULTS_FILE TIMEOUT, received $# arguments" >&2
    exit 1
fi
onnx="$3" vnnlib="$4" results="$5" timeout="$6"
folder="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
setrl="${SETRL:-$folder/.venv/bin/setrl}"

work="$(mktemp -d)" || exit 1
trap 'rm -rf "$work"' EXIT

# unpacked NAME FILE: the file itself, or what is in FILE.gz
unpacked() {
    local file="$2"
    if [ ! -f "$file" ] && [ -f "$file.gz" ]; then
        file="$file.gz"
    fi
    case "$file" in
        *.gz) gzip -dc -- "$file" > "$work/$1" && printf '%s' "$work/$1" ;;
        *) printf '%s' "$file" ;;
    esac
}

word="error"
if network="$(unpacked network.onnx "$onnx")" && query="$(unpacked query.vnnlib "$vnnlib")"; then
    # $setrl is a program with its arguments, hence no quotes
    # shellcheck disable=SC2086
    $setrl vnnlib "$network" "$query" --timeout "$timeout" --splits 10000000 --quiet > "$work/answer"
    case "$?" in
        0 | 10 | 5) word="$(head -n 1 "$work/answer")" ;;
    esac
fi
# written at once: whoever reads the results never sees half of them
{
    case "$word" in
        sat) cat "$work/answer" ;;
        unsat | unknown | timeout) echo "$word" ;;
        *) echo "error" ;;
    esac
} > "$work/results"
cp -- "$work/results" "$results.part" && mv -- "$results.part" "$results"
