# shellcheck shell=bash
# A signed bundle: looked at as a whole before anything of it is unpacked. Read by install.sh.
#
# A tar with files only: SHA256SUMS, which names every other file, SHA256SUMS.sig (ssh-keygen -Y), release.pub, and what
# `make wheels` makes. ssh-keygen: every Raspberry Pi OS has it, and it verifies before any Python package is there.

NAMESPACE=hexapod-gateway-release
TRUSTED=$ETC/release.pub
NO_SUM='SHA256SUMS SHA256SUMS.sig'

# Goes on with the installer that is in the bundle; fails, before anything is changed, with one sentence.
open_bundle() {
	local signer names kinds name sum given known copy
	command -v ssh-keygen >/dev/null || fail "ssh-keygen is missing: sudo apt-get install openssh-client"
	remove_left
	unpacked=$(mktemp -d /var/tmp/$NAME.$$.XXXXXX) || fail_full
	copy=$unpacked/bundle # what is verified is what is unpacked, whoever can write to the original
	cp "$bundle" "$copy" 2>/dev/null || fail_full
	names=$(tar -tf "$copy" 2>/dev/null) || fail "$bundle is no bundle of \`make dist\`, or was cut off; nothing was changed"
	# Here-strings, no pipes: grep -q goes at the first match, and pipefail would take the writer's end for "none".
	kinds=$(tar -tvf "$copy" | cut -c1)
	! grep -qv '^-$' <<<"$kinds" || fail "$bundle has something else than files in it; nothing was changed"
	if grep -q / <<<"$names" || [ -n "$(printf '%s\n' "$names" | sort | uniq -d)" ]; then
		fail "$bundle has a file in a folder, or one twice, as no bundle of \`make dist\` has; nothing was changed"
	fi
	for name in $NO_SUM release.pub; do
		if grep -qxF "$name" <<<"$names"; then
			tar -xOf "$copy" "$name" >"$unpacked/$name"
		elif [ "$name" = SHA256SUMS.sig ]; then
			fail "$bundle is not signed; nothing was changed"
		else
			fail "$bundle has no $name; nothing was changed"
		fi
	done
	signer=$(ssh-keygen -Y check-novalidate -n $NAMESPACE -s "$unpacked/SHA256SUMS.sig" <"$unpacked/SHA256SUMS" 2>/dev/null |
		sed -n 's/.* key \(SHA256:[^ ]*\)$/\1/p') || true
	[ -n "$signer" ] || fail "the signature of $bundle is not of its sums: it was changed; nothing was done"
	check_signer "$signer"
	printf 'release namespaces="%s" %s\n' $NAMESPACE "$(cut -d' ' -f1,2 "$unpacked/release.pub")" >"$unpacked/signers"
	ssh-keygen -Y verify -f "$unpacked/signers" -I release -n $NAMESPACE -s "$unpacked/SHA256SUMS.sig" \
		<"$unpacked/SHA256SUMS" >/dev/null 2>&1 ||
		fail "the signature of $bundle is not that of the key in it; nothing was changed"
	given=$(printf '%s\n' "$names" | grep -vx -e SHA256SUMS -e SHA256SUMS.sig | LC_ALL=C sort)
	known=$(sed 's/^[0-9a-f]*  //' "$unpacked/SHA256SUMS" | LC_ALL=C sort)
	[ "$given" = "$known" ] || fail "$bundle has other files than its sums name; nothing was changed"
	while read -r sum name; do
		[ "$(tar -xOf "$copy" "$name" | sha256sum | cut -d' ' -f1)" = "$sum" ] ||
			fail "$name in $bundle is not what was released: it was changed; nothing was done"
	done <"$unpacked/SHA256SUMS"
	mkdir "$unpacked/files"
	tar -xf "$copy" -C "$unpacked/files" --no-same-owner --no-same-permissions 2>/dev/null || fail_full
	rm "$copy"
	wheels=$unpacked/files
	check_not_older
	say "$bundle is what the key $signer has signed"
	[ -s "$TRUSTED" ] && cmp -s "$unpacked/release.pub" "$TRUSTED" ||
		say "this key is trusted from now on: compare it with the one that the project names"
	# The unit, the rules and what the installer does belong to its release.
	"$python" -m zipfile -e "$wheels"/hexapod_gateway-*.whl "$unpacked/own" 2>/dev/null || fail_full
	exec bash "$unpacked/own/gateway/deploy/install.sh" --opened "$unpacked" "${handed_on[@]}"
}

