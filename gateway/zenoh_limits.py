"""What one visitor may take of the gateway's memory: written into the files of `certs`, and set at every start."""

from typing import Final

SIZE_LIMIT: Final = 16_384
"""Bytes of a payload. Above the gateway's own limit of 4096 bytes: what lies between still reaches it and is answered
`too_large`. Beyond this, Zenoh drops the message in Rust. The margin leaves room for an attachment, which counts."""
MAX_MESSAGE_SIZE: Final = 65_536
"""Bytes of a message that is put together from fragments, before access control or the size limit look at it. With
Zenoh's own limit of 1 GiB, one put of 400 MB from anyone with a certificate took the service from 70 to 482 MB."""
