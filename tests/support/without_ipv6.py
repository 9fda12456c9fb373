"""`python -m tests.support.without_ipv6 COMMAND…`: a command on a kernel that lacks IPv6, as `ipv6.disable=1` makes it.

A seccomp filter answers socket(AF_INET6, …) as such a kernel does.
"""

import ctypes
import errno
import os
import platform
import socket
import struct
import sys
from typing import Final

_SOCKET: Final = {"x86_64": 41, "aarch64": 198}[platform.machine()]
_LOAD, _EQUAL, _RETURN = 0x20, 0x15, 0x06
_NUMBER, _FIRST_ARGUMENT = 0, 16  # offsets in struct seccomp_data
_ALLOW, _ERRNO = 0x7FFF0000, 0x00050000
_NO_NEW_PRIVS, _SECCOMP, _FILTER = 38, 22, 2
_PROGRAM: Final = (
    (_LOAD, 0, 0, _NUMBER),
    (_EQUAL, 0, 3, _SOCKET),
    (_LOAD, 0, 0, _FIRST_ARGUMENT),
    (_EQUAL, 0, 1, int(socket.AF_INET6)),
    (_RETURN, 0, 0, _ERRNO | errno.EAFNOSUPPORT),
    (_RETURN, 0, 0, _ALLOW),
)


def main() -> None:
    filters = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *each) for each in _PROGRAM))
    program = ctypes.create_string_buffer(struct.pack("@HP", len(_PROGRAM), ctypes.addressof(filters)))
    prctl = ctypes.CDLL(None, use_errno=True).prctl
    nothing = (ctypes.c_ulong(0),) * 2
    if prctl(_NO_NEW_PRIVS, ctypes.c_ulong(1), ctypes.c_ulong(0), *nothing) or prctl(
        _SECCOMP, ctypes.c_ulong(_FILTER), ctypes.c_void_p(ctypes.addressof(program)), *nothing
    ):
        raise OSError(ctypes.get_errno(), "the kernel takes no filter")
    os.execvp(sys.argv[1], sys.argv[1:])  # noqa: S606 (no shell is wanted)


if __name__ == "__main__":
    main()
