#!/usr/bin/env bash
# Sets up everything that `make demo` and `make test` need: a virtual environment with the locked dependencies, and PostGIS
# from the system's packages. Does nothing when it is all there already.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { printf '\033[1m%s\033[0m\n' "$*"; }
fail() { printf 'conetl setup: %s\n' "$*" >&2; exit 2; }

can_install() { command -v apt-get >/dev/null && { [ "$(id -u)" = 0 ] || sudo -n true 2>/dev/null; }; }
install_packages() {
  local sudo=(); [ "$(id -u)" = 0 ] || sudo=(sudo -n)
  say "Installing $* from the system's packages"
  "${sudo[@]}" apt-get update -qq
  "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

# --- Python
python=${PYTHON:-python3}
command -v "$python" >/dev/null || fail "no $python on this machine: install Python 3.11 or newer, or name it: make PYTHON=/path/to/python3.12 ..."
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  fail "$("$python" --version) is too old: conetl needs Python 3.11 or newer; name one: make PYTHON=/path/to/python3.12 ..."

# --- packages of the system, all asked for at once
have_postgis() { compgen -G '/usr/share/postgresql/*/extension/postgis.control' >/dev/null || { command -v pg_config >/dev/null && [ -f "$(pg_config --sharedir)/extension/postgis.control" ]; }; }
missing=()
"$python" -c 'import ensurepip, venv' 2>/dev/null || missing+=(python3-venv)
[ -n "${CONETL_DATABASE_URL:-}" ] || have_postgis || missing+=(postgresql postgresql-postgis)
if [ ${#missing[@]} -gt 0 ]; then
  can_install || fail "this user may not install packages: have 'apt install ${missing[*]}' run, then run this again. Instead of PostGIS here, CONETL_DATABASE_URL may name a database that has it."
  install_packages "${missing[@]}"
fi

# --- the environment
# With the version of Python: after an upgrade of the operating system .venv has a Python without any packages.
lock() { { sha256sum requirements.txt pyproject.toml; .venv/bin/python --version; } 2>/dev/null | sha256sum | cut -d' ' -f1; }
if [ "$(cat .venv/.conetl-lock 2>/dev/null)" != "$(lock)" ]; then
  say "Setting up the Python environment in .venv (a minute or two)"
  .venv/bin/python -m pip --version >/dev/null 2>&1 || "$python" -m venv --clear .venv
  # The lock names every package there is: nothing to resolve, and nothing that a release of tomorrow could change.
  pip_install() { .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-compile --no-deps "$@"; }
  uv_install() {
    pip_install --require-hashes -r <(sed -n '/^uv==/,/[^\\]$/p' requirements.txt) &&
      .venv/bin/uv pip install --quiet --no-cache --python .venv/bin/python --no-deps --require-hashes -r requirements.txt
  }
  # uv installs in a quarter of pip's time, but does not know pip's settings, such as an index of one's own.
  uv_install || { say "uv cannot install the packages; pip does"; pip_install --require-hashes -r requirements.txt; }
  pip_install --no-build-isolation -e .
  # Bytecode of what conetl uses, not of all 18,000 files. Where PYTHONDONTWRITEBYTECODE is set, as in many containers, every
  # process would otherwise compile Prefect again: 4 s for the server alone.
  env -u PYTHONDONTWRITEBYTECODE .venv/bin/python scripts/import_all.py
  lock > .venv/.conetl-lock
fi
