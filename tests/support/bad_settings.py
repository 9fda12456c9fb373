"""Settings that is not allowed: in a file (its text), or in a variable; and the line that says so, after the place."""

SECTIONS = (
    "the sections are zenoh, wire, spi, controller, limits, watchdog, lease, buttons, state, telemetry, safety, power"
)
NO_VARIABLE = f"is no setting; a variable is named like HEXAPOD_SPI__DEVICE; {SECTIONS}"
WORD = "is not allowed: input should be"
INTEGER = f"{WORD} a valid integer"
NUMBER = f"{WORD} a valid number"
STRING = f"{WORD} a valid string"
FINITE = f"{WORD} a finite number"
LIST = """is not allowed: write the list as JSON, such as '["tcp/127.0.0.1:7447"]'"""
NO_SERVO = "is no servo; an id is the leg (1 to 6) and the joint (1 to 3), such as 32"

FILE_FAULTS = [
    # unknown names
    ("x = 1", "x: is no setting"),
    ("[spy]", "spy: is no setting"),
    ("[spi]\nsped_hz = 1", "spi.sped_hz: is no setting"),
    ('[spi]\n"a\\nb" = 1', r'spi."a\nb": is no setting'),
    (f"{'k' * 500} = 1", f'"{"k" * 79}…: is no setting'),
    ("[limits.servos.11]\nmin = 1", "limits.servos.11.min: is no setting"),
    ("[limits.servos.14]", f"limits.servos: 14 {NO_SERVO}"),
    ("[watchdog.landing]\n11 = 170\n[limits.servos.11]\nmax_deg = 120",
     "watchdog.landing.11: 170 is not allowed: limits.servos.11 allows 0 to 120"),
    # wrong types: nothing is converted
    ("spi = 3", "spi: 3 is not allowed: input should be an object"),
    ("[limits.servos]\n11 = 5", "limits.servos.11: 5 is not allowed: input should be an object"),
    ('[spi]\nspeed_hz = "1"', f'spi.speed_hz: "1" {INTEGER}'),
    ("[spi]\nspeed_hz = 1.0", f"spi.speed_hz: 1.0 {INTEGER}"),
    ("[spi]\ndevice = 0", f"spi.device: 0 {STRING}"),
    ("[spi]\ndevice = 1979-05-27", f'spi.device: "1979-05-27" {STRING}'),
    ('[spi]\ndevice = "/dev/\\u0000"', "spi.device: write the path of a device, such as /dev/spidev0.0"),
    ("[zenoh]\nconfig = 1979-05-27", f'zenoh.config: "1979-05-27" {STRING}'),
    ("[watchdog]\ntimeout_ms = true", f"watchdog.timeout_ms: true {NUMBER}"),
    ("[watchdog]\ntimeout_ms = 07:32:00", f'watchdog.timeout_ms: "07:32:00" {NUMBER}'),
    ('[power]\ninterface = "gs_usb"',
     'power.interface: Linux has a driver for this adapter: write interface = "socketcan", channel = "can0"'),
    ("[zenoh]\nallow_insecure = 1", "zenoh.allow_insecure: 1 is not allowed: input should be a valid boolean"),
    ('[zenoh]\nlisten = "tcp/a"', 'zenoh.listen: "tcp/a" is not allowed: input should be a valid array'),
    ('[zenoh]\nlisten = ["a", 1]', f"zenoh.listen[1]: 1 {STRING}"),
    ('[telemetry]\nframes = "no"', 'telemetry.frames: "no" is not allowed: input should be a valid boolean'),
    # not among the words
    ('[spi]\nframing = "Plain"', "spi.framing: \"Plain\" is not allowed: input should be 'plain' or 'length-prefixed'"),
    ('[watchdog]\nscope = "all"', "watchdog.scope: \"all\" is not allowed: input should be 'leg' or 'robot'"),
    ('[wire]\nname = "elkapod"',
     'wire: there is no wire "elkapod"; installed are "hexapod-1.0", "elkapod-2025"'),
    ('[spi]\nprotocol = "elkapod-2025"', "spi.protocol: was removed; write its value as name in [wire]"),
    ("[wire]\nbaud = 9600", "wire: baud is no setting of hexapod-1.0"),
    ('[watchdog]\nscope = "a\\nb"', r"""watchdog.scope: "a\nb" is not allowed: input should be 'leg' or 'robot'"""),
    # no finite number
    ("[limits]\nleg_rate_hz = nan", f"limits.leg_rate_hz: NaN {FINITE}"),
    ("[watchdog]\nlanding_ms = -inf", f"watchdog.landing_ms: -Infinity {FINITE}"),
    ("[limits.servos.11]\nmax_deg = nan", f"limits.servos.11.max_deg: NaN {FINITE}"),
    # values that do not go together, or have a form
    ("[limits.servos.11]\nmin_deg = 170\nmax_deg = 160",
     "limits.servos.11: min_deg is 170 and max_deg 160; min_deg must not be larger"),
    *((f'[telemetry]\nmetrics = "{text}"',
       'telemetry.metrics: write a host and a port, such as "127.0.0.1:9464", or "" for none')
      for text in ("9464", ":9464", "localhost", "localhost:", "localhost:0", "localhost:65536", "localhost:٣")),
    ('[controller]\nuart = "ttyAMA1"', "controller.uart: write the path of a device, such as /dev/ttyAMA1"),
    ("[safety]\nmin_battery_v = 6", "safety.min_battery_v: hexapod-1.0 has nothing that measures it; leave it at 0"),
    ("[safety]\nmax_tilt_deg = 45", "safety.max_tilt_deg: hexapod-1.0 has nothing that measures it; leave it at 0"),
    ('[wire]\nname = "elkapod-2025"\n[limits]\nstart_stagger_ms = 1',
     "limits.start_stagger_ms: elkapod-2025 starts all servos at once, so leave it at 0"),
    ("[limits]\nstart_stagger_ms = 250",
     "limits.start_stagger_ms: a leg's start may not wait for as long as watchdog.timeout_ms, 250"),
    ('[wire]\nname = "elkapod-2025"\n[safety]\nmax_tilt_deg = 9',
     "safety.max_tilt_deg: write 10 to 90, since a robot that walks tilts by some degrees, or 0 for never"),
    # much is not repeated
    (f'[spi]\ndevice = ["{"x" * 999}"]', f'spi.device: ["{"x" * 78}… {STRING}'),
]  # fmt: skip


