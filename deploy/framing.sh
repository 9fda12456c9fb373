# Part of install.sh: which framing the controller needs. Nobody can guess it, and the published STM32 firmware that has
# once heard the wrong one hears nothing more until it is reset, no Stop either. So it is said before anything is changed.

WHICH="length-prefixed for the published STM32 firmware, plain for a controller that follows the protocol's document"

# Sets `framing`, and `said_framing` to a file that is the configuration with it, unless the one that is there has it.
check_framing() {
	local file=$ETC/gateway.toml found=''
	if [ -d $ETC ] && [ ! -x $ETC ]; then # a dry run by somebody else than root
		fail "$ETC may be looked into by root only: sudo $0 --dry-run"
	fi
	if [ -e $file ]; then
		found=$(framing_in $file) || fail "$file is not TOML, or its [spi] no table; fix it first"
	else
		file=$HERE/gateway.toml
	fi
	if [ -n "$found" ]; then
		[ "${framing:-$found}" = "$found" ] ||
			fail "$file says framing = \"$found\", and --framing $framing; change it there, or leave the option out"
		framing=$found
		return
	fi
	[ -n "$framing" ] || ask_framing
	said_framing=$(mktemp)
	with_framing <"$file" >"$said_framing"
	same_but_framing "$file" "$said_framing" ||
		fail "$file does not say which framing the controller needs; add framing = \"$framing\" to its spi settings"
}

ask_framing() {
	local answer
	[ -t 0 ] || fail "which framing does the controller need? Say --framing: $WHICH"
	printf '%s\n' "Which framing does the controller need?" \
		"  length-prefixed   the published STM32 firmware (once it has heard plain, only a reset brings it back)" \
		"  plain             a controller that reads frames as the protocol's document says" >&2
	until [ "$framing" = plain ] || [ "$framing" = length-prefixed ]; do
		printf 'length-prefixed or plain? ' >&2
		read -r answer || fail "which framing does the controller need? Say --framing: $WHICH"
		framing=$answer
	done
}

# The framing that a configuration says; nothing, if it says none.
framing_in() {
	"$python" -c 'import sys, tomllib
with open(sys.argv[1], "rb") as file: print(tomllib.load(file).get("spi", {}).get("framing", ""))' "$1" 2>/dev/null
}

# A configuration from stdin to stdout, with the framing: where its comment stands, else below [spi], else at the end.
with_framing() {
	awk -v said="framing = \"$framing\"" '
		{ lines[NR] = $0 }
		/^[ \t]*\[/ { in_spi = 0 }
		/^[ \t]*\[[ \t]*spi[ \t]*\]/ { head = NR; in_spi = 1 }
		in_spi && /^# *framing *=/ { comment = NR }
		END {
			for (i = 1; i <= NR; i++) {
				print i == comment ? said : lines[i]
				if (i == head && !comment) print said
			}
			if (!head) print "\n[spi]\n" said
		}'
}

same_but_framing() {
	"$python" -c 'import sys, tomllib
before, after = (tomllib.load(open(path, "rb")) for path in sys.argv[1:3])
before.setdefault("spi", {})["framing"] = sys.argv[3]
sys.exit(before != after)' "$1" "$2" "$framing" 2>/dev/null
}

# The running service keeps what it started with, for the Stops after its end; without a framing there would be none.
add_to_kept() {
	local kept=/run/$NAME/gateway.toml with
	[ -e $kept ] && [ -z "$(framing_in $kept)" ] || return 0
	with=$(with_framing <$kept)
	printf '%s\n' "$with" >$kept
}
