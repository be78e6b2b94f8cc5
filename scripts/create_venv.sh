#!/usr/bin/env bash
# Makes .venv of this clone, with the pip and setuptools of constraints.txt.
# Needs Python 3.11 to 3.13 and nothing else: no root, no python3-venv, no pip.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

fail() {
  echo "make: $*" >&2
  exit 1
}

# A name on PATH proves nothing (a pyenv shim may stand for no version): run it.
usable() {
  "$1" -c '
import ctypes, platform, sqlite3, ssl, sys, venv, zlib
sys.exit(not ((3, 11) <= sys.version_info[:2] <= (3, 13)
              and platform.system() == "Linux" and platform.machine() == "x86_64"))
' >/dev/null 2>&1
}

choose_python() {
  local candidate
  for candidate in ${PYTHON:-python3.12 python3.13 python3.11 python3 /usr/bin/python3}; do
    if usable "$candidate"; then
      echo "$candidate"
      return
    fi
  done
  fail "no usable Python found (tried: ${PYTHON:-python3.12, 3.13, 3.11, python3});" \
    "the ROS wheels need Python 3.11, 3.12 or 3.13 on x86-64 Linux:" \
    "'sudo apt-get install python3', or name one with 'make PYTHON=/path/to/python3.12 ...'"
}

# Debian keeps venv's pip in a package of its own, which may be unpacked without root.
fetch_pip_wheel() {
  local scratch=$PWD/.venv/pip-bootstrap
  mkdir -p "$scratch"/{lists/partial,cache/archives/partial}
  local apt=(apt-get -qq -o "Dir::State::lists=$scratch/lists" -o "Dir::Cache=$scratch/cache")
  (cd "$scratch" && { apt-get -qq download python3-pip-whl \
    || { "${apt[@]}" update && "${apt[@]}" download python3-pip-whl; }; } \
    && dpkg-deb -x python3-pip-whl_*.deb .) >/dev/null 2>&1
}

add_pip() {
  local wheel other
  for other in "$python" python3 /usr/bin/python3; do
    if "$other" -m pip --python .venv/bin/python install --quiet pip >/dev/null 2>&1; then
      return
    fi
  done
  for wheel in /usr/share/python-wheels/pip-*.whl fetch; do
    if [ "$wheel" = fetch ]; then
      fetch_pip_wheel || break
      wheel=$(echo .venv/pip-bootstrap/usr/share/python-wheels/pip-*.whl)
    fi
    if PYTHONPATH=$wheel .venv/bin/python -m pip install --quiet pip >/dev/null 2>&1; then
      rm -rf .venv/pip-bootstrap
      return
    fi
  done
  fail "$python has no pip and none could be fetched (no network?):" \
    "'sudo apt-get install $(basename "$python")-venv', then make again"
}

python=$(choose_python)
echo "Making .venv with $("$python" -V) ($python)"
if ! "$python" -m venv --clear .venv >/dev/null 2>&1; then
  "$python" -m venv --clear --without-pip .venv || fail "$python cannot make .venv in $PWD"
  add_pip
fi
.venv/bin/python -m pip install --quiet --disable-pip-version-check \
  -c constraints.txt pip setuptools