# What installers have left that were killed: their number is in the folder's name, and it stays the same with exec. Only
# root's own: any user may make a folder in /var/tmp.
remove_left() {
	local left process
	while IFS= read -r left; do
		process=${left#/var/tmp/$NAME.} process=${process%.*}
		kill -0 "$process" 2>/dev/null || run rm -rf "$left"
	done < <(find /var/tmp -maxdepth 1 -type d -user root \( -name "$NAME.[1-9]*.??????" -o \
		-name "$NAME.??????" -mtime +0 \)) # the latter: of installers that put no number into the name
}

fail_full() {
	fail "/var/tmp has no room for $bundle (it takes three times its $(du -h "$bundle" | cut -f1)): free some there; nothing was changed"
}

# The key is trusted at the first installation; another one has to be named.
check_signer() {
	local signer=$1 now=''
	[ ! -s "$TRUSTED" ] || now=$(ssh-keygen -lf "$TRUSTED" 2>/dev/null | cut -d' ' -f2)
	if [ -n "$trust" ] && [ "$trust" != "$signer" ]; then
		fail "$bundle is signed by the key $signer, and --trust names $trust; nothing was changed"
	fi
	if [ -n "$now" ] && [ "$now" != "$signer" ] && [ -z "$trust" ]; then
		fail "$bundle is signed by another key ($signer) than this robot trusts ($now); if the project says that its key has changed: --trust $signer"
	fi
}

# Exit code 1: the second version is older by PEP 440's order, or as old with an earlier time. `sort -V` takes 1.2.0rc1 for
# newer than 1.2.0. What follows the +, the commit, has no order.
OLDER='
import re, sys
def order(version):
    found = re.fullmatch(r"(\d+(?:\.\d+)*)(?:(a|b|rc)(\d+))?(?:\.post(\d+))?(?:\.dev(\d+))?(?:\+.*)?", version)
    if not found:
        sys.exit(2)
    release, stage, number, post, dev = found.groups()
    if stage is None:  # a mere .dev is older than each a, b and rc
        stage = "final" if dev is None or post is not None else ""
    numbers = [int(part) for part in re.sub(r"(\.0)+$", "", release).split(".")]
    return numbers, ("", "a", "b", "rc", "final").index(stage), int(number or 0), int(post or -1), float(dev or "inf")
present, offered = map(order, sys.argv[1:3])
times = [int(time) for time in sys.argv[3:] if time]
sys.exit(offered < present or (offered == present and len(times) == 2 and times[1] < times[0]))
'

is_older() { ! "$python" -c "$OLDER" "$@"; }

# An older release has the mistakes that a newer one has lost. Of two with the same number, such as two builds between
# releases, the older is that of the older commit; its time is in the wheel, which is signed.
check_not_older() {
	local offered present was comes
	offered=$(compgen -G "$wheels/hexapod_gateway-*.whl") || fail "$bundle has no hexapod_gateway-*.whl; nothing was changed"
	present=$(version_in "$OPT/venv" 2>/dev/null || true)
	[ -n "$present" ] && [ $allow_downgrade = no ] || return 0
	was=$(cat "$OPT/venv/commit-time" 2>/dev/null || true) comes=$(time_of "$offered")
	offered=$(basename "$offered" | cut -d- -f2)
	! is_older "$present" "$offered" "$was" "$comes" ||
		fail "$bundle has release $offered, and $present is installed, which is newer; if that is meant: --allow-downgrade"
}

# Once the rest is there.
keep_trust() {
	[ -z "$opened" ] || put "$unpacked/release.pub" "$TRUSTED" 0644
}
