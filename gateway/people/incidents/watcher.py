"""Watches the ring and keeps incidents on the disk, in a process of its own: nothing here can hold a Stop up."""

import logging
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from gateway.host.file_lock import written_by_anyone
from gateway.model.black_box import format as form
from gateway.model.black_box import header
from gateway.model.black_box.files import INCIDENTS_FOLDER, MAX_SLOTS, RING_FILE
from gateway.people.incidents import archive, ring_reader
from gateway.people.incidents.incidents import Incident, find

LOOK_S: Final = 0.5
"""How often it looks whether something happened; a look takes some 50 µs."""

NEWEST: Final = 20_000
"""Slots in which the end of a gateway is: a minute at 300 commands a second, which all legs at 50 Hz make."""

logger = logging.getLogger(__name__)


class IncidentWatcher:
    """Keeps the incidents of one black box."""

    def __init__(self, folder: Path, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._ring = folder / RING_FILE
        self._folder = folder / INCIDENTS_FOLDER
        self._clock = clock
        self._seen: tuple[int, int, bool] | None = None
        self._due_ns: int | None = None
        self._from_ns = 0  # the oldest record that was read last
        self._failed: set[str] = set()

    def look(self) -> list[Path]:
        """Keep what is to be kept now; returns the files that were written. Raises nothing."""
        seen = _glance(self._ring)
        due = self._due_ns is not None and self._clock() > self._due_ns
        if seen is None or (seen == self._seen and not due):
            return []
        self._seen = seen
        return self.keep(whole_only=True)

    def keep_all(self) -> None:
        """Keep all that is there now, the end first: its caller may not wait for a full ring."""
        self.keep(whole_only=False, most=NEWEST)
        self.keep(whole_only=False)

    def keep(self, *, whole_only: bool, most: int = MAX_SLOTS) -> list[Path]:
        """Read the ring and keep its incidents; `whole_only`: those that nothing can be added to any more.

        With `most`, the incidents of its newest so many slots; those that began earlier are then kept anew when it is
        read whole.
        """
        self._due_ns = None
        try:
            content = ring_reader.read(self._ring, most)
        except ring_reader.NoRingError as error:
            logger.info("no black box: %s", error)
            return []
        found = find(content.records, written=content.written, now_ns=self._clock())
        open_until = [incident.end_ns for incident in found if not incident.whole]
        self._due_ns = min(open_until, default=None)
        cut_ns, self._from_ns = self._from_ns, min(content.records.times_ns[:1], default=0)
        further_back = self._from_ns < cut_ns
        names = [each.name for each in found]
        made = [
            self._keep(each, content, names[place:], anew=further_back and each.begin_ns < cut_ns)
            for place, each in enumerate(found, 1)
            if each.whole or not whole_only
        ]
        return [path for path in made if path is not None]

    def _keep(self, incident: Incident, content: ring_reader.Content, later: list[str], *, anew: bool) -> Path | None:
        if archive.is_kept(self._folder, incident) and not anew:
            return None
        again = archive.path_of(self._folder, incident).exists()
        try:
            path = archive.keep(self._folder, incident, content.records, later, over=self._clock() > incident.end_ns)
            archive.prune(self._folder)
        except OSError as error:
            if incident.name not in self._failed:
                self._failed.add(incident.name)
                logger.warning("incident %s cannot be kept: %s", incident.name, error.strerror or error)
            return None
        if not again:  # else with what came later, such as the next start
            logger.info("incident %s is kept: %s", incident.name, path)
        return path


def _glance(ring: Path) -> tuple[int, int, bool] | None:
    """What changes when something happened: which file it is, its newest start or incident, whether a gateway runs."""
    try:
        fd = os.open(ring, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        return os.fstat(fd).st_ino, header.announced(os.pread(fd, form.HEADER_BYTES, 0)), written_by_anyone(fd)
    except OSError:
        return None
    finally:
        os.close(fd)
