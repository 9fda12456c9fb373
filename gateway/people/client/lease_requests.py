"""Requests about the lease and the stop buttons, in the name of the certificate's person; and a stop button.

A nonce signed with the certificate's key proves the person. `cryptography` and the answers' models are imported at the
first request, so that no emergency stop waits for them. No request keeps a token.
"""

import base64
import json
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, Self, TypeVar, cast

import zenoh

from gateway import certs
from gateway.errors import ConfigError, DisconnectedError, RejectedError
from gateway.zenoh.config import get
from schemas.ack import Ack, Answer
from schemas.keys import BUTTON, LEASE
from schemas.words import Reason

if TYPE_CHECKING:
    from cryptography import x509

    from schemas.button import ButtonAck
    from schemas.lease import LeaseAck

_ISSUE: Final = "`hexapod-gateway certs issue NAME --role operator --dir DIR`"


@dataclass(frozen=True)
class Identity:
    """A client's certificate and key, and the CA that it trusts, as its Zenoh file names them."""

    certificate: Path | None = None
    key: Path | None = None
    ca: Path | None = None
    verify_name: bool = True

    @classmethod
    def of(cls, config: zenoh.Config) -> "Identity":
        """Read it from a configuration with absolute paths."""
        settings = ("connect_certificate", "connect_private_key", "root_ca_certificate", "verify_name_on_connect")
        *files, verify_name = (get(config, f"transport/link/tls/{setting}") for setting in settings)
        certificate, key, ca = (Path(file) if isinstance(file, str) else None for file in files)
        return cls(certificate, key, ca, verify_name is not False)

    @property
    def proves(self) -> bool:
        """Whether there are a certificate and its key."""
        return self.certificate is not None and self.key is not None

    def person(self) -> str:
        """Return the person of the certificate, if it `proves`: the organizational unit. Raises ConfigError without."""
        from cryptography.x509.oid import NameOID

        units = self._read().subject.get_attributes_for_oid(NameOID.ORGANIZATIONAL_UNIT_NAME)
        if not units:
            raise ConfigError(f"{self.certificate} names no person: get one from {_ISSUE}")
        return str(units[0].value)

    def prove(
        self, do: str, source: str, nonce: str, text: Callable[[str, str, str], bytes] | None = None
    ) -> dict[str, str]:
        """Return the proof that this person requests `do` now. `text` makes the signed text, by default a lease's.

        Only if it `proves`. Raises ConfigError for an unusable certificate or key.
        """
        from cryptography.hazmat.primitives import serialization

        from schemas.lease import signed_text

        signature = certs.proof.sign(cast(Path, self.key), (text or signed_text)(do, source, nonce))
        pem = self._read().public_bytes(serialization.Encoding.PEM).decode()
        return {"nonce": nonce, "certificate": pem, "signature": base64.b64encode(signature).decode()}

    def _read(self) -> "x509.Certificate":
        return certs.files.read_certificate(cast(Path, self.certificate))


A = TypeVar("A", bound=Answer)
Request = dict[str, Any]


class Get(Protocol):
    """Queries a key, for at most `timeout_s` (None: the client's own time)."""

    def __call__(self, key: str, payload: str, answer: type[A], *, timeout_s: float | None) -> A: ...


class Requests:
    """The requests on `hexapod/lease/cmd` and `hexapod/button/cmd`.

    All raise DisconnectedError if no answer comes in time, and those of a person ConfigError for an unusable
    certificate or key.
    """

    def __init__(self, get: Get, identity: Identity, name: str) -> None:
        """`name` is the person's name without a certificate."""
        self._get = get
        self._identity = identity
        self._name = name

    def as_person(self, do: str, name: str | None) -> "LeaseAck":
        """Request `do` of the lease: `acquire`, `ask` or `take`."""
        return self._lease(self._proved(self._lease, do, self._person(name)))

    def renew(self, token: str, timeout_s: float | None = None) -> "LeaseAck":
        """Prolong the lease by `ttl_ms`."""
        return self._lease({"do": "renew", "lease": token}, timeout_s)

    def release(self, token: str, to: str | None = None, timeout_s: float | None = None) -> "LeaseAck":
        """Give the lease back, or hand it over to the person `to`."""
        return self._lease({"do": "release", "lease": token, **({} if to is None else {"to": to})}, timeout_s)

    def button_name(self, name: str | None = None) -> str:
        """Return the name to register. A person may have several buttons, as `PERSON/…`."""
        person = self._person(name)
        return name if name is not None and name.startswith(f"{person}/") else person

    def register(self, name: str | None = None, sent_ms: float | None = None) -> "ButtonAck":
        """Register a button. `sent_ms`: by the clock of later check-ins; None: this program's monotonic clock."""
        from schemas.button import signed_text

        request = self._proved(self._button, "register", self.button_name(name), signed_text)
        return self._button({**request, "sent_ms": _or_now_ms(sent_ms)})

    def check_in(
        self, token: str, count: int, sent_ms: float | None = None, timeout_s: float | None = None
    ) -> "ButtonAck":
        """Check in. `count` must grow with each check-in."""
        return self._button({"do": "alive", "button": token, "count": count, "sent_ms": _or_now_ms(sent_ms)}, timeout_s)

    def leave(self, token: str, timeout_s: float | None = None) -> "ButtonAck":
        """End a button's registration."""
        return self._button({"do": "leave", "button": token}, timeout_s)

    def _person(self, name: str | None) -> str:
        """Return the certificate's person, else `name`, else the client's name."""
        return self._identity.person() if self._identity.proves else (name or self._name)

    def _proved(
        self,
        ask: "Callable[[Request], LeaseAck | ButtonAck]",
        do: str,
        source: str,
        text: Callable[[str, str, str], bytes] | None = None,
    ) -> Request:
        """Return the request, with a proof if there is a certificate."""
        request: Request = {"do": do, "source": source}
        if self._identity.proves and (nonce := ask({"do": "challenge"}).nonce) is not None:
            request["proof"] = self._identity.prove(do, source, nonce, text)
        return request

    def _lease(self, request: Request, timeout_s: float | None = None) -> "LeaseAck":
        from schemas.lease import LeaseAck

        return self._get(LEASE, json.dumps(request), LeaseAck, timeout_s=timeout_s)

    def _button(self, request: Request, timeout_s: float | None = None) -> "ButtonAck":
        from schemas.button import ButtonAck

        return self._get(BUTTON, json.dumps(request), ButtonAck, timeout_s=timeout_s)


