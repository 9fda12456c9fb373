"""`python -m gateway` is `hexapod-gateway`."""

from gateway.cli import main

main()
