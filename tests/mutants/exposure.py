"""Mutants of gateway/robot/edge/exposure.py: who could reach the gateway."""

from tests.mutants.mutant import Mutant, Subject

EXPOSURE = Subject(
    "gateway/robot/edge/exposure.py",
    tests=("tests/unit/robot/test_exposure.py",),
    mutants=(
        Mutant('{"unixsock-stream", "unixpipe"}', '{"unixsock-stream", "unixpipe", "serial"}', "a cable is a way in"),
        Mutant('{"unixsock-stream", "unixpipe"}', '{"unixpipe"}', "a Unix socket needs a certificate"),
        Mutant('{"tcp", "udp", "tls", "quic", "ws"}', '{"tcp", "tls", "quic", "ws"}', "local UDP is rejected"),
        Mutant(
            '_TLS_LINKS: Final = frozenset({"tls", "quic"})',
            '_TLS_LINKS: Final = frozenset({"tls"})',
            "QUIC is rejected",
        ),
        Mutant(
            '_TLS_LINKS: Final = frozenset({"tls", "quic"})',
            '_TLS_LINKS: Final = frozenset({"tls", "quic", "tcp"})',
            "plain TCP counts as TLS: anyone may command",
        ),
        Mutant(
            "if not listen and not connect_endpoints(config):",
            "if not listen:",
            "a robot behind a router does not start",
        ),
        Mutant(
            "if not listen and not connect_endpoints(config):",
            "if False:",
            "a gateway that nobody reaches starts and says nothing",
        ),
        Mutant(
            "for endpoint in listen if is_open_to_anyone(endpoint, config)]",
            "for endpoint in listen[:1] if is_open_to_anyone(endpoint, config)]",
            "only the first endpoint is looked at",
        ),
        Mutant("if open_to_anyone and not allow_insecure:", "if False:", "anyone may command, and nobody is asked"),
        Mutant("if open_to_anyone and not allow_insecure:", "if open_to_anyone:", "allow_insecure is ignored"),
        Mutant(
            "    if open_to_anyone:\n        logger.warning(",
            "    if False:\n        logger.warning(",
            "allow_insecure is silent",
        ),
        Mutant(
            "if not is_local(endpoint) and not _knows_whom_it_dials(endpoint, config):",
            "if not is_local(endpoint) and False:",
            "it dials a stranger and says nothing",
        ),
        Mutant(
            "if not is_local(endpoint) and not _knows_whom_it_dials(endpoint, config):",
            "if not _knows_whom_it_dials(endpoint, config):",
            "a router on the same machine is warned of",
        ),
        Mutant("if _dials_whom_it_finds(config):", "if False:", "it dials whom it finds and says nothing"),
        Mutant(
            'if get(config, "access_control/rules") and get(config, "access_control/enabled") is not True:',
            "if False:",
            "rules that nobody enabled look as if they held",
        ),
        Mutant("    _check_namespace(config)\n", "", "nobody can stop a robot whose rules lack its namespace"),
        Mutant(
            'if not namespace or not rules or get(config, "access_control/enabled") is not True:',
            "if not namespace or not rules:",
            "rules that are switched off keep the service from starting",
        ),
        Mutant('(f"{namespace}/", "*")', '(f"{namespace}", "*")', "robot-10 passes for robot-1"),
        Mutant('(f"{namespace}/", "*")', 'f"{namespace}/"', "rules for all namespaces are rejected"),
        Mutant(
            "    if not any(key.startswith(",
            "    if not all(key.startswith(",
            "a rule for something else beside its own keeps the service from starting",
        ),
        Mutant("        is_local(endpoint)\n", "        False\n", "loopback needs certificates"),
        Mutant("        or _demands_certificate(endpoint, config)\n", "", "certificates are not enough"),
        Mutant(
            "        or _demands_certificate(endpoint, config)\n",
            "        or _is_tls(endpoint)\n",
            "TLS without client certificates counts as closed",
        ),
        Mutant(
            "(_demands_password(config) and not _may_be_multicast(endpoint))",
            "_demands_password(config)",
            "a multicast group takes what anyone sends",
        ),
        Mutant(
            "(_demands_password(config) and not _may_be_multicast(endpoint))",
            "False",
            "a password is not enough",
        ),
        Mutant(
            "    if link not in _IP_LINKS:\n        return False\n", "", "an unknown link with a local address is local"
        ),
        Mutant('_host(rest) == "localhost"', '_host(rest).startswith("localhost")', "localhost.example.com is local"),
        Mutant('_host(rest) == "localhost"', '"localhost" in rest', "localhost.example.com is local"),
        Mutant("ip.is_loopback)", "ip.is_private)", "everyone on the same network is local"),
        Mutant("ip.is_loopback)", "(ip.is_loopback or ip.is_link_local))", "everyone on the same cable is local"),
        Mutant("ip.is_loopback)", "(ip.is_loopback or ip.is_unspecified))", "all addresses count as this machine's"),
        Mutant(
            'address.partition("#")[0].partition("?")[0]',
            'address.partition("?")[0]',
            "settings behind the address hide where it is",
        ),
        Mutant(
            'address.partition("#")[0].partition("?")[0]',
            'address.partition("#")[0]',
            "parameters behind the address hide where it is",
        ),
        Mutant(
            "ip.ipv4_mapped if isinstance(ip, ipaddress.IPv6Address) else None) or ip",
            "None) or ip",
            "::ffff:224.… is no group",
        ),
        Mutant(
            'return link == "udp" and (ip is None or ip.is_multicast)', "return False", "a group is not known as one"
        ),
        Mutant(
            'return link == "udp" and (ip is None or ip.is_multicast)',
            'return link == "udp" and ip is not None and ip.is_multicast',
            "a name may be a group's",
        ),
        Mutant('get(config, "transport/link/tls/enable_mtls") is True', "True", "certificates that nobody demands"),
        Mutant(
            'and bool(get(config, "transport/link/tls/root_ca_certificate"))', "", "certificates that nobody checks"
        ),
        Mutant('        and "mtls" not in overrides\n', "", "an endpoint switches client certificates off"),
        Mutant('        and "root_ca" not in overrides\n', "", "an endpoint brings a CA of its own"),
        Mutant(
            'and get(config, "transport/link/tls/verify_name_on_connect") is not False',
            "",
            "a name that nobody checks",
        ),
        Mutant(
            '        and "verify_name" not in endpoint.partition("#")[2]\n',
            "",
            "an endpoint switches the look at the name off",
        ),
        Mutant(
            "only_tls = bool(links) and _TLS_LINKS.issuperset(links)",
            "only_tls = bool(links)",
            "scouting over TCP is not told",
        ),
        Mutant(
            "only_tls = bool(links) and _TLS_LINKS.issuperset(links)",
            "only_tls = _TLS_LINKS.issuperset(links or [])",
            "scouting over all links is not told",
        ),
        Mutant('for way in ("multicast", "gossip")', 'for way in ("multicast",)', "gossip is not told"),
        Mutant('for way in ("multicast", "gossip")', 'for way in ("gossip",)', "multicast is not told"),
        Mutant("any(user and password for", "any(user for", "a user without a password is enough"),
        Mutant("any(user and password for", "any(password for", "a password without a user is enough"),
        Mutant(
            "any(user and password for", "all(user and password for", "an empty dictionary, which is none, is enough"
        ),
        Mutant(
            'found = found.get(get(config, "mode") or "peer", [])',
            'found = found.get("peer", [])',
            "the endpoints of another mode are looked at",
        ),
    ),
)
