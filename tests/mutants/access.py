"""Mutants of gateway/certs/access.py and zenoh_files.py: who may say what to the robot."""

from tests.mutants.mutant import Mutant, Subject

ACCESS = Subject(
    "gateway/certs/access.py",
    tests=("tests/unit/test_access.py",),
    mutants=(
        Mutant(
            '("put", "delete", "query"), (ALL_COMMANDS,), operators_only=True)',
            '("put", "delete", "query"), (ALL_COMMANDS,))',
            "an observer commands",
        ),
        Mutant(
            '("put", "delete", "query"), (ALL_COMMANDS,)',
            '("put", "query"), (ALL_COMMANDS,)',
            "no delete stops anything",
        ),
        Mutant(
            '("put", "delete", "query"), (ALL_COMMANDS,)',
            '("put", "delete"), (ALL_COMMANDS,)',
            "nothing is acknowledged",
        ),
        Mutant(
            '("put", "delete", "query"), (ALL_COMMANDS,)',
            '("put", "delete", "query"), tuple(COMMAND_KEYS)',
            "no wildcard stops all legs",
        ),
        Mutant(
            '("put", "delete", "query"), (ALL_COMMANDS,)',
            '("put", "delete", "query"), ("**",)',
            "an operator poses as the robot",
        ),
        Mutant(
            '("put", "delete", "query"), (ALL_COMMANDS,)',
            '("put", "delete", "query", "reply"), (ALL_COMMANDS,)',
            "an operator answers others' commands",
        ),
        Mutant(
            '"acknowledgements", False, ("reply",)',
            '"acknowledgements", True, ("reply",)',
            "operators answer, the robot does not",
        ),
        Mutant(
            '("reply",), (ALL_COMMANDS,), operators_only=True)',
            '("reply",), (ALL_COMMANDS,))',
            "an observer sees answers to others",
        ),
        Mutant(
            '        ("declare_subscriber", "declare_queryable"),\n        (ALL_COMMANDS,),\n        operators_only=True,',
            '        ("declare_subscriber", "declare_queryable"),\n        (ALL_COMMANDS,),',
            "an observer learns which commands the robot takes",
        ),
        Mutant(
            '        ("declare_subscriber", "declare_queryable"),\n        (ALL_COMMANDS,),',
            '        ("declare_subscriber",),\n        (ALL_COMMANDS,),',
            "no acknowledged command reaches the robot",
        ),
        Mutant(
            '        "commands that it takes",\n        False,',
            '        "commands that it takes",\n        True,',
            "an operator listens to others' commands",
        ),
        Mutant(
            '"watching", True, ("declare_subscriber",), PUBLISHED',
            '"watching", True, ("declare_subscriber",), ("hexapod/*",)',
            "an observer declares 20 000 keys, and Stops are late",
        ),
        Mutant(
            '"watching", True, ("declare_subscriber",), PUBLISHED',
            '"watching", True, ("declare_subscriber", "put"), PUBLISHED',
            "an observer invents the robot's state",
        ),
        Mutant(
            '"watching", True, ("declare_subscriber",)',
            '"watching", True, ("declare_subscriber", "declare_queryable")',
            "an observer answers in the robot's place",
        ),
        Mutant(
            '"watching", True, ("declare_subscriber",), PUBLISHED',
            '"watching", True, ("declare_subscriber",), (ALL_COMMANDS, *PUBLISHED)',
            "an observer overhears commands",
        ),
        Mutant(
            '"telemetry", False, ("put",), PUBLISHED',
            '"telemetry", False, ("put",), PUBLISHED[:1]',
            "no event is heard",
        ),
        Mutant(
            '"asking for state and calibration", True, ("query",), ASKABLE',
            '"asking for state and calibration", True, ("query",), PUBLISHED',
            "more may be asked than is answered",
        ),
        Mutant('("reply", "declare_queryable"), ASKABLE', '("reply",), ASKABLE', "nobody can ask for the state"),
        Mutant(
            '("declare_liveliness_subscriber", "liveliness_query"), (ALIVE,)',
            '("declare_liveliness_subscriber", "liveliness_query"), ("**",)',
            "an observer declares without end",
        ),
        Mutant(
            '"alive", False, ("liveliness_token",)',
            '"alive", True, ("liveliness_token",)',
            "an observer pretends that the robot lives",
        ),
        Mutant(
            '"ingress" if each.from_people is not robots_side else "egress"',
            '"egress" if each.from_people is not robots_side else "ingress"',
            "all directions are turned round",
        ),
        Mutant('f"{namespace}/{key}" if namespace else key', "key", "with a namespace, nobody can stop the robot"),
        Mutant(
            'f"{namespace}/{key}" if namespace else key',
            'f"*/{key}" if namespace else key',
            "whoever may command one robot commands its neighbours",
        ),
        Mutant(
            "each.operators_only is not for_all]",
            "each.operators_only is for_all]",
            "observers command, operators watch",
        ),
        Mutant("if for_all is None or each.operators_only is not for_all]", "]", "an observer commands"),
        Mutant('permission: "allow"', 'permission: "deny"', "nobody commands the robot, nor stops it"),
    ),
)