def _or_now_ms(sent_ms: float | None) -> float:
    return time.monotonic() * 1000 if sent_ms is None else sent_ms


LIFE: Final = 600
"""A button registers again after this many `timeout_ms`. A bad crystal (200 ppm) drifts by an eighth of `timeout_ms` in
that time, and the gateway allows a quarter."""
REGISTERED_WITHIN: Final = 0.5
"""The part of `timeout_ms` for both queries of a registration, whose delay is the reference for late check-ins."""
REGISTRATION_TRIES: Final = 3
"""More than one, since a program's first registration also imports `cryptography`."""


class Button:
    """A stop button for the time of a `with`. The program itself checks in, by `alive`.

    A thread would check in for a program that hangs. Call `alive` three times within `timeout_ms`, from the code whose
    progress counts. The end of the `with` ends the registration, which is no failure.

    >>> with Client(endpoint) as robot, robot.button("kitchen") as button:
    ...     button.alive().alive
    ...     button.press().accepted
    1
    True
    """

    def __init__(self, requests: Requests, estop: Callable[[str | None], Ack], name: str | None) -> None:
        """See `Client.button`. @private"""
        self._requests = requests
        self._estop = estop
        self._wanted = name
        self._token: str | None = None
        self._count = 0
        self._ends_s = 0.0
        """When to register again (monotonic seconds)."""
        self.name = ""
        """The button's name at the gateway: the certificate's person, else the name that the program chose."""
        self.timeout_ms = 0.0
        """How long a check-in counts, in milliseconds."""

    def __enter__(self) -> Self:
        """Register. Raises RejectedError if the gateway denies it, DisconnectedError if none answers."""
        self.register()
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()

    def register(self) -> None:
        """Register. Call it again after the gateway was restarted or this machine slept.

        Raises RejectedError (`stale`) if the answers take longer than half of `timeout_ms`.
        """
        self.name = self._requests.button_name(self._wanted)
        for _ in range(REGISTRATION_TRIES):
            began_s = time.monotonic()
            ack = self._requests.register(self._wanted).or_raise()
            self._token, self._count = ack.button, 0
            self.timeout_ms = ack.timeout_ms or 0.0
            registered_s = self._ends_s = time.monotonic()
            if registered_s - began_s <= REGISTERED_WITHIN * self.timeout_ms / 1000:
                self._ends_s += LIFE * self.timeout_ms / 1000
                return
        raise RejectedError(Reason.STALE, "registering takes longer than half the time that a check-in counts")

    def alive(self) -> "ButtonAck":
        """Check in. The answer counts the buttons `alive` and `required`. Registers again every 600 `timeout_ms`.

        Raises RejectedError: `unknown_button` if the gateway was restarted or another program has registered the name
        (`register` takes it back), `stale` if the check-in was late. Raises DisconnectedError if no answer comes within
        `timeout_ms`: then this button counts as silent, and the robot stops.
        """
        if self._token is None:
            raise RuntimeError("a button that has left cannot check in; register it again")
        if time.monotonic() >= self._ends_s:
            try:
                self.register()
            except RejectedError as error:  # denied, for too many proofs a second: the old registration stays
                if error.reason != Reason.BUTTON_DENIED:
                    raise
                self._ends_s = time.monotonic() + LIFE / 10 * self.timeout_ms / 1000
        self._count += 1
        return self._requests.check_in(self._token, self._count, timeout_s=self.timeout_ms / 1000 or None).or_raise()

    def press(self) -> Ack:
        """Engage the emergency stop in the button's name; see `Client.estop`."""
        return self._estop(self.name or self._wanted)

    def leave(self) -> None:
        """End the registration; the robot stops if too few buttons remain. @private"""
        token, self._token = self._token, None
        if token is not None:
            with suppress(DisconnectedError):  # the registration expires
                self._requests.leave(token, self.timeout_ms / 1000 or None)
