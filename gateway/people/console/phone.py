"""`console --phone`: a certificate for this machine's address, and a page that explains the browser's warning.

That page is served without TLS, since a browser shows nothing of the console before the warning. It has no secret: the
link's token stands behind the # of its address, which browsers do not send.
"""

import datetime as dt
import socket
from contextlib import suppress
from pathlib import Path
from typing import Final

from aiohttp import web
from multidict import MultiMapping
from yarl import URL

from gateway.certs import CONSOLE_DAYS, authority
from gateway.certs.files import read_certificate
from gateway.errors import ConfigError
from gateway.files import durable
from gateway.people.commands.certs import DEFAULT_FOLDER
from gateway.people.console import ConsoleOptions
from gateway.people.console.server.auth import HEADERS, read_files
from gateway.people.console.server.site import LOCALHOST, Site, address_of, free_address

LISTEN: Final = "0.0.0.0:8443"
_FILES: Final = {"/": "/tap.html", "/tap.js": "/tap.js", "/refused.css": "/refused.css"}
_LEFT: Final = dt.timedelta(days=1)
"""A certificate that expires sooner is made anew: nobody has to tap again while the robot walks."""


def prepared(options: ConsoleOptions, folder: Path) -> ConsoleOptions:
    """`options` with an address that phones reach, and a certificate for it: --cert, the fleet's, or one made here.

    Raises ConfigError.
    """
    listen = options.listen or LISTEN
    if options.cert is not None or options.key is not None:
        return options._replace(listen=listen)
    address, _ = address_of(listen)
    own = _address() if address in ("0.0.0.0", "::") else address  # noqa: S104
    cert, key = _of_the_fleet(DEFAULT_FOLDER.expanduser(), own) or _made(folder / "phone.pem", own)
    return options._replace(listen=listen, cert=cert, key=key)


def door(site: Site) -> Site:
    """Return the site of the page that explains the warning, on a free port."""
    address, port = address_of(free_address(site.address))
    return Site(address, port, site.hosts)


async def explain(url: URL, headers: MultiMapping[str]) -> web.Response:
    """Return the page that explains the warning or one of its files, else 404."""
    file = read_files().get(_FILES.get(url.path, ""))
    found = web.Response(status=404) if file is None else file.response(headers)
    found.headers.update(HEADERS)
    found.force_close()
    return found


def _address() -> str:
    """Return the address by which the network reaches this machine. Raises ConfigError."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.connect(("192.0.2.1", 9))  # sends nothing; the system chooses the address of the way there
        return str(probe.getsockname()[0])
    raise ConfigError(
        "this machine has no network that a phone could reach; connect it, or name its --listen HOST:PORT"
    )


def _of_the_fleet(folder: Path, host: str) -> tuple[Path, Path] | None:
    """Return a console's certificate that `certs issue --role console` made for this host, and its key."""
    for authority_file in sorted(folder.glob("*-ca.pem")):
        stem = authority_file.name.removesuffix("-ca.pem")
        if _is_good(folder / f"{stem}.pem", host) and (folder / f"{stem}.key").exists():
            return folder / f"{stem}.pem", folder / f"{stem}.key"
    return None


def _made(path: Path, host: str) -> tuple[Path, Path]:
    """A certificate of its own, in one file with its key. The CA's key is not kept, so it signs nothing else."""
    if not _is_good(path, host):
        now, hosts = dt.datetime.now(dt.UTC), [host, *LOCALHOST, "localhost"]
        made = authority.make_leaf(authority.make_ca(now, hosts), authority.CONSOLE, "phone", hosts, CONSOLE_DAYS, now)
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            durable.write_like_the_folder(path, made.certificate_pem() + made.key_pem(), 0o600)
        except OSError as error:
            raise ConfigError(f"cannot write {path}: {error.strerror}") from error
    return path, path


def _is_good(path: Path, host: str) -> bool:
    with suppress(ConfigError):
        found = read_certificate(path)
        return host in authority.hosts_of(found) and found.not_valid_after_utc > dt.datetime.now(dt.UTC) + _LEFT
    return False
