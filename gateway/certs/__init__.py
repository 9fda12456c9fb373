"""Certificates: who may reach the gateway, and as what. `init` once, `issue` for each laptop."""

from gateway.certs.authority import CA_DAYS, LAPTOP_ROLES, LEAF_DAYS
from gateway.certs.folder import Certificate, describe, expiries, init, issue, renew
from gateway.certs.reading import read_certificate

__all__ = [
    "CA_DAYS",
    "LAPTOP_ROLES",
    "LEAF_DAYS",
    "Certificate",
    "describe",
    "expiries",
    "init",
    "issue",
    "read_certificate",
    "renew",
]
