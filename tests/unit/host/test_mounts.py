"""Which file system a folder is on, and whether a boot empties it."""

from pathlib import Path

import pytest

from gateway.host.mounts import FORGETS, forgets, mount_of

MOUNTS = """\
22 1 0:30 / / rw,relatime - overlay overlayroot rw,lowerdir=/media/root-ro,upperdir=/media/root-rw/overlay
23 22 179:3 / /var/lib/hexapod-gateway rw,noatime shared:2 - ext4 /dev/mmcblk0p3 rw
24 22 0:31 / /run rw,nosuid - tmpfs tmpfs rw
25 22 179:4 / /mnt/two\\040words rw - ext4 /dev/sda1 rw
26 22 179:4 / /srv rw - ext4 /dev/sda1 rw
27 26 0:33 / /srv rw - tmpfs tmpfs rw
"""


@pytest.mark.parametrize(
    ("folder", "mount", "kind"),
    [
        ("/var/lib", "/", "overlay"),
        ("/var/lib/hexapod-gateway/deeper", "/var/lib/hexapod-gateway", "ext4"),
        ("/var/lib/hexapod-gateway.old", "/", "overlay"),
        ("/run/user/0", "/run", "tmpfs"),
        ("/mnt/two words/state", "/mnt/two words", "ext4"),
        ("/srv/state", "/srv", "tmpfs"),
    ],
)
def test_the_mount_of_a_folder(folder: str, mount: str, kind: str) -> None:
    assert mount_of(Path(folder), MOUNTS) == (mount, kind)


def test_a_file_system_in_memory_counts_as_one_that_forgets() -> None:
    assert forgets(Path("/dev/shm")) == "tmpfs"  # noqa: S108 (the point of it)
    assert forgets(Path("/proc")) == ""
    assert "ext4" not in FORGETS


def test_the_root_of_a_chroot_need_not_be_a_mount_point() -> None:
    assert mount_of(Path("/var/lib"), "24 22 0:31 / /run rw,nosuid - tmpfs tmpfs rw") == ("/", "unknown")
