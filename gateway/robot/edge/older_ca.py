"""Who still comes with a certificate of the older of two CAs: counted for the metrics, and named in a file for `check`.

A CA that takes another's place has common names of its own, so the name alone says it.
"""

import logging
import os
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Final

from gateway.certs import pool
from gateway.robot.edge.revoked import Kept

NAME: Final = "older-ca"
"""In the service's runtime directory: the common names since the start, a line each."""
RUNTIME: Final = Path("/run/hexapod-gateway")

logger = logging.getLogger(__name__)


class OlderCa:
    """Notes whoever is connected; on one thread."""

    def __init__(
        self, kept: Kept | None, count: Callable[[int], None], environment: Mapping[str, str] = os.environ
    ) -> None:
        """`count` is called with how many they are, since the start."""
        self._first = None if kept is None else kept.first_number
        self._count = count
        self._names: set[str] = set()
        folder = environment.get("RUNTIME_DIRECTORY", "")
        self._path = Path(folder) / NAME if folder else None
        self._write()

    def note(self, common_names: Collection[str]) -> None:
        """These are connected now."""
        first = self._first
        if first is None:
            return
        found = {name for name in common_names if pool.is_before(name, first)}
        if not found <= self._names:
            self._names |= found
            self._count(len(self._names))
            self._write()

    def _write(self) -> None:
        if self._path is None:
            return
        try:
            self._path.write_text("".join(f"{name}\n" for name in sorted(self._names)))
        except OSError as error:
            logger.warning("`check` cannot see who still has a certificate of the older CA: %s", error)


def names(environment: Mapping[str, str] = os.environ) -> list[str]:
    """Who has come with one since the start of the service, as it has noted them. Raises OSError."""
    folder = Path(environment.get("RUNTIME_DIRECTORY") or RUNTIME)
    return (folder / NAME).read_text().split()
