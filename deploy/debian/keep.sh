# dpkg removes or replaces the files of the installed release, one after the other. What runs stays whole: hard links of it,
# which dpkg does not know. What Python has compiled is removed from the folder that dpkg will remove.
lib=/usr/lib/hexapod-gateway
keep() {
	current=$(readlink -e $lib/current) || return 0
	case $current in
	*.kept) ;;
	*)
		rm -rf "$current.kept" "$current.new"
		cp -al "$current" "$current.new"
		mv -T "$current.new" "$current.kept"
		sync -f $lib
		ln -sfn "${current##*/}.kept" $lib/current.new
		mv -T $lib/current.new $lib/current
		sync -f $lib
		;;
	esac
	find $lib -name '*.kept' -prune -o -name __pycache__ -prune -exec rm -rf {} +
}
