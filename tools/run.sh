#!/bin/sh
# Runs a Python program of tools/ with a Python that can build the workspace: $PYTHON if given, else the first 3.12 or 3.11 on the path
# that really runs (a pyenv shim may not), best one with headers and venv. What is missing all the same is said by tools/setup.py.
here=$(cd "$(dirname "$0")/.." && pwd)
probe='import sys; sys.exit(0 if (3, 11) <= sys.version_info[:2] <= (3, 12) else 1)'
whole='import importlib.util as u, os, sysconfig, sys
h = os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h"))
sys.exit(0 if h and u.find_spec("venv") and u.find_spec("ensurepip") else 1)'
found=""
try() {
    "$1" -c "$probe" >/dev/null 2>&1 || return 1
    [ -z "$found" ] && found=$1
    "$1" -c "$whole" >/dev/null 2>&1 && found=$1
}
search() {
    for name in python3.12 python3.11 python3; do
        old=$IFS
        IFS=:
        for folder in $PATH; do
            IFS=$old
            [ -x "$folder/$name" ] && try "$folder/$name" && return
        done
        IFS=$old
    done
}
if [ -n "$PYTHON" ]; then
    found=$PYTHON
else
    search
fi
if [ -z "$found" ]; then
    echo "setup: RIINS needs Python 3.11 or 3.12 and none was found: install one (Debian, Ubuntu: apt install python3 python3-dev python3-venv) or name it with PYTHON=/path/to/python3 make ..." >&2
    exit 1
fi
program=$1
shift
cd "$here" && exec "$found" "$program" "$@"
