# shellcheck shell=bash
# The console as a service of its own: install.sh --console, and every install after that. Read by install.sh.

CONSOLE=hexapod-console
CONSOLE_ETC=/etc/$CONSOLE
CONSOLE_UNIT=/etc/systemd/system/$CONSOLE.service
CONSOLE_SOCKET=/etc/systemd/system/$CONSOLE.socket

install_console() {
	local readable=no
	[ $console = yes ] || [ -e "$CONSOLE_UNIT" ] || return 0
	if ! getent passwd $CONSOLE >/dev/null; then
		say "make the user $CONSOLE"
		getent group $CONSOLE >/dev/null || run groupadd --system $CONSOLE
		run useradd --system --gid $CONSOLE --no-create-home --home-dir /nonexistent \
			--shell /usr/sbin/nologin --comment "Hexapod console" $CONSOLE
	fi
	if [ ! -d $CONSOLE_ETC ]; then
		run install -d -m 0750 -o root -g $CONSOLE $CONSOLE_ETC
	elif ! getent group $CONSOLE >/dev/null ||
		[ -n "$(find $CONSOLE_ETC \( ! -user root -o ! -group $CONSOLE -o -perm /027 -o ! -perm -040 \) -print -quit)" ]; then
		# Certificates that somebody copied there by hand: scp leaves a key as 0600, and the console could not read it.
		say "let $CONSOLE read all of $CONSOLE_ETC, and nobody else (root:$CONSOLE)"
		run chown -R root:$CONSOLE $CONSOLE_ETC
		run chmod -R u=rwX,g=rX,o= $CONSOLE_ETC
		readable=yes
	fi
	if [ -e $CONSOLE_ETC/console.conf ] && ! is_blank $CONSOLE_ETC/console.conf; then
		say "keep $CONSOLE_ETC/console.conf, your options"
	else
		put "$HERE/systemd/console.conf" $CONSOLE_ETC/console.conf 0640 $CONSOLE
	fi
	changed=no
	keep_address
	put "$HERE/systemd/$CONSOLE.socket" $CONSOLE_SOCKET 0644
	local socket_changed=$changed
	put "$HERE/systemd/$CONSOLE.service" $CONSOLE_UNIT 0644
	run systemctl daemon-reload
	if ! systemctl is-enabled --quiet $CONSOLE.service 2>/dev/null || ! systemctl is-enabled --quiet $CONSOLE.socket; then
		say "enable the console: it starts with the machine"
		run systemctl enable --quiet $CONSOLE.service $CONSOLE.socket
	fi
	if ! systemctl is-active --quiet $CONSOLE.service; then
		say "start the console"
		[ $socket_changed = no ] || run systemctl stop $CONSOLE.socket
		begin_console
	elif [ "$changed$readable" != nono ] || [ "$before" != "$venv" ] || runs_another $CONSOLE; then
		check_no_servo_runs # its pages may drive
		say "restart the console"
		# systemd gives a socket only to a console that does not run yet.
		if [ $socket_changed = yes ] || ! systemctl is-active --quiet $CONSOLE.socket; then
			run systemctl stop $CONSOLE.service $CONSOLE.socket
		fi
		begin_console
	fi
	[ -n "$next" ] || next="for a browser: sudo $NAME console --link"
}

# The address that console.conf had before there was a socket unit (--listen) becomes the unit's.
keep_address() {
	local listen host place
	[ ! -e $CONSOLE_SOCKET ] && [ -e $CONSOLE_ETC/console.conf ] || return 0
	listen=$(sed -n 's/^CONSOLE_OPTIONS=\(.*[ "'\'']\)\{0,1\}--listen[= ]\{1,\}\([^ "'\'']*\).*/\2/p' $CONSOLE_ETC/console.conf |
		tail -n 1)
	[ -n "$listen" ] || return 0
	host=${listen%:*}
	[ "$host" != localhost ] || listen="127.0.0.1:${listen##*:} [::1]:${listen##*:}"
	say "let $CONSOLE.socket listen where $CONSOLE_ETC/console.conf says: $listen"
	[ "$dry" = no ] || return 0
	mkdir -p $CONSOLE_SOCKET.d
	{
		printf '[Socket]\nListenStream=\n'
		for place in $listen; do printf 'ListenStream=%s\n' "$place"; done
	} >$CONSOLE_SOCKET.d/listen.conf.new
	replace $CONSOLE_SOCKET.d/listen.conf
}