ZENOH_FILES = Subject(
    "gateway/certs/zenoh_files.py",
    tests=("tests/unit/test_access.py", "tests/unit/people/test_certs.py"),
    mutants=(
        Mutant(
            "enable_mtls: true,\n        verify_name_on_connect: true,\n        close_link",
            "enable_mtls: false,\n        verify_name_on_connect: true,\n        close_link",
            "whoever reaches the robot commands it",
        ),
        Mutant(
            "verify_name_on_connect: true,\n        close_link",
            "verify_name_on_connect: false,\n        close_link",
            "the robot dials whoever answers",
        ),
        Mutant(
            "close_link_on_expiration: true",
            "close_link_on_expiration: false",
            "who is in stays in after its certificate",
        ),
        Mutant(
            "    enabled: true,\n    default_permission",
            "    enabled: false,\n    default_permission",
            "observers command",
        ),
        Mutant('default_permission: "deny"', 'default_permission: "allow"', "observers command"),
        Mutant("rules: @OPERATORS_RULES@", "rules: @EVERYONES_RULES@", "operators watch only"),
        Mutant('{ subjects: ["operator"],\n', '{ subjects: ["operator", "observer"],\n', "observers command"),
        Mutant('{ subjects: ["operator", "observer"],\n', '{ subjects: ["observer"],\n', "operators see nothing"),
        Mutant(
            'flows: ["ingress"], messages: ["put", "delete", "query", "reply"], key_exprs: ["**"]',
            'flows: ["egress"], messages: ["put", "delete", "query", "reply"], key_exprs: ["**"]',
            "what comes in has no limit",
        ),
        Mutant(
            'messages: ["put", "delete", "query", "reply"], key_exprs: ["**"]',
            'messages: ["put", "delete", "reply"], key_exprs: ["**"]',
            "a question has no limit",
        ),
        Mutant("size_limit: @SIZE_LIMIT@", "size_limit: @MAX_MESSAGE_SIZE@", "four times as much reaches the gateway"),
        Mutant(
            'shared_memory: { enabled: false },\n    link: {\n      protocols: ["tls"],\n      // A link',
            'shared_memory: { enabled: true },\n    link: {\n      protocols: ["tls"],\n      // A link',
            "shared memory goes around the size limit",
        ),
        Mutant(
            'protocols: ["tls"],\n      // A link',
            'protocols: ["tls", "tcp"],\n      // A link',
            "the robot dials without TLS",
        ),
        Mutant("adminspace: { enabled: false }", "adminspace: { enabled: true }", "visitors read the configuration"),
        Mutant(
            'rx: { max_message_size: @MAX_MESSAGE_SIZE@ },\n      tls: {\n        root_ca_certificate: "ca.pem",\n        listen',
            'tls: {\n        root_ca_certificate: "ca.pem",\n        listen',
            "one message of 400 MB kills the service",
        ),
        Mutant(
            "tx: { lease: 1000 },\n      // No message",
            "tx: { lease: 10000 },\n      // No message",
            "a dead link holds what waits on it for 10 s",
        ),
        Mutant(
            "gossip: { enabled: false } },\n  adminspace",
            "gossip: { enabled: true } },\n  adminspace",
            "the robot is told of whoever is about",
        ),
        Mutant(
            "RULES=access.rules(namespace=namespace)",
            "RULES=access.rules()",
            "with a namespace, nobody can stop the robot",
        ),
        Mutant(
            "        NAMESPACE=_namespace(namespace),\n        RULES",
            '        NAMESPACE="",\n        RULES',
            "robots share their keys",
        ),
        Mutant(
            "ENDPOINTS=endpoints, NAMESPACE=_namespace(namespace))",
            'ENDPOINTS=endpoints, NAMESPACE="")',
            "a laptop commands all robots, or none",
        ),
        Mutant("for host in hosts])\n", "for host in hosts[:1]])\n", "a second host is never tried"),
        Mutant(
            "enable_mtls: true,\n        verify_name_on_connect: true,\n      },",
            "enable_mtls: true,\n        verify_name_on_connect: false,\n      },",
            "a laptop commands whoever poses as its robot",
        ),
        Mutant('mode: "client",@NAMESPACE@', 'mode: "peer",@NAMESPACE@', "a laptop listens, too"),
        Mutant(
            "ip_address(host).version == 6 else host",
            "ip_address(host).version == 4 else host",
            "an IPv6 address cannot be dialled",
        ),
    ),
)
