# Sourced by scripts/test and scripts/demo: one virtual environment, .venv, made and filled when it has to be.
# shellcheck shell=bash

ROOT="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
VENV="$ROOT/.venv"
unset PYTHONDONTWRITEBYTECODE # each of many processes would compile what it imports, again and again

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

# install ARGUMENTS: into .venv, by uv where it is there, else by pip. uv does not read pip's settings (an index of one's
# own, say), so where it fails pip tries, too. The pip that comes with Python 3.10 searches for very long: a newer one.
install() {
    local pip=("$VENV/bin/python" -m pip --disable-pip-version-check)
    if command -v uv >/dev/null 2>&1; then
        uv pip install --quiet --python "$VENV/bin/python" "$@" && return
        say "uv could not install it; trying pip"
    fi
    if ! "$VENV/bin/python" -c 'import pip, sys; sys.exit(int(pip.__version__.split(".")[0]) < 24)' 2>/dev/null; then
        "$VENV/bin/python" -m ensurepip >/dev/null 2>&1 || true # an environment that uv made has no pip
        "${pip[@]}" install --quiet --upgrade pip || say "No newer pip could be had; going on with the old one"
    fi
    "${pip[@]}" install --quiet --no-compile "$@" # Python compiles what is imported, a tenth of it
}

# Whether .venv has this checkout, editable: somebody may have installed a copy over it since, which no edit reaches.
installed_here() {
    "$VENV/bin/python" -I -c '
import importlib.util, pathlib, sys
spec = importlib.util.find_spec("elastic_strips")
sys.exit(not (spec and spec.origin and pathlib.Path(sys.argv[1], "src").resolve() in pathlib.Path(spec.origin).resolve().parents))
' "$ROOT"
}

# setup_venv EXTRAS: afterwards .venv holds the checkout, editable, with these extras ("" for none).
# A stamp remembers what was installed from which pyproject.toml and C++ code: the second run installs nothing.
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
root = pathlib.Path(sys.argv[1])
native = root / "src/native"  # a build leaves folders of its own in cmake
code = [path for kind in ("*.cpp", "*.hpp", "cmake/CMakeLists.txt") for path in sorted(native.glob(kind))]
code.append(root / "src/elastic_strips/_native.pyi")  # a kernel that was compiled for others is not used
for path in (root / "pyproject.toml", *code):
    digest.update(path.read_bytes())
print(digest.hexdigest())' "$ROOT")" || die "$VENV is unusable; delete it and run again"
    stamp="$VENV/.installed-${extras:-core}"
    # Everything that the demo needs is in the test environment, too.
    for candidate in "$stamp" "$VENV/.installed-dev,notebooks"; do
        if [ -f "$candidate" ] && [ "$(cat "$candidate")" = "$digest" ] && installed_here; then
            return
        fi
    done
    [ -n "$extras" ] && target="$ROOT[$extras]"
    setup_compiler
    say "Installing $target (compiles C++ the first time: minutes without a word, up to fifteen on a busy machine)"
    local apart="" needed
    if [[ ",$extras," == *,dev,* ]] && command -v cmake >/dev/null 2>&1 && command -v ninja >/dev/null 2>&1; then
        # Compiled with what is in .venv, not in an environment apart: the wheel of the tests is of the same object files.
        needed="$("$VENV/bin/python" -c '
import pathlib, re, sys
text = pathlib.Path(sys.argv[1], "pyproject.toml").read_text()
print(*re.findall("\"([^\"]+)\"", re.search(r"^requires = \[(.*?)\]", text, re.M | re.S)[1]))' "$ROOT")"
        # shellcheck disable=SC2086  # several requirements, none with a space
        install $needed && apart=--no-build-isolation
    fi
    install ${apart:+"$apart"} --editable "$target" || die "could not install $target"
    printf '%s\n' "$digest" >"$stamp"
}

# apt_install WHAT PACKAGES: where root runs this on Debian; one at a time, for apt knows no waiting.
apt_install() {
    [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null 2>&1 || return 1
    say "Installing $1"
    (
        flock 9
        apt-get update -qq &&
            DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${@:2}" >/dev/null
    ) 9>"${TMPDIR:-/tmp}/elastic-strips-apt.lock"
}

# The native kernel is compiled while the checkout is installed; without a compiler NumPy computes, several times slower.
setup_compiler() {
    local headers
    headers="$("$VENV/bin/python" -c 'import sysconfig; print(sysconfig.get_paths()["include"])')/Python.h"
    command -v "${CXX:-c++}" >/dev/null 2>&1 && [ -f "$headers" ] && return
    apt_install "a compiler" g++ python3-dev && return
    say "No C++ compiler, or no headers of Python: the native kernel is left out (Debian: apt-get install g++ python3-dev)"
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
    apt_install chromium chromium && return
    # Ubuntu has it as a snap only
    say "No chromium: the tests that look at pictures will be skipped (Debian: apt-get install chromium)"
}
