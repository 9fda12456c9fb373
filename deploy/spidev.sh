# shellcheck shell=bash
# spidev in a list of requirements, and what this machine lacks to compile it. Read by install.sh and wheels.sh.

only_spidev() { awk '/^spidev==/ { of_spidev = 1 } of_spidev { print } !/\\$/ { of_spidev = 0 }'; }
without_spidev() { awk '/^spidev==/ { of_spidev = 1 } !of_spidev { print } !/\\$/ { of_spidev = 0 }'; }

# What is missing to compile a module for this Python, in words; nothing, if it can be compiled.
missing_to_compile() {
	local header
	header=$("$1" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h
	if ! command -v gcc >/dev/null; then
		echo gcc
	elif [ ! -e "$header" ]; then
		echo "$header"
	fi
}

# Compile without debugging information, which has the path of pip's temporary folder: each build makes the same bytes.
# setuptools takes these in place of the flags of Python's own build.
reproducibly() { CFLAGS="${CFLAGS:--O2} -g0" LDFLAGS="${LDFLAGS:-} -Wl,--build-id=none" "$@"; }
