# shellcheck shell=bash
# A Python of its own with the gateway in it. Read by install.sh.
# shellcheck source=deploy/stamp.sh
. "$HERE/stamp.sh"
# shellcheck source=deploy/spidev.sh
. "$HERE/spidev.sh"

# Sets `venv`: a folder named after what is in it, complete before anything refers to it.
build_venv() {
	local inputs name wheel=''
	if [ -n "$wheels" ]; then
		inputs=$(cat "$wheels/requirements.txt")
		wheel=$(compgen -G "$wheels/hexapod_gateway-*.whl" | tail -n 1)
		to=$(basename "$wheel" | cut -d- -f2)
	elif [ -n "$own_wheel" ]; then
		inputs=$(sha256sum <"$own_wheel" && cat "$HERE/lock/requirements.txt")
		to=$(basename "$own_wheel" | cut -d- -f2)
	else
		inputs=$(cd "$ROOT" && find pyproject.toml deploy gateway schemas -name __pycache__ -prune -o -type f -print0 |
			sort -z | xargs -0 sha256sum)
		to=$(version_of "$ROOT")
	fi
	name=$OPT/venv-$(printf '%s\n%s\n' "$python $version" "$inputs" | sha256sum | cut -c1-12)
	for venv in "$name" "$name-2"; do
		[ -e "$venv/complete" ] || continue
		if is_whole "$venv"; then
			to=$(version_in "$venv")
			say "keep $venv: the same Python, the same gateway, every file as installed"
			return
		fi
		say "make anew what is in $venv: its files are not those that were installed, as after a power cut"
	done
	# Never in the place of what the service may run from: its Stops after a crash come from there.
	venv=$name
	[ "$(readlink -e $OPT/venv || true)" != "$name" ] && [ "$(release_of $NAME)" != "$name" ] || venv=$name-2
	look_for_spidev
	say "make $venv with $python ($version)"
	say "install $NAME $to into it from ${wheels:-${own_wheel:-$ROOT} and the network}, with the hashes of the lock"
	[ "$dry" = no ] || return 0
	unfinished=$venv
	rm -rf "$venv"
	mkdir -p "$OPT"
	"$python" -m venv "$venv" || fail "$venv could not be made (above is why); nothing else was changed"
	if [ -n "$wheels" ]; then install_from_folder; else install_from_network; fi ||
		fail "pip could not install $NAME (above is why); nothing else was changed"
	{ "$venv/bin/$NAME" --version >/dev/null &&
		{ [ $spidev = no ] || "$venv/bin/python" -c 'import spidev'; }; } ||
		fail "what was installed does not run (above is why); nothing else was changed"
	time_of "${wheel:-$own_wheel}" >"$venv/commit-time"
	mark_whole "$venv"
	unfinished=''
}

# Nothing is installed whose SHA-256 nobody has named, and nothing that pip itself would choose (--no-deps). What builds
# spidev, where that comes as source, is installed in the same way: pip's own isolation would fetch it without a look.
install_hashed() {
	"$venv/bin/pip" "$@" --quiet --disable-pip-version-check --no-cache-dir --no-deps --no-build-isolation --require-hashes
}

wanted() { if [ $spidev = no ]; then without_spidev; else cat; fi; }

install_from_folder() {
	# --isolated: no pip configuration of this machine, which may name an index.
	[ ! -e "$wheels/build.txt" ] ||
		install_hashed --isolated install --no-index --find-links "$wheels" -r "$wheels/build.txt" || return
	install_hashed --isolated install --no-index --find-links "$wheels" \
		-r <(wanted <"$wheels/requirements.txt")
}

install_from_network() {
	sources=$(mktemp -d)
	install_hashed install -r "$HERE/lock/build.txt" || return
	if [ -z "$own_wheel" ]; then
		mkdir "$sources/own"
		local SOURCE_DATE_EPOCH
		SOURCE_DATE_EPOCH=$(epoch_of "$ROOT")
		export SOURCE_DATE_EPOCH # of all files, those that pip makes too
		copy_sources "$ROOT" "$sources/own" || return
		"$venv/bin/pip" wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --no-index \
			--wheel-dir "$sources" "$sources/own" || return
		own_wheel=$(compgen -G "$sources/hexapod_gateway-*.whl")
	fi
	install_hashed install -r <(wanted <"$HERE/lock/requirements.txt") || return
	"$venv/bin/pip" install --quiet --disable-pip-version-check --no-cache-dir --no-deps --no-index "$own_wheel"
}

# The mark has the SHA-256 of each file. All of them are on the disk before it is; else a power cut in the next half minute
# could leave it beside empty files.
mark_whole() {
	local list
	list=$(cd "$1" && find . -type f ! -name complete ! -name unit -print0 | sort -z | xargs -0 sha256sum)
	sync -f "$1"
	printf '%s\n' "$list" >"$1/complete.new"
	sync "$1/complete.new"
	mv "$1/complete.new" "$1/complete"
	sync -f "$1"
}

# How to install this release anew, for `check` to say where a file of it is damaged. A wheel of pip's is gone by then.
note_command() {
	local from=''
	if [ -n "$bundle" ]; then
		from=$(printf 'bash %q --bundle %q' "$(compgen -G "$venv/lib/python*/site-packages/gateway/deploy/install.sh")" "$bundle")
	elif [ -n "$wheels" ]; then
		from=$(printf 'bash %q --wheels %q' "$HERE/install.sh" "$wheels")
	elif [ -f "$ROOT/pyproject.toml" ]; then
		from=$(printf 'bash %q' "$HERE/install.sh")
	fi
	[ "$dry" = no ] || return 0
	printf '%s\n' "$from" >"$venv/again.new"
	replace "$venv/again"
}

# Whether each file is as it was installed.
is_whole() {
	[ -s "$1/complete" ] && (cd "$1" && sha256sum --check --quiet --strict complete >/dev/null 2>&1)
}

# Whether it can be gone back to: whole, or made by an installer whose mark was an empty file, and able to begin.
is_fit() {
	is_whole "$1" || { [ -e "$1/complete" ] && [ ! -s "$1/complete" ] && "$1/bin/$NAME" stop-servos --help >/dev/null 2>&1; }
}

# What version pip has installed there.
version_in() {
	basename "$(compgen -G "$1/lib/python*/site-packages/hexapod_gateway-*.dist-info" | head -n 1)" .dist-info | cut -d- -f2
}

# When the commit was made from which a wheel was built (SOURCE_DATE_EPOCH), in seconds since 1970.
time_of() {
	"$python" -c '
import calendar, sys, zipfile
with zipfile.ZipFile(sys.argv[1]) as wheel:
    print(max(calendar.timegm((*entry.date_time, 0, 0, 0)) for entry in wheel.infolist()))
' "$1"
}

# Sets `spidev`. PyPI has it as source only; where it can be neither had nor compiled, the gateway does without it.
look_for_spidev() {
	local missing=''
	spidev=yes
	if [ -n "$wheels" ] && ! grep -q '^spidev==' "$wheels/requirements.txt"; then
		missing="$wheels has none"
	elif [ -z "$wheels" ] || ! compgen -G "$wheels/spidev-*.whl" >/dev/null; then
		missing=$(missing_to_compile "$python")
		[ -z "$missing" ] || missing="it would have to be compiled, and $missing is missing"
	fi
	[ -n "$missing" ] || return 0
	spidev=no
	say "leave spidev out ($missing): the gateway makes the kernel's calls itself"
}
