# shellcheck shell=bash
# The console as a service of its own: install.sh --console, and every install after that. Read by install.sh.

CONSOLE=hexapod-console
CONSOLE_ETC=/etc/$CONSOLE
CONSOLE_UNIT=/etc/systemd/system/$CONSOLE.service

install_console() {
	[ $console = yes ] || [ -e "$CONSOLE_UNIT" ] || return 0
	if ! getent passwd $CONSOLE >/dev/null; then
		say "make the user $CONSOLE"
		getent group $CONSOLE >/dev/null || run groupadd --system $CONSOLE
		run useradd --system --gid $CONSOLE --no-create-home --home-dir /nonexistent \
			--shell /usr/sbin/nologin --comment "Hexapod console" $CONSOLE
	fi
	[ -d $CONSOLE_ETC ] || run install -d -m 0750 -o root -g $CONSOLE $CONSOLE_ETC
	if [ -e $CONSOLE_ETC/console.conf ]; then
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
		run systemctl start $CONSOLE
	elif [ $changed = yes ] || [ "$before" != "$venv" ]; then
		say "restart the console"
		run systemctl restart $CONSOLE
	fi
	[ -n "$next" ] || next="for a browser: sudo $NAME console --link"
}

uninstall_console() {
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
