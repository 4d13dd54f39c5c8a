#!/bin/bash
# prepare_instance.sh v1 CATEGORY ONNX VNNLIB: exit code 0 where the instance can be tried, 1 where not.
# Ends no process of others: an instance leaves none behind.
set -euo pipefail

if [ "${1:-}" != "v1" ]; then
    echo "expected the version string v1, received '${1:-}'" >&2
    exit 1
fi
if [ "$#" -ne 4 ]; then
    echo "expected v1 CATEGORY ONNX VNNLIB, received $# arguments" >&2
    exit 1
fi
for file in "$3" "$4"; do
    if [ ! -f "$file" ] && [ ! -f "$file.gz" ]; then
        echo "there is no file $file" >&2
        exit 1
    fi
done
