#!/usr/bin/env bash
# Installs the gateway as a service on the robot's computer (Raspberry Pi OS, or any Debian with systemd).
#
#   sudo deploy/install.sh                 from this folder's repository, dependencies from the network
#   sudo deploy/install.sh --framing F     length-prefixed (the published STM32 firmware) or plain (a controller that
#                                          follows the protocol's document); without it, a terminal is asked
#   sudo deploy/install.sh --protocol P    what the controller speaks: hexapod-1.0 (the default) or elkapod-2025, which needs a
#                                          UART and no framing
#   sudo deploy/install.sh --wheels DIR    without a network, from a folder that `make wheels` filled
#   sudo deploy/install.sh --bundle FILE   without a network, from a signed release (`make dist`): it is verified before anything is
#                                          unpacked; --allow-downgrade: also one that is older; --trust SHA256:…: signed by
#                                          another key than the releases before
#   sudo deploy/install.sh --certs DIR     besides, bring the gateway's certificates (`hexapod-gateway certs init`), or
#                                          those of a further robot (`certs issue --role robot`)
#   sudo deploy/install.sh --console       besides, the web console as a service of its own
#   sudo deploy/install.sh --rollback      back to the release before this one
#   sudo deploy/install.sh --force …       also while a servo runs (all legs stop)
#   sudo deploy/install.sh --uninstall     stops the service and removes all but the configuration
#        deploy/install.sh --dry-run …     says what it would do, in the same lines, and does nothing
#   sudo PYTHON=/usr/bin/python3.12 deploy/install.sh …
#
# With pip only, `python3 -m gateway.onboard.install_service …` is the same program. Dependencies are those of deploy/lock, with their
# SHA-256 (pip --require-hashes).
#
# Run it as often as you like: it changes what differs, of a configuration nothing but a protocol or framing that it lacks, and
# restarts the service only if something that it runs has changed.
set -euo pipefail
umask 022

NAME=hexapod-gateway
OPT=/opt/$NAME
ETC=/etc/$NAME
UNIT=/etc/systemd/system/$NAME.service
RULES=/etc/udev/rules.d/60-$NAME.rules
COMMAND=/usr/local/bin/$NAME
CERTIFICATES="gateway.json5 gateway.pem gateway.key ca.pem"
HERE=$(dirname "$(readlink -f "$0")")
ROOT=$(dirname "$HERE")

say() { printf '%s\n' "$*"; }
fail() {
	printf 'install.sh: %s\n' "$*" >&2
	said=yes
	exit 1
}
# Do it, unless this is a dry run.
run() { [ "$dry" = yes ] || "$@"; }

usage() { sed -n '2,/^set/{s/^# \{0,1\}//;/^set/d;p}' "$0"; }

dry=no spidev=yes bundle='' opened='' unpacked='' own_wheel='' allow_downgrade=no trust='' handed_on=("$@") uninstall=no rollback=no force=no console=no before='' earlier='' to='' python='' wheels='' certs='' certificates='' framing='' protocol='' setting='' value=''
while [ $# -gt 0 ]; do
	case $1 in
	--dry-run) dry=yes ;;
	--uninstall) uninstall=yes ;;
	--rollback) rollback=yes ;;
	--force) force=yes ;;
	--console) console=yes ;;
	--allow-downgrade) allow_downgrade=yes ;;
	--bundle | --own-wheel)
		[ $# -ge 2 ] || fail "$1 needs a file"
		[ -f "$2" ] || fail "$1: $2 is no file"
		if [ "$1" = --bundle ]; then bundle=$(readlink -f "$2"); else own_wheel=$(readlink -f "$2"); fi
		shift
		;;
	--opened) # by the installer before this one, which has verified what is there
		opened=$2 unpacked=$2 wheels=$2/files
		shift
		;;
	--trust)
		case ${2:-} in
		SHA256:?*) trust=$2 ;;
		*) fail "$1 needs a key's fingerprint, SHA256:…, as ssh-keygen -l shows it" ;;
		esac
		shift
		;;
	--wheels | --certs)
		[ $# -ge 2 ] || fail "$1 needs a folder"
		[ -d "$2" ] || fail "$1: $2 is no folder"
		if [ "$1" = --wheels ]; then wheels=$(readlink -f "$2"); else certs=$(readlink -f "$2"); fi
		shift
		;;
	--framing)
		case ${2:-} in
		plain | length-prefixed) framing=$2 ;;
		*) fail "$1 is length-prefixed (the published STM32 firmware) or plain (the protocol's document)" ;;
		esac
		shift
		;;
	--protocol)
		case ${2:-} in
		hexapod-1.0 | elkapod-2025) protocol=$2 ;;
		*) fail "$1 is hexapod-1.0 or elkapod-2025 (see docs/protocol.md)" ;;
		esac
		shift
		;;
	-h | --help)
		usage
		exit 0
		;;
	*) fail "$1 is no option; --help names them" ;;
	esac
	shift