# systemd says that it is started as soon as there is a process; that process may still find a file that it cannot read.
begin_console() {
	[ "$dry" = no ] || return 0
	local since
	since=$(date +%s)
	run systemctl reset-failed $CONSOLE 2>/dev/null || true
	systemctl start $CONSOLE.socket ||
		fail "the console's port cannot be had (another program may have it): journalctl -u $CONSOLE.socket says why; for another port: sudo systemctl edit $CONSOLE.socket"
	systemctl restart $CONSOLE || fail "the console does not start: journalctl -u $CONSOLE says why"
	# It writes its address into its folder when it listens. On a busy Pi that takes some seconds.
	until [ -n "$(find /var/lib/$CONSOLE -name 'console-*.json' -newermt "@$((since - 1))" -print -quit 2>/dev/null)" ]; do
		systemctl is-active --quiet $CONSOLE ||
			fail "the console started and ended: $(journalctl --unit=$CONSOLE --lines=20 --output=cat |
				grep '^hexapod-gateway: ' | tail -n 1)"
		[ $(($(date +%s) - since)) -lt 60 ] || fail "the console does not listen after a minute: journalctl -u $CONSOLE"
		sleep 0.2
	done
}

# Without the unit, the console binds by itself.
give_port_back() {
	[ -e $CONSOLE_SOCKET ] || return 0
	say "remove $CONSOLE_SOCKET"
	run systemctl disable --quiet --now $CONSOLE.socket # ends the console, too
	run rm $CONSOLE_SOCKET
}

# The console of the release that was gone back to, with the units of that release: one from before the socket unit
# would leave the port to nobody, and listen at another.
rollback_console() {
	local units
	[ -e $CONSOLE_UNIT ] || return 0
	say "restart the console"
	for units in "$venv"/lib/python*/site-packages/gateway/deploy/systemd; do
		[ ! -e "$units/$CONSOLE.service" ] || put "$units/$CONSOLE.service" $CONSOLE_UNIT 0644
		if [ -e "$units/$CONSOLE.socket" ]; then
			put "$units/$CONSOLE.socket" $CONSOLE_SOCKET 0644
		else
			give_port_back
		fi
	done
	[ "$dry" = no ] || return 0
	systemctl daemon-reload
	systemctl stop $CONSOLE
	[ ! -e $CONSOLE_SOCKET ] || systemctl enable --quiet --now $CONSOLE.socket
	systemctl start $CONSOLE || say "the console does not start: journalctl -u $CONSOLE says why"
}

uninstall_console() {
	local file
	if [ -e "$CONSOLE_UNIT" ]; then
		say "stop and disable the console"
		give_port_back
		run systemctl disable --quiet --now $CONSOLE.service
		say "remove $CONSOLE_UNIT"
		run rm $CONSOLE_UNIT
		for file in $CONSOLE_SOCKET.d/*.conf; do
			[ ! -e "$file" ] || say "keep $file, your address"
		done
		run rm -rf /var/lib/$CONSOLE
	fi
	if [ -d $CONSOLE_ETC ]; then
		say "keep $CONSOLE_ETC, your options, for root only"
		run chown -R root:root $CONSOLE_ETC
		run chmod -R go= $CONSOLE_ETC
	fi
	if getent passwd $CONSOLE >/dev/null; then
		say "remove the user $CONSOLE"
		run userdel $CONSOLE
	fi
	if [ "$dry" = no ] && getent group $CONSOLE >/dev/null; then groupdel $CONSOLE; fi # some userdel leave it
}
