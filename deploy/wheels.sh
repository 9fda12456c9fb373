#!/usr/bin/env bash
# Fills a folder with all that `install.sh --wheels` needs on a robot without a network. `make wheels` runs it.
#
#   deploy/wheels.sh PYTHON DIR                    for a machine like this one
#   deploy/wheels.sh PYTHON DIR aarch64 [3.11]     for another: its processor, and the version of its Python
#
# What it fetches has the SHA-256 of deploy/lock, and what it writes of it, DIR/requirements.txt, is what the robot installs.
# Nothing in DIR has to be compiled on the robot. All comes as ready-made wheels but spidev, which PyPI has as source only:
# it is compiled here, for another machine by a cross compiler (release/spidev.py). Where that cannot be, it is left out,
# and the gateway makes the kernel's calls itself.
# A Pi with the 32-bit system (armv7l) has no wheels of cffi, lz4 and zstandard on PyPI, and piwheels.org builds its own,
# which the lock does not know: UNLOCKED=yes deploy/wheels.sh … takes, on that Pi, the versions of the lock from wherever pip
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
# shellcheck source=deploy/spidev.sh
. deploy/spidev.sh
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
rm -f "$folder"/spidev-*
only_spidev <"$lock" >"$sources/spidev.txt"
without_spidev <"$lock" >"$sources/others.txt"
lacks=''
if [ -z "$processor" ]; then
	# shellcheck disable=SC2086 # one word, or none
	pip wheel --no-build-isolation --no-deps $hashes --wheel-dir "$folder" -r "$sources/others.txt"
	lacks=$(missing_to_compile "$python")
	if [ -n "$lacks" ]; then
		lacks="$lacks is missing"
	else
		# shellcheck disable=SC2086
		reproducibly pip wheel --no-build-isolation --no-deps $hashes --wheel-dir "$folder" -r "$sources/spidev.txt"
	fi
else
	# Raspberry Pi OS 12 has glibc 2.36, 13 has 2.41; pip wants each older one named too.
	platforms=$(printf -- "--platform manylinux_%s_$processor " 2_41 2_39 2_36 2_35 2_34 2_31 2_28 2_17)
	# shellcheck disable=SC2086 # one word each
	pip download --dest "$folder" --no-deps --only-binary=:all: $hashes $platforms --platform "manylinux2014_$processor" \
		--platform any --implementation cp --python-version "$version" -r "$sources/others.txt"
	if [ "$processor" = aarch64 ]; then
		# shellcheck disable=SC2086
		pip download --dest "$sources" --no-deps --no-build-isolation --no-binary spidev $hashes -r "$sources/spidev.txt"
		status=0
		"$python" -m release.spidev "$folder" "$sources"/spidev-*.tar.gz "$version" 2>"$sources/lacks" || status=$?
		lacks=$(cat "$sources/lacks")
		[ $status = 0 ] || [ $status = 3 ] || { printf '%s\n' "$lacks" >&2 && exit $status; }
	else
		lacks="it is compiled for aarch64 only, or on the machine itself"
	fi
fi
[ -z "$lacks" ] || echo "spidev is left out, and the gateway will make the kernel's calls itself: $lacks" >&2

# The hash of each file that is there, under the name and version that pip knows it by.
(
	cd "$folder"
	for file in *.whl; do
		[ -e "$file" ] || continue
		case $file in setuptools-*) continue ;; esac
		name=${file%%-*} rest=${file#*-}
		printf '%s==%s --hash=sha256:%s\n' "$name" "${rest%%-*}" "$(sha256sum "$file" | cut -d' ' -f1)"
	done
) | LC_ALL=C sort >"$folder/requirements.txt"
echo "$folder is full: copy it and deploy/ to the robot, then: sudo deploy/install.sh --wheels $(basename "$folder")"