done

# ---- what must be so before anything is changed

check_machine() {
	[ "$dry" = yes ] || [ "$(id -u)" = 0 ] || fail "needs root: sudo $0"
	[ -d /run/systemd/system ] || fail "this machine does not run systemd; see $HERE/systemd/ for what the unit does"
}

check_python() {
	python=${PYTHON:-/usr/bin/python3}
	version=$("$python" -c 'import sys; print("%d.%d.%d" % sys.version_info[:3])' 2>/dev/null) ||
		version=''
	case $version in
	[1-9]*.[0-9]*.[0-9]*) ;;
	*) fail "$python is no Python; apt-get install python3, or name one: PYTHON=/usr/bin/python3.11" ;;
	esac
	"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
		fail "$python is $version, and the gateway needs 3.11; name a newer one: PYTHON=/usr/bin/python3.11"
	"$python" -c 'import ensurepip, venv' 2>/dev/null ||
		fail "$python has no venv module; apt-get install python3-venv"
	# The interpreter itself, such as python3.11: with an upgrade of the system, python3 becomes another, which would not
	# find what is installed here, not even `stop-servos`.
	python=$("$python" -c 'import os, sys; print(os.path.realpath(sys.executable))')
	case $python in
	/root/* | /home/* | /tmp/*)
		fail "$python lies in a folder that the service may not read; name the system's: PYTHON=/usr/bin/python3"
		;;
	esac
}

# pip's own sentence would name a compiler, and not what to do.
check_processor() {
	local bits processor
	bits=$("$python" -c 'import struct; print(8 * struct.calcsize("P"))')
	processor=$(uname -m)
	case $bits-$processor in
	32-* | *-armv*) ;;
	*) return 0 ;;
	esac
	[ -z "$wheels" ] || ! compgen -G "$wheels/cffi-*-linux_armv*.whl" >/dev/null || return 0
	fail "$python is of a 32-bit system ($processor), for which PyPI has no wheels of cffi, lz4 and zstandard: take the 64-bit Raspberry Pi OS, or see deploy/wheels.sh for UNLOCKED=yes"
}

check_sources() {
	if [ -n "$wheels" ]; then
		compgen -G "$wheels/hexapod_gateway-*.whl" >/dev/null ||
			fail "$wheels has no hexapod_gateway-*.whl; fill it with: make wheels WHEELS=$wheels"
		[ -s "$wheels/requirements.txt" ] || fail "$wheels has no requirements.txt, which \`make wheels\` writes with the hashes"
	elif [ -z "$own_wheel" ]; then
		[ -f "$ROOT/pyproject.toml" ] ||
			fail "$ROOT is not the repository; python3 -m gateway.onboard.install_service, --bundle FILE or --wheels DIR"
	fi
	[ -z "$certs" ] || check_certificates
}

check_certificates() {
	local file made="make one with: $NAME certs init --dir $certs --host …"
	certificates=$CERTIFICATES
	for file in $certificates; do
		[ -f "$certs/$file" ] || fail "$certs has no $file; $made"
	done
	[ ! -f "$certs/revoked.crl" ] || certificates="$certificates revoked.crl"
}

# ---- the parts

# A file of ours: brought where it differs, in the mode and group given. `changed` says that there was something to do.
# At any moment the old one or the new one is whole on the disk.
put() {
	local from=$1 to=$2 mode=$3 group=${4:-root}
	cmp -s "$from" "$to" && return
	say "write $to"
	changed=yes
	[ "$dry" = no ] || return 0
	install -D -m "$mode" -o root -g "$group" "$from" "$to.new"
	replace "$to"
}

# The same of what the service runs or reads.
put_for_service() {
	cmp -s "$1" "$2" && return
	will_restart
	put "$@"
}

# FILE.new takes the place of FILE.
replace() {
	sync "$1.new"
	mv -T "$1.new" "$1"
}

# All that was written is on the disk after this. The kernel would keep it in memory for up to half a minute.
flush() {
	local place
	[ "$dry" = no ] || return 0
	for place in "$OPT" /etc /usr/local/bin /var/lib /boot /boot/firmware; do
		[ ! -d "$place" ] || sync -f "$place"
	done
}

# Whether nothing is in a file, as after a power cut: some file systems leave it empty, some fill it with zeros.
is_blank() { [ -e "$1" ] && [ -z "$(tr -d '\0[:space:]' <"$1" | head -c 1)" ]; }

clean_up() {
	[ $? = 0 ] || [ $said = yes ] || echo "install.sh: did not finish (above is why); run it again once that is fixed" >&2
	rm -rf ${sources:+"$sources"} ${stated:+"$stated"} ${unpacked:+"$unpacked"}
	if [ -n "$unfinished" ]; then
		rm -rf "$unfinished"
		rmdir "$OPT" 2>/dev/null || true # only if it is empty
	fi
}

make_user() {
	local group
	for group in spi dialout; do # the unit's SupplementaryGroups=
		if ! getent group $group >/dev/null; then
			say "make the group $group"
			run groupadd --system $group
		fi
	done
	if ! getent passwd $NAME >/dev/null; then
		say "make the user $NAME, in the group spi"
		getent group $NAME >/dev/null || run groupadd --system $NAME
		run useradd --system --gid $NAME --groups spi --no-create-home --home-dir /nonexistent \
			--shell /usr/sbin/nologin --comment "Hexapod gateway" $NAME
	fi
}

write_configuration() {
	local file
	if [ -d $ETC ]; then
		# Also what somebody copied there by hand: a certificate's key comes as 0600.
		if ! getent group $NAME >/dev/null ||
			[ -n "$(find $ETC \( ! -user root -o ! -group $NAME -o -perm /027 -o ! -perm -040 \) -print -quit)" ]; then
			say "let $NAME read all of $ETC, and nobody else (root:$NAME)"
			run chown -R root:$NAME $ETC
			run chmod -R u=rwX,g=rX,o= $ETC
		fi
	else
		say "make $ETC, for root and $NAME only"
		run install -d -m 0750 -o root -g $NAME $ETC
	fi
	if [ -z "$stated" ]; then
		say "keep $ETC/gateway.toml, your configuration"
	elif [ -e $ETC/gateway.toml ] && ! is_blank $ETC/gateway.toml; then
		will_restart
		say "add $setting = \"$value\" to $ETC/gateway.toml, and keep the rest of your configuration"
		if [ "$dry" = no ]; then
			install -m 0640 -o root -g $NAME "$stated" $ETC/gateway.toml.new
			replace $ETC/gateway.toml
			add_to_kept
		fi
	else
		put_for_service "$stated" $ETC/gateway.toml 0640 $NAME
	fi
	[ -n "$certs" ] || return 0
	run install -d -m 0750 -o root -g $NAME $ETC/zenoh
	for file in $certificates; do
		if [ "$file" = gateway.json5 ] && [ -e "$ETC/zenoh/$file" ] && ! is_blank "$ETC/zenoh/$file"; then
			say "keep $ETC/zenoh/$file, your configuration"
		else
			put_for_service "$certs/$file" $ETC/zenoh/"$file" 0640 $NAME
		fi
	done
	# The file that is there, or in a dry run the one that would be.
	local example='config = "/etc/hexapod-gateway/zenoh/gateway.json5"' present=$ETC/gateway.toml
	local setting="config = \"$ETC/zenoh/gateway.json5\""
	[ -e "$present" ] || present=$stated
	if ! grep -q "^$setting" "$present"; then
		if grep -q "^# $example\$" "$present" && ! grep -qE "^[[:space:]]*config[[:space:]]*=" "$present"; then
			will_restart
			say "use the certificates: $setting in $ETC/gateway.toml"
			run use_certificates "$example" "$setting"
		else
			hint="To use the certificates, in $ETC/gateway.toml under [zenoh]: $setting"
			return 0
		fi
	fi
	next="where ca.key is: $NAME certs issue NAME --role operator --dir DIR --bundle NAME.zip
Then on the laptop: $NAME check --zenoh-config NAME.json5"
}

# $2 goes in the place of the comment $1; the file is for the service to read, and whole at any time.
use_certificates() {
	sed "s|^# $1\$|$2|" $ETC/gateway.toml >$ETC/gateway.toml.new
	chown root:$NAME $ETC/gateway.toml.new
	chmod 0640 $ETC/gateway.toml.new
	replace $ETC/gateway.toml
}

allow_spi() {
	changed=no
	put "$HERE/udev/60-$NAME.rules" $RULES 0644
	if [ $changed = yes ] && [ -S /run/udev/control ]; then # udev runs, which it does not in a container
		run udevadm control --reload || true
		run udevadm trigger --subsystem-match=spidev || true
	fi
	local config=''
	for file in /boot/firmware/config.txt /boot/config.txt; do
		if [ -f $file ]; then
			config=$file
			break
		fi
	done
	if [ -z "$config" ]; then
		say "no config.txt here, so this is no Raspberry Pi: switch SPI on as this board wants it"
	elif ! spi_is_on <"$config"; then
		switch_spi_on <"$config" | spi_is_on ||
			fail "SPI is off in $config in a way that a person should look at: it needs dtparam=spi=on"
		say "switch SPI on in $config (dtparam=spi=on)"
		change_boot "$config" switch_spi_on
	fi
	[ "$protocol" != elkapod-2025 ] || allow_uart "$config"
}

# config.txt as a filter makes it, from the next boot on.
change_boot() {
	local config=$1
	shift
	reboot=yes
	[ "$dry" = no ] || return 0
	# The boot partition knows no owners and no half-written files: a copy beside it, and then the name.
	"$@" <"$config" >"$config.new"
	replace "$config"
}

# The UART that the configuration names, where this is a Raspberry Pi 5 and it is one of its own.
allow_uart() {
	local config=$1 present=$ETC/gateway.toml uart overlay=''
	[ -e "$present" ] || present=$stated
	uart=$(uart_in "$present")
	[[ ! $uart =~ ^/dev/ttyAMA([0-4])$ ]] || overlay=uart${BASH_REMATCH[1]}-pi5
	if [ -e "$uart" ]; then
		return
	elif [ -z "$config" ] || [ -z "$overlay" ] || ! is_pi_5; then
		say "there is no $uart: switch this UART on as this computer wants it"
	elif ! overlay_is_on "$overlay" <"$config"; then
		say "switch $uart on in $config (dtoverlay=$overlay)"
		change_boot "$config" switch_overlay_on "$overlay"
	fi
}

is_pi_5() { tr -d '\0' 2>/dev/null </proc/device-tree/model | grep -qE '^Raspberry Pi (5|Compute Module 5)'; }

start_service() {
	changed=no
	switch_release
	put_for_service "$HERE/systemd/$NAME.service" $UNIT 0644
	if [ ! -e $COMMAND ]; then
		say "let $COMMAND be $OPT/venv/bin/$NAME"
		run ln -sfn $OPT/venv/bin/$NAME $COMMAND
	fi
	run systemctl daemon-reload
	if ! systemctl is-enabled --quiet $NAME 2>/dev/null; then
		say "enable the service: it starts with the machine"
		run systemctl enable --quiet $NAME
	fi
	flush # before the restart, so that what runs is what a power cut would leave
	if systemctl is-active --quiet $NAME; then
		if [ "$changed$configured" != nono ]; then
			restart_service
		elif restart_is_due; then
			say "an installation ended before its restart: the service still runs what was there before"
			changed=yes
			restart_service
		fi
	elif [ "$reboot" = yes ]; then
		say "not started: reboot, SPI comes with it, and so does the service"
	elif compgen -G '/dev/spidev*' >/dev/null; then
		say "start the service"
		run systemctl start $NAME || fail "installed, but it does not start: journalctl -u $NAME says why"
	else
		say "not started: there is no /dev/spidev* here; once there is: systemctl start $NAME"
	fi
	keep_drop_ins
	remove_old_releases
}

# What `systemctl edit` and simulated.conf make: it changes what the service does, so it is named each time.
keep_drop_ins() {
	local file
	for file in "$UNIT".d/*.conf; do
		[ ! -e "$file" ] || say "keep $file, your change to the service"
	done
}

# ---- install, uninstall

install_all() {
	check_python
	if [ -n "$bundle" ] && [ -z "$opened" ]; then open_bundle; fi
	check_sources
	check_processor
	# shellcheck source=deploy/controller.sh
	. "$HERE/controller.sh"
	check_controller
	build_venv
	make_user
	changed=no
	write_configuration
	configured=$changed
	keep_trust
	allow_spi
	note_command
	start_service
	flush
	install_console
	flush
	if [ -n "$hint" ]; then
		say "$hint"
	else
		say "Next: sudo $NAME check"
		[ -z "$next" ] || say "Then $next"
	fi
}

uninstall_all() {
	check_no_servo_runs
	uninstall_console
	if [ -e $UNIT ]; then
		say "stop and disable the service: all legs stop"
		run systemctl disable --quiet --now $NAME
		! systemctl is-failed --quiet $NAME || say "its last end was a failure: see that no servo holds (journalctl -u $NAME)"
		say "remove $UNIT"
		run rm $UNIT
		run systemctl daemon-reload
		run systemctl reset-failed $NAME 2>/dev/null || true
	fi
	run rm -rf /run/$NAME
	if [ -d /var/lib/$NAME ]; then
		say "keep /var/lib/$NAME, your calibration, for root only"
		run chown -R root:root /var/lib/$NAME
		run chmod -R go= /var/lib/$NAME
	fi
	if [ -e $RULES ]; then
		say "remove $RULES"
		run rm $RULES
	fi
	if [ "$(readlink $COMMAND)" = $OPT/venv/bin/$NAME ]; then
		say "remove $COMMAND"
		run rm $COMMAND
	fi
	if [ -e $OPT ]; then
		say "remove $OPT"
		run rm -rf $OPT
	fi
	if [ -d $ETC ]; then
		# The next user made may get this one's number, and shall not get the keys with it.
		say "keep $ETC, your configuration, for root only"
		run chown -R root:root $ETC
		run chmod -R go= $ETC
	fi
	keep_drop_ins
	if getent passwd $NAME >/dev/null; then
		say "remove the user $NAME"
		run userdel $NAME
	fi
	if [ "$dry" = no ] && getent group $NAME >/dev/null; then groupdel $NAME; fi # some userdel leave it
	say "SPI and the group spi stay as they are"
}

changed=no configured=no reboot=no hint='' next='' unfinished='' sources='' stated='' said=no
trap clean_up EXIT
cd / # the folder it was called from may be gone, or be one that a new user may not enter
check_machine
# shellcheck source=deploy/running.sh
. "$HERE/running.sh"
# shellcheck source=deploy/venv.sh
. "$HERE/venv.sh"
# shellcheck source=deploy/bundle.sh
. "$HERE/bundle.sh"
# shellcheck source=deploy/releases.sh
. "$HERE/releases.sh"
# shellcheck source=deploy/console.sh
. "$HERE/console.sh"
# shellcheck source=deploy/config_txt.sh
. "$HERE/config_txt.sh"
if [ $uninstall = yes ]; then uninstall_all; elif [ $rollback = yes ]; then rollback; else install_all; fi
