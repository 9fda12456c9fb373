"""Limits of Zenoh clients' memory and sessions: in the files of `certs`, and applied at every start."""

from typing import Final

SIZE_LIMIT: Final = 16_384
"""Bytes of a payload with its attachment; Zenoh drops a larger message in Rust. Above the gateway's own limit of 4096
bytes, so that a payload between the two is answered `too_large`."""
MAX_MESSAGE_SIZE: Final = 65_536
"""Bytes of a message assembled from fragments; assembly precedes access control and the size limit. With
Zenoh's own limit of 1 GiB, one put of 400 MB from anyone with a certificate took the service from 70 to 482 MB."""
MAX_SESSIONS: Final = 64
"""Concurrent sessions. With Zenoh's 1000, an observer took 999 in 4.3 s, and as many of the service's file descriptors;
no operator could connect."""
OPERATORS_PLACES: Final = 8
"""Sessions of MAX_SESSIONS reserved for operators (zenoh_io/connection_limiter.py)."""
ACCEPT_PENDING: Final = 100
"""Connections in their handshake; Zenoh's own default."""
ACCEPT_TIMEOUT_MS: Final = 2000
"""Limit of a handshake; a laptop gives up after 1000. With Zenoh's 10 s, 100 silent connections on a `tcp/` port
blocked all clients for 10 s."""
