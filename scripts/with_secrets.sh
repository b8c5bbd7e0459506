#!/bin/sh
# Runs a command with the secrets of compose.yaml as environment variables: they stand in files of their own, and neither in the
# definition of a container nor in the list of processes.
set -eu
for file in /run/secrets/*; do
    if [ -f "$file" ]; then
        value=$(cat "$file")
        export "$(basename "$file")=$value"
    fi
done
exec "$@"