ENVIRONMENT_FAULTS = [
    ("HEXAPOD_SPI__SPED_HZ", "1", NO_VARIABLE),
    ("HEXAPOD_SPY__DEVICE", "x", NO_VARIABLE),
    ("HEXAPOD_SPI", '{"device": "x"}', NO_VARIABLE),
    ("HEXAPOD_SPI_DEVICE", "x", NO_VARIABLE),
    ("HEXAPOD_SPI__DEVICE__X", "x", NO_VARIABLE),
    ("HEXAPOD_", "x", NO_VARIABLE),
    ("hexapod_spi__device", "x", NO_VARIABLE),
    ("HEXAPOD_spi__device", "x", NO_VARIABLE),
    ("HEXAPOD_LIMITS__SERVOS", "{}", NO_VARIABLE),
    ("HEXAPOD_LIMITS__SERVOS__14__MIN_DEG", "1", NO_VARIABLE),
    ("HEXAPOD_LIMITS__SERVOS__11__MIN", "1", NO_VARIABLE),
    ("HEXAPOD_SPI__SPEED_HZ", "", f'"" {INTEGER}, unable to parse string as an integer'),
    ("HEXAPOD_SPI__SPEED_HZ", "1e6", f'"1e6" {INTEGER}, unable to parse string as an integer'),
    ("HEXAPOD_WATCHDOG__TIMEOUT_MS", "true", f'"true" {NUMBER}, unable to parse string as a number'),
    ("HEXAPOD_WATCHDOG__TIMEOUT_MS", "nan", f'"nan" {FINITE}'),
    ("HEXAPOD_TELEMETRY__FRAMES", "maybe",
     '"maybe" is not allowed: input should be a valid boolean, unable to interpret input'),
    ("HEXAPOD_SPI__FRAMING", "x\ny", r'"x\ny" is not allowed: '
     "input should be 'plain' or 'length-prefixed'"),
    ("HEXAPOD_ZENOH__LISTEN", "tcp/a", f""""tcp/a" {LIST}"""),
    ("HEXAPOD_ZENOH__LISTEN", "[", f""""[" {LIST}"""),
    ("HEXAPOD_ZENOH__LISTEN", "[" * 5000, f""""{"[" * 79}… {LIST}"""),
    ("HEXAPOD_ZENOH__LISTEN", "[1]", f"1 {STRING}"),
    ("HEXAPOD_ZENOH__LISTEN", '"a"', '"a" is not allowed: input should be a valid array'),
    ("HEXAPOD_TELEMETRY__METRICS", "x", 'write a host and a port, such as "127.0.0.1:9464", or "" for none'),
]  # fmt: skip
