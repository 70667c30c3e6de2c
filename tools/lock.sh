#!/bin/sh
# Makes the hashed lock files anew from runtime.in and build.in, one for each Python; versions that are locked and still fit are kept.
set -e
cd "$(dirname "$0")/requirements"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cat runtime.in build.in >"$work/all.in"
for version in 3.11 3.12; do
    cp "lock-$version.txt" "$work/"
    (cd "$work" && uv pip compile --quiet --generate-hashes --no-header \
        --python-version "$version" --python-platform linux --output-file "lock-$version.txt" all.in)
    cp "$work/lock-$version.txt" .
done
