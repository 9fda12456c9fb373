#!/usr/bin/env bash
# Fills a folder with all that `install.sh --wheels` needs on a robot without a network. `make wheels` runs it.
#
#   deploy/wheels.sh PYTHON DIR                    for a machine like this one
#   deploy/wheels.sh PYTHON DIR aarch64 [3.11]     for another: its processor, and the version of its Python
#
# On the Pi itself the first form is the sure one. From a laptop, all comes as ready-made aarch64 wheels but spidev,
# which PyPI has as source only: it is built while installing, so the robot needs gcc and python3-dev (Raspberry Pi OS
# with desktop has both; on Lite, `sudo apt-get install gcc python3-dev` once, while it has a network).
# A Pi with the 32-bit system (armv7l) has no wheels of cryptography and others on PyPI: run it there, where pip finds
# them at piwheels.org.
set -euo pipefail
python=$1 folder=$2 processor=${3:-} version=${4:-3.11}
cd "$(dirname "$(readlink -f "$0")")/.."
pip() { "$python" -m pip --disable-pip-version-check "$@" --quiet; }

mkdir -p "$folder"
rm -f "$folder"/hexapod_gateway-*.whl
sources=$(mktemp -d)
trap 'rm -rf "$sources"' EXIT
# shellcheck source=deploy/stamp.sh
. deploy/stamp.sh
copy_sources "$PWD" "$sources"

if [ -z "$processor" ]; then
	pip wheel --wheel-dir "$folder" "${sources}[spi,console]"
else
	pip wheel --no-deps --wheel-dir "$folder" "$sources"
	# Raspberry Pi OS 12 has glibc 2.36; pip wants each older one named too.
	platforms=$(printf -- "--platform manylinux_%s_$processor " 2_36 2_35 2_34 2_31 2_28 2_17)
	# shellcheck disable=SC2086 # one word each
	pip download --dest "$folder" --only-binary=:all: $platforms --platform "manylinux2014_$processor" \
		--implementation cp --python-version "$version" "$(echo "$folder"/hexapod_gateway-*.whl)[console]"
	pip download --dest "$folder" --no-deps --no-binary spidev 'spidev>=3.6'
	pip download --dest "$folder" --only-binary=:all: setuptools wheel # what builds spidev there
	echo "spidev is there as source: the robot needs gcc and python3-dev to install it"
fi
echo "$folder is full: copy it and deploy/ to the robot, then: sudo deploy/install.sh --wheels $(basename "$folder")"
