# shellcheck shell=bash
# SPI, and the UARTs of a Pi 5, in a Raspberry Pi's config.txt. Read by install.sh.

# Whether a config.txt on stdin switches SPI on for every Pi: what stands under a filter such as [cm4] does not count.
spi_is_on() {
	awk '{ sub(/\r$/, ""); sub(/^[ \t]+/, "") }
		/^\[/ { filtered = $0 !~ /^\[all\]/ }
		!filtered && /^dtparam=/ {
			n = split(substr($0, 9), parameters, ",")
			for (i = 1; i <= n; i++) {
				if (parameters[i] ~ /^spi(=on|=1|=true|=yes)?[ \t]*$/) on = 1
				else if (parameters[i] ~ /^spi=/) on = 0
			}
		}
		END { exit !on }'
}

# A config.txt from stdin to stdout: its own dtparam=spi line switched on, or else one as the first line, where no
# filter and no overlay can claim it.
switch_spi_on() {
	awk '{ lines[NR] = $0 }
		/^[ \t]*\[/ { filtered = $0 !~ /\[all\]/ }
		!filtered && /^[ \t]*#?[ \t]*dtparam=spi(=on|=off)?[ \t\r]*$/ { lines[NR] = "dtparam=spi=on"; found = 1 }
		END {
			if (!found) print "dtparam=spi=on"
			for (i = 1; i <= NR; i++) print lines[i]
		}'
}

# Whether a config.txt on stdin loads this overlay on a Pi 5, with or without parameters.
overlay_is_on() {
	awk -v name="$1" '{ sub(/\r$/, ""); sub(/^[ \t]+/, "") }
		/^\[/ { filtered = $0 !~ /^\[(all|pi5)\]/ }
		!filtered && $0 ~ "^dtoverlay=" name "[ \t]*(,.*)?$" { on = 1 }
		END { exit !on }'
}

# A config.txt from stdin to stdout, with this overlay at its end, for a Pi 5 alone. The empty dtoverlay= ends it, so that
# no later dtparam is taken for the overlay's.
switch_overlay_on() {
	awk '{ print }'
	printf '[pi5]\ndtoverlay=%s\ndtoverlay=\n[all]\n' "$1"
}
