#!/usr/bin/env bash
# Fills a folder with all that `install.sh --wheels` needs on a robot without a network. `make wheels` runs it.
#
#   deploy/wheels.sh PYTHON DIR                    for a machine like this one
#   deploy/wheels.sh PYTHON DIR aarch64 [3.11]     for another: its processor, and the version of its Python
#
# What it fetches has the SHA-256 of deploy/lock, and what it writes of it, DIR/requirements.txt, is what the robot installs.
# On the Pi itself the first form is the sure one. From a laptop, all comes as ready-made aarch64 wheels but spidev,
# which PyPI has as source only: it is built while installing, so the robot needs gcc and python3-dev (Raspberry Pi OS
# with desktop has both; on Lite, `sudo apt-get install gcc python3-dev` once, while it has a network).
# A Pi with the 32-bit system (armv7l) has no wheels of cryptography and others on PyPI, and piwheels.org builds its own, which
# the lock does not know: UNLOCKED=yes deploy/wheels.sh … takes, on that Pi, the versions of the lock from wherever pip
# finds them.
set -euo pipefail
umask 022
python=$1 folder=$2 processor=${3:-} version=${4:-3.11}
cd "$(dirname "$(readlink -f "$0")")/.."
pip() { "$python" -m pip --disable-pip-version-check "$@" --quiet; }

mkdir -p "$folder"
rm -f "$folder"/hexapod_gateway-*.whl "$folder"/requirements.txt "$folder"/build.txt
sources=$(mktemp -d)
trap 'rm -rf "$sources"' EXIT
# shellcheck source=deploy/stamp.sh
. deploy/stamp.sh
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(epoch_of "$PWD")}
export SOURCE_DATE_EPOCH
mkdir "$sources/build" "$sources/own"
copy_sources "$PWD" "$sources/own"

# pip's own isolation would fetch what builds a wheel without a look at its hash.
pip install --require-hashes --only-binary=:all: --target "$sources/build" -r deploy/lock/build.txt
export PYTHONPATH=$sources/build
if [ -n "${OWN_WHEEL:-}" ]; then
	cp "$OWN_WHEEL" "$folder" # as it is released
else
	pip wheel --no-build-isolation --no-deps --wheel-dir "$folder" "$sources/own"
fi

lock=$sources/requirements.txt hashes=--require-hashes
cp deploy/lock/requirements.txt "$lock"
if [ "${UNLOCKED:-}" = yes ]; then
	sed -n 's/^\([A-Za-z0-9_.-]*==[^ ]*\).*/\1/p' deploy/lock/requirements.txt >"$lock"
	hashes=
fi
if [ -z "$processor" ]; then
	# shellcheck disable=SC2086 # one word, or none
	pip wheel --no-build-isolation --no-deps $hashes --wheel-dir "$folder" -r "$lock"
else
	awk '/^spidev==/ { of_spidev = 1 } of_spidev { print > spidev } !of_spidev { print } !/\\$/ { of_spidev = 0 }' \
		spidev="$sources/spidev.txt" "$lock" >"$sources/others.txt"
	# Raspberry Pi OS 12 has glibc 2.36, 13 has 2.41; pip wants each older one named too.
	platforms=$(printf -- "--platform manylinux_%s_$processor " 2_41 2_39 2_36 2_35 2_34 2_31 2_28 2_17)
	# shellcheck disable=SC2086 # one word each
	pip download --dest "$folder" --no-deps --only-binary=:all: $hashes $platforms --platform "manylinux2014_$processor" \
		--platform any --implementation cp --python-version "$version" -r "$sources/others.txt"
	# shellcheck disable=SC2086
	pip download --dest "$folder" --no-deps --no-build-isolation --no-binary spidev $hashes -r "$sources/spidev.txt"
	pip download --dest "$folder" --no-deps --only-binary=:all: --require-hashes -r deploy/lock/build.txt
	cp deploy/lock/build.txt "$folder"
	echo "spidev is there as source: the robot needs gcc and python3-dev to install it"
fi

# The hash of each file that is there, under the name and version that pip knows it by.
(
	cd "$folder"
	for file in *.whl spidev-*.tar.gz; do
		[ -e "$file" ] || continue
		case $file in setuptools-*) continue ;; esac
		name=${file%%-*} rest=${file#*-}
		known=${rest%%-*}
		printf '%s==%s --hash=sha256:%s\n' "$name" "${known%.tar.gz}" "$(sha256sum "$file" | cut -d' ' -f1)"
	done
) | LC_ALL=C sort >"$folder/requirements.txt"
echo "$folder is full: copy it and deploy/ to the robot, then: sudo deploy/install.sh --wheels $(basename "$folder")"
