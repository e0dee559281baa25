#!/usr/bin/env bash
# Builds the Python wheel with the daemon in it, and tests it in an environment of its own.
#
#   deploy/python.sh BUILT [PYTHON...]   BUILT has the release build of tidemapd
#
# The wheel goes to target/wheels. Every PYTHON (default: python3) gets an environment in target/python, in which the
# wheel is installed, the tests run and mypy checks the types.
set -euo pipefail
cd "$(dirname "$0")/.."
built=$1
shift
pythons=("$@")
[ ${#pythons[@]} -gt 0 ] || pythons=(python3)

# Tools with fixed versions. The tests take what users have.
tools=(maturin==1.16.0)
tested=(numpy pandas xarray scikit-learn matplotlib pytest mypy)

rm -rf target/wheels
mkdir -p target/python client/python/python/tidemap/bin
trap 'rm -rf client/python/python/tidemap/bin' EXIT
strip -o client/python/python/tidemap/bin/tidemapd "$built/tidemapd"
chmod 755 client/python/python/tidemap/bin/tidemapd

[ -x target/python/tools/bin/maturin ] || "${pythons[0]}" -m venv target/python/tools
target/python/tools/bin/pip install --quiet --disable-pip-version-check "${tools[@]}"
CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$PWD/target} target/python/tools/bin/maturin build --quiet --release --locked \
    --manifest-path client/python/Cargo.toml --out target/wheels ${TIDEMAP_MATURIN_ARGUMENTS:-}
ls -l target/wheels

for python in "${pythons[@]}"; do
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    environment=target/python/$version
    rm -rf "$environment"
    "$python" -m venv "$environment"
    "$environment/bin/pip" install --quiet --disable-pip-version-check "${tested[@]}" target/wheels/tidemap-*.whl
    # From elsewhere, so that what is tested is the wheel and not the sources.
    (cd target/python && env -u TIDEMAPD "$version/bin/python" -m pytest -q -p no:cacheprovider \
        "$OLDPWD/client/python/tests")
    "$environment/bin/mypy" --strict --config-file client/python/pyproject.toml -p tidemap
    echo "python $version: passed"
done
