#!/usr/bin/env bash
# Tests the Python wheel of target/wheels.
#
#   deploy/python.sh [PYTHON...]
#
# Every PYTHON (default: python3) gets an environment in target/python, in which the wheel is installed, the tests run
# and mypy checks the types.
set -euo pipefail
cd "$(dirname "$0")/.."
pythons=("$@")
[ ${#pythons[@]} -gt 0 ] || pythons=(python3)

# The tests use packages that users have.
tested=(numpy pandas polars xarray scikit-learn matplotlib pytest mypy)

for python in "${pythons[@]}"; do
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    environment=target/python/$version
    rm -rf "$environment"
    "$python" -m venv "$environment"
    "$environment/bin/pip" install --quiet --disable-pip-version-check "${tested[@]}" target/wheels/tidemap-*.whl
    # The tests run from elsewhere, so that they test the wheel and not the sources.
    (cd target/python && env -u TIDEMAPD "$version/bin/python" -m pytest -q -p no:cacheprovider \
        "$OLDPWD/client/python/tests")
    "$environment/bin/mypy" --strict --config-file client/python/pyproject.toml -p tidemap
    echo "python $version: passed"
done
