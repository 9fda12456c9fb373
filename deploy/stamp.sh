# shellcheck shell=bash
# The version of what is built, with the commit that it is built from. Read by install.sh and wheels.sh.

# Three commits with one version would be hard to tell apart on a robot. So "1.1.0" becomes "1.1.0+g4aa0d07", and
# "1.1.0+g4aa0d07.changed" where files differ from the commit; without git it stays.
version_of() {
	local repository=$1 version commit state=''
	version=$(sed -n 's/^__version__ = "\(.*\)"$/\1/p' "$repository/gateway/__init__.py")
	# root installs from somebody else's repository, which git rejects unless it is named
	if commit=$(git -c safe.directory="$repository" -C "$repository" rev-parse --short=7 HEAD 2>/dev/null); then
		[ -z "$(git -c safe.directory="$repository" -C "$repository" status --porcelain -- pyproject.toml gateway schemas)" ] ||
			state=.changed
		version=$version+g$commit$state
	fi
	printf '%s\n' "$version"
}

# A copy of what a build needs: a build would leave files in the repository, and find old ones.
copy_sources() {
	local repository=$1 to=$2
	cp -r "$repository/pyproject.toml" "$repository/README.md" "$repository/LICENSE" "$repository/gateway" \
		"$repository/schemas" "$to"
	sed -i "s/^__version__ = .*/__version__ = \"$(version_of "$repository")\"/" "$to/gateway/__init__.py"
}
