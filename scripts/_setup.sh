# Sourced by scripts/test and scripts/demo: one virtual environment, .venv, made and filled when it has to be.
# shellcheck shell=bash

ROOT="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
VENV="$ROOT/.venv"

say() { printf '\n==> %s\n' "$*"; }
die() {
    printf '\nerror: %s\n' "$*" >&2
    exit 1
}

# Print the first Python >= 3.10 that can make virtual environments.
find_python() {
    local candidate found_old=""
    for candidate in "${PYTHON:-python3}" python3 python3.13 python3.12 python3.11 python3.10; do
        command -v "$candidate" >/dev/null 2>&1 || continue
        if ! "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 10))' >/dev/null 2>&1; then
            found_old="$candidate"
            continue
        fi
        if "$candidate" -c 'import ensurepip, venv' >/dev/null 2>&1; then
            command -v "$candidate"
            return
        fi
        die "$candidate cannot make virtual environments. On Debian or Ubuntu: apt-get install python3-venv"
    done
    [ -n "$found_old" ] && die "$found_old is older than Python 3.10; install a newer one or set PYTHON=/path/to/python"
    die "no python3 found. On Debian or Ubuntu: apt-get install python3 python3-venv"
}

# setup_venv EXTRAS: afterwards .venv holds the checkout, editable, with these extras ("" for none).
# A stamp remembers what was installed from which pyproject.toml, so that the second run installs nothing.
setup_venv() {
    local extras="$1" python digest stamp target="$ROOT"
    if [ ! -x "$VENV/bin/python" ]; then
        python="$(find_python)" || exit 1
        say "Making $VENV with $("$python" --version)"
        "$python" -m venv "$VENV" || die "could not make $VENV"
    fi
    digest="$("$VENV/bin/python" -c '
import hashlib, pathlib, sys
digest = hashlib.sha256(sys.version.encode() + sys.argv[1].encode())
digest.update(pathlib.Path(sys.argv[1], "pyproject.toml").read_bytes())
print(digest.hexdigest())' "$ROOT")" || die "$VENV is unusable; delete it and run again"
    stamp="$VENV/.installed-${extras:-core}"
    # Everything that the demo needs is in the test environment, too.
    for candidate in "$stamp" "$VENV/.installed-dev,notebooks"; do
        if [ -f "$candidate" ] && [ "$(cat "$candidate")" = "$digest" ]; then
            return
        fi
    done
    [ -n "$extras" ] && target="$ROOT[$extras]"
    say "Installing $target (a few minutes the first time)"
    "$VENV/bin/python" -m pip install --quiet --disable-pip-version-check --editable "$target" || die "pip install failed"
    printf '%s\n' "$digest" >"$stamp"
}

# Print the browser that scripts/screenshot would take; fail where there is none.
find_chromium() {
    local name
    for name in "${CHROMIUM:-}" chromium chromium-browser google-chrome; do
        if [ -n "$name" ] && command -v "$name"; then return; fi
    done
    return 1
}

# Tests that look at pictures need a Chromium; without one they are skipped.
setup_chromium() {
    find_chromium >/dev/null && return
    if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null 2>&1; then
        say "Installing chromium"
        apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null ||
            die "apt-get install chromium failed"
    else
        say "No chromium: the tests that look at pictures will be skipped (Debian: apt-get install chromium)"
    fi
}
