# shellcheck shell=bash
# SPI in a Raspberry Pi's config.txt. Read by install.sh.

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
