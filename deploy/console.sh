# shellcheck shell=bash
# The console as a service of its own: install.sh --console, and every install after that. Read by install.sh.

CONSOLE=hexapod-console
CONSOLE_ETC=/etc/$CONSOLE
CONSOLE_UNIT=/etc/systemd/system/$CONSOLE.service

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
	put "$HERE/systemd/$CONSOLE.service" $CONSOLE_UNIT 0644
	run systemctl daemon-reload
	if ! systemctl is-enabled --quiet $CONSOLE 2>/dev/null; then
		say "enable the console: it starts with the machine"
		run systemctl enable --quiet $CONSOLE
	fi
	if ! systemctl is-active --quiet $CONSOLE; then
		say "start the console"
		begin_console
	elif [ "$changed$readable" != nono ] || [ "$before" != "$venv" ] || runs_another $CONSOLE; then
		check_no_servo_runs # its pages may drive
		say "restart the console"
		begin_console
	fi
	[ -n "$next" ] || next="for a browser: sudo $NAME console --link"
}

# systemd says that it is started as soon as there is a process; that process may still find a file that it cannot read.
begin_console() {
	[ "$dry" = no ] || return 0
	local since
	since=$(date +%s)
	run systemctl reset-failed $CONSOLE 2>/dev/null || true
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

uninstall_console() {
	local readable=no
	if [ -e "$CONSOLE_UNIT" ]; then
		say "stop and disable the console"
		run systemctl disable --quiet --now $CONSOLE
		say "remove $CONSOLE_UNIT"
		run rm $CONSOLE_UNIT
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
