"""What one visitor may take of the gateway's memory: written into the files of `certs`, and set at every start."""

from typing import Final

SIZE_LIMIT: Final = 16_384
"""Bytes of a payload. Above the gateway's own limit of 4096 bytes: what lies between still reaches it and is answered
`too_large`. Beyond this, Zenoh drops the message in Rust. The margin leaves room for an attachment, which counts."""
MAX_MESSAGE_SIZE: Final = 65_536
"""Bytes of a message that is put together from fragments, before access control or the size limit look at it. With
Zenoh's own limit of 1 GiB, one put of 400 MB from anyone with a certificate took the service from 70 to 482 MB."""
MAX_SESSIONS: Final = 64
"""How many may be connected at once. With Zenoh's 1000, an observer took 999 places in 4.3 s, which kept every operator
out, and as many of the service's file descriptors."""
OPERATORS_PLACES: Final = 8
"""Of these, those that visitors without that role never get (doorkeeper.py)."""
ACCEPT_PENDING: Final = 100
"""How many may be on their way in, which is Zenoh's own limit."""
ACCEPT_TIMEOUT_MS: Final = 2000
"""For how long each of these may be; a laptop's file gives up after 1000. With Zenoh's 10 s, 100 silent connections on
a `tcp/` port kept everybody out for as long."""
